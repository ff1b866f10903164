//! Searches for joints on a separate thread while frames still arrive, so that little is left to do
//! after the last frame.
//!
//! In: a [`Snapshot`] of the recording after each fixed number of frames.
//! Out: what the search before the last one found ([`Found`]), in the base frame.
//!
//! The result depends on frame numbers alone, not on the speed of the threads: a search starts
//! after a fixed number of frames, when the search before it is over, and the last search is
//! dropped at the end.

use super::config::LearnSettings;
use super::ego_motion::EgoMotion;
use super::joint_search::{WarmStart, search_ahead};
use super::keyframes::Keyframes;
use super::recording::Recording;
use super::tracking::TrackSet;
use crate::math::rigid::Pose;
use crate::object::model::Joint;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// Searches for joints beside the tracker, one search at a time.
pub struct BackgroundSearch {
    /// A pool of one thread, so that the tracker keeps the other cores; `None` if no search is
    /// wanted or the system gives no thread.
    pool: Option<ThreadPool>,
    /// Frames from the start of one search to the start of the next.
    every: usize,
    found: Found,
    running: Option<Running>,
    /// True if each search reports its joints to `current_estimate`.
    reports_progress: bool,
    /// Joints of the last search that reported them.
    current_estimate: Arc<Mutex<Vec<Joint>>>,
}

/// The frames of a demonstration that have arrived so far.
pub struct Snapshot {
    /// Tracks in the camera frame of each frame, metres.
    pub tracks: TrackSet,
    /// Pose of the base in the camera, for each frame.
    pub camera_from_base: Vec<Pose>,
    /// Frames that were kept whole.
    pub keyframes: Keyframes,
}

/// Results of a search, from which the next search starts.
#[derive(Clone, Default)]
pub struct Found {
    /// Motion of the camera, and the tracks in the base frame, up to the last frame of the search.
    pub ego_motion: Arc<EgoMotion>,
    /// Joints that were found.
    pub warm_start: WarmStart,
}

/// A search that is not over.
struct Running {
    result: Receiver<Found>,
    cancelled: Arc<AtomicBool>,
}

impl BackgroundSearch {
    /// Creates a search that starts every `every` frames, never if that is 0.
    /// [`Self::current_estimate`] stays empty unless it `reports_progress`.
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

    /// Starts a search on what `snapshot` returns, if one is due after `frames` frames; waits for
    /// the search before it.
    pub fn offer(
        &mut self,
        frames: usize,
        settings: &LearnSettings,
        snapshot: impl FnOnce() -> Snapshot,
    ) {
        let Some(pool) = &self.pool else { return };
        if frames == 0 || !frames.is_multiple_of(self.every) {
            return;
        }
        if let Some(running) = self.running.take() {
            // A search that panicked has logged a warning and has no result.
            self.found = running.result.recv().unwrap_or_default();
        }
        let (sender, result) = channel();
        let cancelled = Arc::new(AtomicBool::new(false));
        let (earlier, stop) = (self.found.clone(), Arc::clone(&cancelled));
        let settings = settings.clone();
        let report = self.reports_progress.then(|| Arc::clone(&self.current_estimate));
        let snapshot = snapshot();
        pool.spawn(move || {
            match caught(|| search(snapshot, &earlier, &settings, &stop, report.as_deref())) {
                // Nothing receives the result of a search that was dropped.
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

    /// Drops the results: frames were removed, and the results refer to the old frame numbers.
    pub fn start_over(&mut self) {
        if let Some(running) = self.running.take() {
            running.cancelled.store(true, Ordering::Relaxed);
        }
        self.found = Found::default();
    }

    /// The joints of the last search that reported them; none if the searches do not report.
    pub fn current_estimate(&self) -> Vec<Joint> {
        self.current_estimate.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The results when no more frames come. The last search is dropped, over or not: to wait for
    /// it takes longer than to work without its results.
    pub fn settle(self) -> Found {
        if let Some(running) = self.running {
            running.cancelled.store(true, Ordering::Relaxed);
        }
        self.found
    }
}

/// A pool of one thread; `None`, with a warning, if the system gives no thread.
fn single_thread() -> Option<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(1).build();
    pool.inspect_err(|error| tracing::warn!(%error, "no background search for joints")).ok()
}

/// Searches the frames of a snapshot, starting from the results of an `earlier` search.
fn search(
    snapshot: Snapshot,
    earlier: &Found,
    settings: &LearnSettings,
    cancelled: &AtomicBool,
    report: Option<&Mutex<Vec<Joint>>>,
) -> Found {
    let Snapshot { tracks, camera_from_base, keyframes } = snapshot;
    let ego_motion =
        earlier.ego_motion.extended(&tracks, camera_from_base, keyframes.depth_sensor());
    let recording = Recording { tracks, ego_motion, keyframes };
    let search = settings.search();
    let (warm_start, joints) =
        search_ahead(&recording, &earlier.warm_start, &search, cancelled, report.is_some());
    if let (Some(report), Some(joints)) = (report, joints) {
        *report.lock().unwrap_or_else(PoisonError::into_inner) = joints;
    }
    Found { ego_motion: Arc::new(recording.ego_motion), warm_start }
}

/// The result of `run`, or the message of its panic.
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
        let settings = LearnSettings::default();
        let mut background = BackgroundSearch::new(1, false);
        for (i, &poses) in poses.iter().enumerate() {
            background.offer(i + 1, &settings, || snapshot(poses));
        }
        // The search before the last one is waited for.
        background.offer(poses.len() + 1, &settings, || snapshot(3));
        background.found.warm_start.frames
    }

    #[test]
    fn a_search_that_panics_leaves_nothing_and_the_next_one_searches_again() {
        assert_eq!(frames_found(&[3]), 3);
        assert_eq!(frames_found(&[3, 0]), 0, "a track without camera poses panics");
        assert_eq!(frames_found(&[0, 3]), 3);
    }
}
