//! A recorded directory in the layout of the TUM RGB-D benchmark.
//!
//! `rgb.txt` and `depth.txt` list `timestamp filename` in seconds; colour and depth are paired by
//! the nearest time stamp. Pictures are decoded one frame ahead on a thread of their own, so
//! that reading a recording costs the learner little.

use crate::camera_file::read_camera_file;
use crate::error::{PictureFault, SourceError};
use crate::image_file;
use crate::rgbd_source::RgbdSource;
use crate::statistics::SourceStatistics;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{ScaleCheck, ScaleIssue};
use linkage_frames::frame::{DepthImage, RgbdFrame};
use linkage_frames::text_table;
use std::path::{Path, PathBuf};
use std::sync::{Arc, mpsc};

/// Largest difference of time stamps within a pair, in microseconds.
pub const DEFAULT_MAX_PAIR_GAP_US: i64 = 20_000;

/// Frames decoded ahead of the reader.
const READ_AHEAD: usize = 3;

/// One colour picture and the depth picture nearest to it in time.
#[derive(Debug, Clone, PartialEq)]
pub struct FramePair {
    /// Time of the colour picture, microseconds.
    pub utime: i64,
    /// Colour picture.
    pub color: PathBuf,
    /// Depth picture.
    pub depth: PathBuf,
    /// Difference of their times, microseconds.
    pub gap_us: i64,
}

/// An opened recording.
pub struct TumRecording {
    name: String,
    pairs: usize,
    statistics: SourceStatistics,
    /// Looks whether the first frames' depth fits `camera.toml`.
    scale: ScaleCheck,
    camera_file: PathBuf,
    frames: mpsc::Receiver<Result<RgbdFrame, SourceError>>,
    /// No more frames come: each was read, or one could not be.
    is_over: bool,
}

impl TumRecording {
    /// Reads the lists and the camera; pictures follow as they are asked for.
    ///
    /// # Errors
    /// [`SourceError::Recording`] names the file that is missing, empty, unordered or
    /// contradicts another, and what to do.
    pub fn open(dir: &Path) -> Result<Self, SourceError> {
        Self::open_with_camera(dir, None)
    }

    /// Opens it like [`Self::open`]; a camera that is given takes the place of the one that `camera.toml` describes.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with_camera(
        dir: &Path,
        given: Option<&PinholeCamera>,
    ) -> Result<Self, SourceError> {
        let recording = RecordingIndex::read(dir, DEFAULT_MAX_PAIR_GAP_US, given)?;
        let recording = Self::of_index(dir, recording);
        // What is wrong with a camera that is given is not wrong in the recording's own file.
        let camera_file = if given.is_some() { dir.to_owned() } else { dir.join("camera.toml") };
        Ok(Self { camera_file, ..recording })
    }

    /// Plays what an index lists.
    pub fn of_index(dir: &Path, index: RecordingIndex) -> Self {
        let statistics = SourceStatistics {
            unpaired: index.unpaired as u64,
            largest_pair_gap_us: index.largest_pair_gap_us,
            rate_hz: index.rate_hz(),
            ..Default::default()
        };
        let scale = ScaleCheck::new(index.camera.depth_units_per_metre, index.is_camera_assumed);
        let (name, pairs) = (format!("tum:{}", dir.display()), index.pairs.clone());
        let camera_file = dir.join("camera.toml");
        let played = Self::play(&name, pairs, statistics, scale, move |pair| index.load(pair));
        Self { camera_file, ..played }
    }

    /// Plays pairs that a function loads, on a thread of its own.
    pub fn play(
        name: &str,
        pairs: Vec<FramePair>,
        statistics: SourceStatistics,
        scale: ScaleCheck,
        load: impl Fn(&FramePair) -> Result<RgbdFrame, SourceError> + Send + 'static,
    ) -> Self {
        let (sender, frames) = mpsc::sync_channel(READ_AHEAD);
        let count = pairs.len();
        std::thread::spawn(move || {
            for pair in &pairs {
                let frame = load(pair);
                let failed = frame.is_err();
                if sender.send(frame).is_err() || failed {
                    return;
                }
            }
        });
        let (name, camera_file) = (name.to_owned(), PathBuf::from(name));
        Self { name, pairs: count, statistics, scale, camera_file, frames, is_over: count == 0 }
    }
}

impl RgbdSource for TumRecording {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        if self.is_over {
            return Ok(None);
        }
        let Ok(read) = self.frames.recv() else {
            self.is_over = true;
            let reason = "the thread that reads it failed, which is a fault of this program: report it with the log";
            return Err(broken(Path::new(&self.name), reason));
        };
        self.is_over = read.is_err() || self.statistics.delivered + 1 == self.pairs as u64;
        let frame = read?;
        self.statistics.delivered += 1;
        self.statistics.invalid_depth = frame.depth.invalid_share();
        match self.scale.look(&frame.depth) {
            Some(ScaleIssue::Wrong(reason)) => return Err(broken(&self.camera_file, &reason)),
            Some(ScaleIssue::Odd(reason)) => tracing::warn!(source = self.name, "{reason}"),
            None => {}
        }
        Ok(Some(frame))
    }

    fn frame_count(&self) -> Option<usize> {
        Some(self.pairs)
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn statistics(&self) -> SourceStatistics {
        self.statistics
    }
}

/// What a recording holds, before any picture is decoded.
#[derive(Debug)]
pub struct RecordingIndex {
    /// The camera of all frames.
    pub camera: Arc<PinholeCamera>,
    /// True where no `camera.toml` describes it.
    pub is_camera_assumed: bool,
    /// Pairs in time order.
    pub pairs: Vec<FramePair>,
    /// Colour pictures without depth.
    pub unpaired: usize,
    /// Largest difference of time within a pair, microseconds.
    pub largest_pair_gap_us: i64,
}

impl RecordingIndex {
    /// Reads `rgb.txt`, `depth.txt` and, where no camera is given, `camera.toml` of `dir`, and pairs the pictures.
    ///
    /// # Errors
    /// As [`TumRecording::open`].
    pub fn read(
        dir: &Path,
        max_pair_gap_us: i64,
        given: Option<&PinholeCamera>,
    ) -> Result<Self, SourceError> {
        if !dir.is_dir() {
            return Err(broken(
                dir,
                "no such directory; a recording is a directory with rgb.txt, depth.txt and camera.toml",
            ));
        }
        let colors = read_list(dir, "rgb.txt")?;
        let depths = read_list(dir, "depth.txt")?;
        let described = match given {
            Some(camera) => Some(camera.clone()),
            None => read_camera(dir)?,
        };
        let is_camera_assumed = described.is_none();
        let camera = described.unwrap_or_else(PinholeCamera::kinect);
        let pairs = pair_by_time(&colors, &depths, max_pair_gap_us);
        if pairs.is_empty() {
            return Err(broken(
                dir,
                &format!(
                    "no colour picture has a depth picture within {} ms; compare the time stamps of rgb.txt and depth.txt",
                    max_pair_gap_us / 1000
                ),
            ));
        }
        let unpaired = colors.len() - pairs.len();
        if unpaired > 0 {
            tracing::warn!(unpaired, recording = %dir.display(), "colour pictures without depth were left out");
        }
        let largest_pair_gap_us = pairs.iter().map(|p| p.gap_us).max().unwrap_or(0);
        let camera = Arc::new(camera);
        Ok(Self { camera, is_camera_assumed, pairs, unpaired, largest_pair_gap_us })
    }

    /// Frames a second by their stamps; 0 with a single frame.
    pub fn rate_hz(&self) -> f64 {
        rate_hz(&self.pairs)
    }

    /// Decodes one pair.
    ///
    /// # Errors
    /// [`SourceError::Recording`] for a damaged picture, [`SourceError::Frame`] for one of
    /// another size than the camera's.
    pub fn load(&self, pair: &FramePair) -> Result<RgbdFrame, SourceError> {
        let unusable = |e: image_file::ImageFileError| match e.fault {
            PictureFault::Size(source) => SourceError::Frame { path: e.path, source },
            PictureFault::Damaged(reason) => SourceError::Recording {
                path: e.path,
                reason: format!("{reason}: record it again, or take its line out of the list"),
            },
        };
        let camera = &self.camera;
        let (width, height) = (camera.width, camera.height);
        let color = image_file::read_color(&pair.color, (width, height)).map_err(unusable)?;
        let raw = image_file::read_depth(&pair.depth, (width, height)).map_err(unusable)?;
        DepthImage::from_raw(width, height, &raw, camera.depth_units_per_metre)
            .and_then(|depth| RgbdFrame::new(pair.utime, Arc::clone(camera), color, depth))
            .map_err(|source| SourceError::Frame { path: pair.color.display().to_string(), source })
    }
}

/// Frames a second by the stamps of pairs in time order; 0 with a single pair.
pub(crate) fn rate_hz(pairs: &[FramePair]) -> f64 {
    match (pairs.first(), pairs.last()) {
        (Some(first), Some(last)) if last.utime > first.utime => {
            (pairs.len() - 1) as f64 * 1e6 / (last.utime - first.utime) as f64
        }
        _ => 0.0,
    }
}

fn broken(path: &Path, reason: &str) -> SourceError {
    SourceError::Recording { path: path.display().to_string(), reason: reason.to_owned() }
}

/// The camera that `camera.toml` describes, if there is one.
///
/// # Errors
/// [`SourceError::Recording`] when it is damaged.
pub fn read_camera(dir: &Path) -> Result<Option<PinholeCamera>, SourceError> {
    let path = dir.join("camera.toml");
    if !path.exists() {
        let remedy = format!("write the right ones into {}", path.display());
        PinholeCamera::kinect().warn_assumed(&dir.display().to_string(), &remedy);
        return Ok(None);
    }
    read_camera_file(&path).map(Some)
}

fn read_list(dir: &Path, file: &str) -> Result<Vec<(i64, PathBuf)>, SourceError> {
    let path = dir.join(file);
    let text = text_table::read(&path).map_err(|e| broken(&path, &e.to_string()))?;
    let entries = parse_list(&text).map_err(|reason| broken(&path, &reason))?;
    entries
        .into_iter()
        .map(|entry| {
            let picture = picture_of(dir, entry.name)
                .map_err(|what| broken(&path, &format!("line {}: names {what}", entry.line)))?;
            Ok((entry.utime, picture))
        })
        .collect()
}

/// The picture that an entry names. What looks like a comment or a separator behind a name is one unless such a file
/// exists.
fn picture_of(dir: &Path, name: &str) -> Result<PathBuf, String> {
    let mut pictures = text_table::possible_names(name).into_iter().map(|name| dir.join(name));
    if let Some(picture) = pictures.find(|picture| picture.is_file()) {
        return Ok(picture);
    }
    let picture = dir.join(name);
    let what = if picture.exists() { "is no regular file" } else { "does not exist" };
    Err(format!("{}, which {what}", picture.display()))
}

/// An entry of `rgb.txt` or `depth.txt`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ListEntry<'t> {
    /// Line in the file, from 1.
    pub line: usize,
    /// Time stamp, microseconds.
    pub utime: i64,
    /// Name of the picture, relative to the recording, with all that follows it in its line.
    pub name: &'t str,
}

/// Largest time stamp that is seconds; Unix time in milliseconds, microseconds or nanoseconds
/// lies above. The year 5138.
const MAX_SECONDS: f64 = 1e11;
/// A recording of at least this many pictures, this far apart in the median, is in other units.
const ENOUGH_STEPS: usize = 10;
const LONGEST_STEP_US: i64 = 10_000_000;

/// Reads the text of `rgb.txt` or `depth.txt`; entries come in the order of time. A first row of
/// column names is passed over.
///
/// # Errors
/// What is wrong in which line, and what to do.
pub fn parse_list(text: &str) -> Result<Vec<ListEntry<'_>>, String> {
    let mut entries: Vec<ListEntry> = Vec::new();
    for (i, row) in text_table::rows(text).enumerate() {
        if i == 0 && row.is_header() {
            continue;
        }
        let at = |reason: String| format!("line {}: {reason}", row.number);
        let (stamp, name) =
            row.split_first().ok_or_else(|| at("expected \"timestamp filename\"".to_owned()))?;
        let utime = stamp_utime(stamp).map_err(at)?;
        if let Some(before) = entries.last()
            && utime <= before.utime
        {
            return Err(at(format!(
                "time runs backwards ({stamp} after {:.6}); sort the list and remove repeated stamps",
                before.utime as f64 * 1e-6
            )));
        }
        entries.push(ListEntry { line: row.number, utime, name });
    }
    if entries.is_empty() {
        return Err("lists no picture: the recording is empty".to_owned());
    }
    check_steps(entries.iter().map(|entry| entry.utime))?;
    Ok(entries)
}

/// A stamp of seconds in microseconds.
///
/// # Errors
/// What is no time in seconds.
pub fn stamp_utime(stamp: &str) -> Result<i64, String> {
    let seconds =
        text_table::number(stamp).ok_or_else(|| format!("\"{stamp}\" is no time in seconds"))?;
    if seconds.abs() > MAX_SECONDS {
        return Err(format!(
            "{stamp} is no time in seconds: are the stamps milliseconds, microseconds or nanoseconds? write them in seconds"
        ));
    }
    Ok((seconds * 1e6).round() as i64)
}

/// Refuses a list whose stamps count from its start in smaller units.
///
/// # Errors
/// How far apart they are.
pub(crate) fn check_steps(utimes: impl Iterator<Item = i64> + Clone) -> Result<(), String> {
    let next = utimes.clone().skip(1);
    let mut steps: Vec<i64> = utimes.zip(next).map(|(before, after)| after - before).collect();
    if steps.len() + 1 < ENOUGH_STEPS {
        return Ok(());
    }
    let middle = steps.len() / 2;
    let median = *steps.select_nth_unstable(middle).1;
    if median < LONGEST_STEP_US {
        return Ok(());
    }
    Err(format!(
        "the pictures are {:.1} s apart: are the stamps milliseconds, microseconds or nanoseconds? write them in seconds",
        median as f64 * 1e-6
    ))
}

fn pair_by_time(
    colors: &[(i64, PathBuf)],
    depths: &[(i64, PathBuf)],
    max_gap_us: i64,
) -> Vec<FramePair> {
    colors
        .iter()
        .filter_map(|(utime, color)| {
            let after = depths.partition_point(|(t, _)| t < utime);
            let nearest = [after.checked_sub(1), Some(after)]
                .into_iter()
                .flatten()
                .filter_map(|i| depths.get(i))
                .min_by_key(|(t, _)| (t - utime).abs())?;
            let gap_us = (nearest.0 - utime).abs();
            (gap_us <= max_gap_us).then(|| FramePair {
                utime: *utime,
                gap_us,
                color: color.clone(),
                depth: nearest.1.clone(),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(stamps: &[i64]) -> Vec<(i64, PathBuf)> {
        stamps.iter().map(|&t| (t, PathBuf::from(t.to_string()))).collect()
    }

    #[test]
    fn a_thread_that_fails_while_it_reads_is_no_end_of_the_recording() {
        let pair =
            |utime| FramePair { utime, color: PathBuf::new(), depth: PathBuf::new(), gap_us: 0 };
        let scale = ScaleCheck::new(1000.0, false);
        let statistics = SourceStatistics::default();
        let pairs = vec![pair(1), pair(2)];
        let mut recording =
            TumRecording::play("it", pairs, statistics, scale, |_| panic!("a test's own"));
        let reason = recording.next_frame().unwrap_err().to_string();
        assert!(reason.contains("a fault of this program"), "{reason}");
        assert!(matches!(recording.next_frame(), Ok(None)), "it is told once");
    }

    #[test]
    fn colour_is_paired_with_the_nearest_depth_within_the_gap() {
        let pairs =
            pair_by_time(&list(&[0, 66_000, 133_000]), &list(&[4_000, 70_000, 180_000]), 20_000);
        let depths: Vec<_> = pairs.iter().map(|p| p.depth.to_str().unwrap()).collect();
        assert_eq!(depths, ["4000", "70000"]);
    }

    #[test]
    fn a_list_of_any_program_is_read() {
        let expected = [(1_500_000, "rgb/a b.png"), (1_533_000, "/data/../c,1.png")];
        for text in [
            "# timestamp filename\n1.5 rgb/a b.png\n1.533 /data/../c,1.png\n",
            "\u{feff}1.5 rgb/a b.png\r\n1.533 /data/../c,1.png\r\n",
            "% t name\n; t name\n1.5\trgb/a b.png\n\n1.533\t/data/../c,1.png",
            "timestamp,filename\n1.5,\"rgb/a b.png\"\n1.533, /data/../c,1.png\n",
            "1.5;rgb/a b.png\n1.533;/data/../c,1.png\n",
        ] {
            let entries = parse_list(text).unwrap_or_else(|e| panic!("{text:?}: {e}"));
            let found: Vec<_> = entries.iter().map(|e| (e.utime, e.name)).collect();
            assert_eq!(found, expected, "{text:?}");
        }
    }

    #[test]
    fn what_stands_behind_a_name_belongs_to_it_only_where_such_a_file_is() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a.png", "b c.png", "d.png # e", "f,.png"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        for (rest, expected) in [
            ("a.png,", "a.png"),
            ("a.png ;", "a.png"),
            ("a.png # c", "a.png"),
            ("a.png, % c", "a.png"),
            ("a.png# c", "a.png"),
            ("\"b c.png\" # d # e", "b c.png"),
            ("\"b c.png\",", "b c.png"),
            ("d.png # e", "d.png # e"),
            ("f,.png,", "f,.png"),
        ] {
            for stamp in ["1.5,", "1.5 ", "1.5;", "1,5;", "1,5 ", "\"1.5\", "] {
                std::fs::write(dir.path().join("rgb.txt"), format!("{stamp}{rest}\n")).unwrap();
                let listed = read_list(dir.path(), "rgb.txt").unwrap();
                assert_eq!(listed, [(1_500_000, dir.path().join(expected))], "{stamp}{rest}");
            }
        }
        std::fs::write(dir.path().join("rgb.txt"), "1.5 missing.png # c\n").unwrap();
        let told = read_list(dir.path(), "rgb.txt").unwrap_err().to_string();
        assert!(told.contains("line 1: names ") && told.contains("missing.png"), "{told}");
    }

    #[test]
    fn stamps_with_decimal_commas_keep_their_order() {
        for text in ["1,5 a.png\n1,6 b.png\n", "1,5;a.png\n1,6;b.png", "1,5\ta.png\n1,6\tb.png"] {
            let entries = parse_list(text).unwrap();
            let found: Vec<_> = entries.iter().map(|e| (e.utime, e.name)).collect();
            assert_eq!(found, [(1_500_000, "a.png"), (1_600_000, "b.png")], "{text:?}");
        }
        let separated = parse_list("1,a b.png\n2, c.png\n").unwrap();
        assert_eq!(separated.iter().map(|e| e.name).collect::<Vec<_>>(), ["a b.png", "c.png"]);
    }

    #[test]
    fn stamps_that_are_no_seconds_are_told() {
        for stamp in ["nan", "inf", "1e999", "x1", "--", "1305031102175", "1305031102175304000"] {
            let error = parse_list(&format!("0.5 a.png\n{stamp} b.png\n")).unwrap_err();
            assert!(error.contains("line 2") && error.contains("seconds"), "{stamp}: {error}");
        }
        for (period, is_wrong) in [(0.033, false), (1.0, false), (33.0, true), (33_333_333.0, true)]
        {
            let text: String =
                (0..20).map(|i| format!("{} a.png\n", f64::from(i) * period)).collect();
            let told = parse_list(&text).err();
            assert_eq!(told.is_some(), is_wrong, "{period}: {told:?}");
            assert!(told.is_none_or(|t| t.contains("milliseconds")));
        }
        // A few pictures of a scene that nothing moves in may be taken minutes apart.
        assert!(parse_list("0 a.png\n60 b.png\n").is_ok());
    }
}
