//! `--suite tracking`: trackers on real pictures without truth. A clip is played forward and
//! then backward; a feature that was followed all the way must be back where it started.

use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use anyhow::{Context, anyhow};
use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use linkage_skill::SkillConfig;
use linkage_skill::config::{DescriptorKind, TrackConfig};
use linkage_skill::internals::Tracker;
use nalgebra::Point2;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

/// Frames from the start of a turn to where it turns back.
const TURN: usize = 30;

/// What was seen of one tracker, over all clips.
#[derive(Serialize, Default)]
struct Row {
    tracker: String,
    /// Features at the start of all turns.
    started: usize,
    /// Shares of them that came back within 1 and 3 pixels of their start.
    within_1_px: f64,
    within_3_px: f64,
    /// The same as shares of those that came back at all.
    of_survivors_within_1_px: f64,
    of_survivors_within_3_px: f64,
    /// Median life of a track that a clip shows the end of, frames.
    median_life_frames: usize,
    frames_per_second: f64,
}

/// Runs every tracker over every clip of a folder.
pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let dir = args.dir.as_ref().ok_or_else(|| anyhow!("--suite tracking needs a folder"))?;
    let clips = clips(dir)?;
    println!(
        "{:22} {:>8} {:>7} {:>7} {:>10} {:>10} {:>6} {:>7}",
        "tracker", "features", "≤1 px", "≤3 px", "of back ≤1", "of back ≤3", "life", "fps"
    );
    let mut rows = Vec::new();
    for (name, config) in trackers(common)? {
        let mut tally = Tally::default();
        for clip in &clips {
            tally.clip(&frames_of(clip)?, &config)?;
        }
        let row = tally.row(name);
        println!(
            "{:22} {:8} {:6.1}% {:6.1}% {:9.1}% {:9.1}% {:6} {:7.1}",
            row.tracker,
            row.started,
            100.0 * row.within_1_px,
            100.0 * row.within_3_px,
            100.0 * row.of_survivors_within_1_px,
            100.0 * row.of_survivors_within_3_px,
            row.median_life_frames,
            row.frames_per_second
        );
        rows.push(row);
    }
    if let Some(path) = &args.json {
        write_json(path, &rows)?;
    }
    Ok(())
}

/// The profiles' trackers, and `default` with each descriptor as verifier.
fn trackers(common: &Common) -> Outcome<Vec<(String, TrackConfig)>> {
    let load = |profile: &str| SkillConfig::load(profile, common.config.as_deref());
    let mut trackers = Vec::new();
    for profile in ["paper", "default"] {
        trackers.push((profile.to_owned(), load(profile).context("a profile")?.track));
    }
    for (name, descriptor) in [("SIFT", DescriptorKind::Sift), ("SURF", DescriptorKind::Surf)] {
        let mut track = load("default").context("a profile")?.track;
        track.descriptor = descriptor;
        trackers.push((format!("default, {name} verifies"), track));
    }
    Ok(trackers)
}

fn clips(dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut clips: Vec<PathBuf> = std::fs::read_dir(dir)
        .with_context(|| format!("{}: cannot be read", dir.display()))?
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "avi" || e == "mp4" || e == "mkv"))
        .collect();
    clips.sort();
    if clips.is_empty() {
        return Err(anyhow!("{}: no clip (.avi, .mp4, .mkv) is in it", dir.display()));
    }
    Ok(clips)
}

fn frames_of(clip: &Path) -> anyhow::Result<Vec<RgbdFrame>> {
    let (width, height) = size_of(clip)?;
    let pixels = output_of(
        "ffmpeg",
        &["-nostdin", "-i"],
        clip,
        &["-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
    )?;
    let camera = camera_of(width, height);
    let mut frames = Vec::new();
    for (i, rgb) in pixels.chunks_exact(3 * width * height).enumerate() {
        let color = ColorImage::new(width, height, rgb.to_vec())?;
        let depth = DepthImage::from_metres(width, height, vec![f32::NAN; width * height])?;
        frames.push(RgbdFrame::new(i as i64 * 33_333, camera.clone(), color, depth)?);
    }
    if frames.len() <= TURN {
        return Err(anyhow!("{}: {} frames could be read, too few", clip.display(), frames.len()));
    }
    Ok(frames)
}

/// Width and height of a clip's pictures.
fn size_of(clip: &Path) -> anyhow::Result<(usize, usize)> {
    let asked =
        ["-select_streams", "v:0", "-show_entries", "stream=width,height", "-of", "csv=p=0"];
    let told = String::from_utf8(output_of("ffprobe", &asked, clip, &[])?)?;
    let size: Option<(usize, usize)> =
        told.trim().split_once(',').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    size.filter(|(w, h)| w * h > 0)
        .with_context(|| format!("{}: its pictures have no size: {told:?}", clip.display()))
}

/// What a program of FFmpeg's writes about a clip. Its libraries, two hundred with all they need,
/// would otherwise be loaded whenever any command of ours starts.
fn output_of(
    program: &str,
    before: &[&str],
    clip: &Path,
    after: &[&str],
) -> anyhow::Result<Vec<u8>> {
    let run = Command::new(program)
        .args(["-v", "error"])
        .args(before)
        .arg(clip)
        .args(after)
        .output()
        .with_context(|| {
            format!("{program}, which reads clips, does not start: apt-get install ffmpeg")
        })?;
    if !run.status.success() {
        let told = String::from_utf8_lossy(&run.stderr);
        return Err(anyhow!("{}: {}", clip.display(), told.trim()));
    }
    Ok(run.stdout)
}

/// Nothing is measured through it: clips have no depth.
fn camera_of(width: usize, height: usize) -> Arc<PinholeCamera> {
    let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
    Arc::new(PinholeCamera { width, height, cx, cy, ..PinholeCamera::kinect() })
}

#[derive(Default)]
struct Tally {
    started: usize,
    survived: usize,
    within_1_px: usize,
    within_3_px: usize,
    lives: Vec<usize>,
    frames: usize,
    seconds: f64,
}

impl Tally {
    fn clip(&mut self, frames: &[RgbdFrame], config: &TrackConfig) -> anyhow::Result<()> {
        for start in (0..frames.len() - TURN).step_by(TURN) {
            self.turn(&frames[start..=start + TURN], config)?;
        }
        self.whole(frames, config)
    }

    /// There and back again.
    fn turn(&mut self, frames: &[RgbdFrame], config: &TrackConfig) -> anyhow::Result<()> {
        let mut tracker = Tracker::new(config.clone());
        tracker.push(&frames[0])?;
        let begun: BTreeMap<usize, Point2<f32>> = tracker.live().collect();
        for frame in frames[1..].iter().chain(frames[..frames.len() - 1].iter().rev()) {
            tracker.push(frame)?;
        }
        self.started += begun.len();
        for (track, pixel) in tracker.live() {
            let Some(start) = begun.get(&track) else { continue };
            let distance = (pixel - start).norm();
            self.survived += 1;
            self.within_1_px += usize::from(distance <= 1.0);
            self.within_3_px += usize::from(distance <= 3.0);
        }
        Ok(())
    }

    /// Lives of tracks and time, played once.
    fn whole(&mut self, frames: &[RgbdFrame], config: &TrackConfig) -> anyhow::Result<()> {
        let mut tracker = Tracker::new(config.clone());
        let mut ages: BTreeMap<usize, usize> = BTreeMap::new();
        let begin = Instant::now();
        for frame in frames {
            tracker.push(frame)?;
            let mut alive: BTreeMap<usize, usize> =
                tracker.live().map(|(t, _)| (t, ages.get(&t).map_or(1, |n| n + 1))).collect();
            std::mem::swap(&mut ages, &mut alive);
            self.lives.extend(alive.iter().filter(|(t, _)| !ages.contains_key(t)).map(|(_, n)| *n));
        }
        self.seconds += begin.elapsed().as_secs_f64();
        self.frames += frames.len();
        Ok(())
    }

    fn row(mut self, tracker: String) -> Row {
        self.lives.sort_unstable();
        let share = |n: usize, of: usize| n as f64 / of.max(1) as f64;
        Row {
            tracker,
            started: self.started,
            within_1_px: share(self.within_1_px, self.started),
            within_3_px: share(self.within_3_px, self.started),
            of_survivors_within_1_px: share(self.within_1_px, self.survived),
            of_survivors_within_3_px: share(self.within_3_px, self.survived),
            median_life_frames: self.lives.get(self.lives.len() / 2).copied().unwrap_or(0),
            frames_per_second: self.frames as f64 / self.seconds.max(1e-9),
        }
    }
}
