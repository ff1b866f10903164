//! A recorded directory in the layout of the TUM RGB-D benchmark (DESIGN 4.1).
//!
//! `rgb.txt` and `depth.txt` list `timestamp filename`; colour and depth are paired by the
//! nearest time stamp. Pictures are decoded one frame ahead on a thread of their own, so
//! that reading a recording costs the learner little.

use crate::camera::PinholeCamera;
use crate::frame::{DepthImage, RgbdFrame};
use crate::image_file;
use crate::source::{RgbdSource, SourceError};
use crate::statistics::SourceStatistics;
use std::path::{Path, PathBuf};
use std::sync::{Arc, mpsc};

/// Largest difference of time stamps within a pair, in microseconds (DESIGN 4.1).
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
    frames: mpsc::Receiver<Result<RgbdFrame, SourceError>>,
}

impl TumRecording {
    /// Reads the lists and the camera; pictures follow as they are asked for.
    ///
    /// # Errors
    /// [`SourceError::Recording`] names the file that is missing, empty, unordered or
    /// contradicts another, and what to do.
    pub fn open(dir: &Path) -> Result<Self, SourceError> {
        let index = RecordingIndex::read(dir, DEFAULT_MAX_PAIR_GAP_US)?;
        let (sender, frames) = mpsc::sync_channel(READ_AHEAD);
        let pairs = index.pairs.len();
        let statistics = SourceStatistics {
            unpaired: index.unpaired as u64,
            largest_pair_gap_us: index.largest_pair_gap_us,
            rate_hz: index.rate_hz(),
            ..Default::default()
        };
        std::thread::spawn(move || {
            for pair in &index.pairs {
                let frame = index.load(pair);
                let failed = frame.is_err();
                if sender.send(frame).is_err() || failed {
                    return;
                }
            }
        });
        Ok(Self { name: format!("tum:{}", dir.display()), pairs, statistics, frames })
    }
}

impl RgbdSource for TumRecording {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        let frame = self.frames.recv().ok().transpose()?;
        if let Some(frame) = &frame {
            self.statistics.delivered += 1;
            self.statistics.invalid_depth = frame.depth.invalid_share();
        }
        Ok(frame)
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
    /// Pairs in time order.
    pub pairs: Vec<FramePair>,
    /// Colour pictures without depth.
    pub unpaired: usize,
    /// Largest difference of time within a pair, microseconds.
    pub largest_pair_gap_us: i64,
}

impl RecordingIndex {
    /// Reads `rgb.txt`, `depth.txt` and `camera.toml` of `dir` and pairs them.
    ///
    /// # Errors
    /// As [`TumRecording::open`].
    pub fn read(dir: &Path, max_pair_gap_us: i64) -> Result<Self, SourceError> {
        if !dir.is_dir() {
            return Err(broken(
                dir,
                "no such directory; a recording is a directory with rgb.txt, depth.txt and camera.toml",
            ));
        }
        let colors = read_list(dir, "rgb.txt")?;
        let depths = read_list(dir, "depth.txt")?;
        let camera = read_camera(dir)?;
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
        Ok(Self { camera: Arc::new(camera), pairs, unpaired, largest_pair_gap_us })
    }

    /// Frames a second by their stamps; 0 with a single frame.
    pub fn rate_hz(&self) -> f64 {
        match (self.pairs.first(), self.pairs.last()) {
            (Some(first), Some(last)) if last.utime > first.utime => {
                (self.pairs.len() - 1) as f64 * 1e6 / (last.utime - first.utime) as f64
            }
            _ => 0.0,
        }
    }

    /// Decodes one pair.
    ///
    /// # Errors
    /// [`SourceError::Recording`] for a damaged picture, [`SourceError::Frame`] for one of
    /// another size than the camera's.
    pub fn load(&self, pair: &FramePair) -> Result<RgbdFrame, SourceError> {
        let damaged = |e: image_file::ImageFileError| SourceError::Recording {
            path: e.to_string(),
            reason: "record it again, or take its line out of the list".to_owned(),
        };
        let misfit = |path: &Path| {
            let path = path.display().to_string();
            move |source| SourceError::Frame { path, source }
        };
        let color = image_file::read_color(&pair.color).map_err(damaged)?;
        let (width, height, raw) = image_file::read_depth(&pair.depth).map_err(damaged)?;
        let depth = DepthImage::from_raw(width, height, &raw, self.camera.depth_units_per_metre)
            .map_err(misfit(&pair.depth))?;
        let color_fits = (color.width(), color.height()) == (self.camera.width, self.camera.height);
        let culprit = if color_fits { &pair.depth } else { &pair.color };
        RgbdFrame::new(pair.utime, Arc::clone(&self.camera), color, depth).map_err(misfit(culprit))
    }
}

fn broken(path: &Path, reason: &str) -> SourceError {
    SourceError::Recording { path: path.display().to_string(), reason: reason.to_owned() }
}

fn read_camera(dir: &Path) -> Result<PinholeCamera, SourceError> {
    let path = dir.join("camera.toml");
    if !path.exists() {
        tracing::warn!(recording = %dir.display(), "no camera.toml: Kinect defaults are used");
        return Ok(PinholeCamera::kinect());
    }
    PinholeCamera::read_or_explain(&path)
}

fn read_list(dir: &Path, file: &str) -> Result<Vec<(i64, PathBuf)>, SourceError> {
    let path = dir.join(file);
    let text = std::fs::read_to_string(&path).map_err(|e| broken(&path, &e.to_string()))?;
    let entries = parse_list(&text).map_err(|reason| broken(&path, &reason))?;
    entries
        .into_iter()
        .map(|entry| {
            let picture = dir.join(entry.name);
            if !picture.is_file() {
                let missing = picture.display();
                let reason = format!("line {}: names {missing}, which does not exist", entry.line);
                return Err(broken(&path, &reason));
            }
            Ok((entry.utime, picture))
        })
        .collect()
}

/// An entry of `rgb.txt` or `depth.txt`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ListEntry<'t> {
    /// Line in the file, from 1.
    pub line: usize,
    /// Time stamp, microseconds.
    pub utime: i64,
    /// Name of the picture, relative to the recording.
    pub name: &'t str,
}

/// Reads the text of `rgb.txt` or `depth.txt`; entries come in the order of time.
///
/// # Errors
/// What is wrong in which line, and what to do.
pub fn parse_list(text: &str) -> Result<Vec<ListEntry<'_>>, String> {
    let mut entries: Vec<ListEntry> = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let at = |reason: String| format!("line {}: {reason}", i + 1);
        let (stamp, name) = line
            .split_once(char::is_whitespace)
            .ok_or_else(|| at("expected \"timestamp filename\"".to_owned()))?;
        let seconds: f64 = stamp
            .parse()
            .ok()
            .filter(|s: &f64| s.is_finite() && s.abs() < 9e12)
            .ok_or_else(|| at(format!("\"{stamp}\" is no time in seconds")))?;
        let utime = (seconds * 1e6).round() as i64;
        if let Some(before) = entries.last()
            && utime <= before.utime
        {
            return Err(at(format!(
                "time runs backwards ({stamp} after {:.6}); sort the list and remove repeated stamps",
                before.utime as f64 * 1e-6
            )));
        }
        entries.push(ListEntry { line: i + 1, utime, name: name.trim() });
    }
    if entries.is_empty() {
        return Err("lists no picture: the recording is empty".to_owned());
    }
    Ok(entries)
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
    fn colour_is_paired_with_the_nearest_depth_within_the_gap() {
        let pairs =
            pair_by_time(&list(&[0, 66_000, 133_000]), &list(&[4_000, 70_000, 180_000]), 20_000);
        let depths: Vec<_> = pairs.iter().map(|p| p.depth.to_str().unwrap()).collect();
        assert_eq!(depths, ["4000", "70000"]);
    }
}
