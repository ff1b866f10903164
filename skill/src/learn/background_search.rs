//! Joints are sought while frames still arrive, on a thread of their own, so that little is left to
//! do after the last frame.
//!
//! The result depends on frame numbers alone, not on how fast the threads run: a search starts
//! after a fixed number of frames, when the one before it is over, and the last one is dropped at
//! the end.

use super::ego_motion::EgoMotion;
use super::joint_search::{SearchSettings, WarmStart, search_ahead};
use super::keyframes::Keyframes;
use super::recording::Recording;
use super::tracking::TrackSet;
use crate::config::SkillConfig;
use crate::math::rigid::Pose;
use crate::object::model::Joint;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// A search that runs beside the tracker.
pub struct BackgroundSearch {
    /// One thread: the tracker keeps the others.
    pool: Option<ThreadPool>,
    /// Frames between two searches.
    every: usize,
    found: Found,
    running: Option<Running>,
    /// Each search reports its joints to `current_estimate`.
    reports_progress: bool,
    /// Joints of the last search that is over.
    current_estimate: Arc<Mutex<Vec<Joint>>>,
}

/// The frames of a demonstration that have arrived so far.
pub struct Snapshot {
    /// Its tracks, in the camera frame.
    pub tracks: TrackSet,
    /// The camera's motion, a pose each frame.
    pub camera_from_base: Vec<Pose>,
    /// Whole frames.
    pub keyframes: Keyframes,
}

/// What a search leaves to the next.
#[derive(Clone, Default)]
pub struct Found {
    /// The camera's motion and the tracks in the base frame, up to the last frame of the search.
    pub ego_motion: Arc<EgoMotion>,
    /// The joints that were found.
    pub warm_start: WarmStart,
}

/// A search that is not over.
struct Running {
    result: Receiver<Found>,
    cancelled: Arc<AtomicBool>,
}

/// What the joint search needs of the configuration.
pub fn search_settings(config: &SkillConfig) -> SearchSettings<'_> {
    SearchSettings { joints: &config.joints, seed: config.seed }
}

impl BackgroundSearch {
    /// Searches every `every` frames; never if 0. [`Self::current_estimate`] stays empty unless it
    /// `reports_progress`.
    pub fn new(every: usize, reports_progress: bool) -> Self {
        Self {
            pool: (every > 0).then(single_thread).flatten(),
            every,
            found: Found::default(),
            running: None,
            reports_progress,
            current_estimate: Arc::default(),
        }
    }

    /// Starts a search if one is due after `frames` frames, on what `snapshot` gives.
    pub fn offer(
        &mut self,
        frames: usize,
        config: &SkillConfig,
        snapshot: impl FnOnce() -> Snapshot,
    ) {
        let Some(pool) = &self.pool else { return };
        if frames == 0 || !frames.is_multiple_of(self.every) {
            return;
        }
        if let Some(running) = self.running.take() {
            // A search that panicked has logged it, and left nothing.
            self.found = running.result.recv().unwrap_or_default();
        }
        let (sender, result) = channel();
        let cancelled = Arc::new(AtomicBool::new(false));
        let (config, earlier, stop) = (config.clone(), self.found.clone(), Arc::clone(&cancelled));
        let report = self.reports_progress.then(|| Arc::clone(&self.current_estimate));
        let snapshot = snapshot();
        pool.spawn(move || {
            match caught(|| search(snapshot, &earlier, &config, &stop, report.as_deref())) {
                // Nobody waits for a search that was dropped.
                Ok(found) => drop(sender.send(found)),
                Err(panic) => tracing::warn!(
                    frames,
                    panic,
                    "a background search for joints panicked; the next one starts from nothing"
                ),
            }
        });
        self.running = Some(Running { result, cancelled });
    }

    /// Drops what was found: frames were forgotten, and it counts them as they were.
    pub fn start_over(&mut self) {
        if let Some(running) = self.running.take() {
            running.cancelled.store(true, Ordering::Relaxed);
        }
        self.found = Found::default();
    }

    /// Joints of the last search that is over.
    pub fn current_estimate(&self) -> Vec<Joint> {
        self.current_estimate.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// What was found when no more frames come. A search that still runs is dropped: waiting for it
    /// takes longer than doing without.
    pub fn settle(self) -> Found {
        if let Some(running) = self.running {
            running.cancelled.store(true, Ordering::Relaxed);
        }
        self.found
    }
}

/// A pool of one thread; `None`, with a warning, where the system gives none.
fn single_thread() -> Option<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(1).build();
    pool.inspect_err(|error| tracing::warn!(%error, "no background search for joints")).ok()
}

/// Searches the frames of a snapshot, from what an `earlier` search found.
fn search(
    snapshot: Snapshot,
    earlier: &Found,
    config: &SkillConfig,
    cancelled: &AtomicBool,
    report: Option<&Mutex<Vec<Joint>>>,
) -> Found {
    let Snapshot { tracks, camera_from_base, keyframes } = snapshot;
    let ego_motion =
        earlier.ego_motion.extended(&tracks, camera_from_base, keyframes.depth_sensor());
    let recording = Recording { tracks, ego_motion, keyframes };
    let settings = search_settings(config);
    let (warm_start, joints) =
        search_ahead(&recording, &earlier.warm_start, &settings, cancelled, report.is_some());
    if let (Some(report), Some(joints)) = (report, joints) {
        *report.lock().unwrap_or_else(PoisonError::into_inner) = joints;
    }
    Found { ego_motion: Arc::new(recording.ego_motion), warm_start }
}

/// The result, or the message of the panic that ended it.
fn caught<T>(run: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(run)).map_err(|panic| message_of(panic.as_ref()))
}

fn message_of(panic: &(dyn Any + Send)) -> String {
    let literal = panic.downcast_ref::<&str>().map(|message| (*message).to_owned());
    let formatted = || panic.downcast_ref::<String>().cloned();
    literal.or_else(formatted).unwrap_or_else(|| "without a message".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::tracking::{Observation, Track, TrackId};
    use nalgebra::{Point2, Point3};

    #[test]
    fn the_message_of_a_panic_is_kept() {
        assert_eq!(caught(|| 3), Ok(3));
        assert_eq!(caught(|| panic!("no line")), Err::<(), _>("no line".to_owned()));
        let frame = 7;
        assert_eq!(caught(|| panic!("frame {frame}")), Err::<(), _>("frame 7".to_owned()));
    }

    /// Tracks of three frames, with a camera pose for this many of them.
    fn snapshot(poses: usize) -> Snapshot {
        let seen = Observation {
            pixel: Point2::origin(),
            point_in_camera: Some(Point3::new(0.0, 0.0, 1.0)),
            normal_in_camera: None,
        };
        let track = Track { id: TrackId(0), first_frame: 0, observations: vec![seen; 3] };
        Snapshot {
            tracks: TrackSet { frame_utimes: vec![1, 2, 3], tracks: vec![track] },
            camera_from_base: vec![Pose::identity(); poses],
            keyframes: Keyframes::new(2),
        }
    }

    /// Frames that the last search over snapshots with this many camera poses leaves to the next.
    fn frames_found(poses: &[usize]) -> usize {
        let config = SkillConfig::default();
        let mut background = BackgroundSearch::new(1, false);
        for (i, &poses) in poses.iter().enumerate() {
            background.offer(i + 1, &config, || snapshot(poses));
        }
        // The search before the last one is waited for.
        background.offer(poses.len() + 1, &config, || snapshot(3));
        background.found.warm_start.frames
    }

    #[test]
    fn a_search_that_panics_leaves_nothing_and_the_next_one_searches_again() {
        assert_eq!(frames_found(&[3]), 3);
        assert_eq!(frames_found(&[3, 0]), 0, "a track without camera poses panics");
        assert_eq!(frames_found(&[0, 3]), 3);
    }
}
