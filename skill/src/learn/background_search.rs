//! Joints are sought while frames still arrive, on a thread of their own, so that little is
//! left to do after the last one.
//!
//! What is found depends on frame numbers alone, not on how fast the threads run: a search
//! starts every so many frames, when the one before it is over, and the end drops the last.

use super::ego_motion::EgoMotion;
use super::joint_search::{WarmStart, Watched};
use super::keyframes::Keyframes;
use super::tracking::TrackSet;
use crate::config::SkillConfig;
use crate::math::rigid::Pose;
use crate::object::model::Joint;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// A search that runs beside the tracker.
pub struct BackgroundSearch {
    /// One thread: the tracker keeps the others.
    pool: Option<ThreadPool>,
    every: usize,
    found: Found,
    running: Option<Running>,
    tells: bool,
    /// What the last search believes, as soon as it is over.
    current_estimate: Arc<Mutex<Vec<Joint>>>,
}

/// What there is of a demonstration by now.
pub struct Snapshot {
    /// Its tracks.
    pub set: TrackSet,
    /// The camera's motion.
    pub camera_from_base: Vec<Pose>,
    /// Whole frames.
    pub keyframes: Keyframes,
}

/// What a search leaves to the next.
#[derive(Clone, Default)]
pub struct Found {
    /// The base's motion until then,
    pub base: Arc<EgoMotion>,
    /// and what moves on it.
    pub memory: WarmStart,
}

struct Running {
    result: Receiver<Found>,
    cancelled: Arc<AtomicBool>,
}

impl BackgroundSearch {
    /// Searches every `every` frames; never if 0. Only if it `tells` is it known what it believes.
    pub fn new(every: usize, tells: bool) -> Self {
        let pool = (every > 0)
            .then(|| ThreadPoolBuilder::new().num_threads(1).panic_handler(|_| {}).build().ok());
        Self {
            pool: pool.flatten(),
            every,
            found: Found::default(),
            running: None,
            tells,
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
            self.found = running.result.recv().unwrap_or_default();
        }
        let (sender, result) = channel();
        let cancelled = Arc::new(AtomicBool::new(false));
        let (config, earlier, stop) = (config.clone(), self.found.clone(), cancelled.clone());
        let (current_estimate, tells) = (Arc::clone(&self.current_estimate), self.tells);
        let Snapshot { set, camera_from_base, keyframes } = snapshot();
        pool.spawn(move || {
            let base = earlier.base.extended(&set, camera_from_base, &config.base);
            let watched =
                Watched { set: &set, base: &base, keyframes: &keyframes, config: &config };
            let tell =
                |joints| *current_estimate.lock().unwrap_or_else(PoisonError::into_inner) = joints;
            let tell: Option<&dyn Fn(Vec<Joint>)> = if tells { Some(&tell) } else { None };
            let memory = watched.remember(&earlier.memory, &stop, tell);
            // Nobody waits for a search that was dropped.
            let _ = sender.send(Found { base: Arc::new(base), memory });
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

    /// Joints that the last finished search believes in.
    pub fn current_estimate(&self) -> Vec<Joint> {
        self.current_estimate.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// What is known when no more frames come. A search that still runs is dropped: waiting for it
    /// takes longer than doing without.
    pub fn settle(self) -> Found {
        if let Some(running) = self.running {
            running.cancelled.store(true, Ordering::Relaxed);
        }
        self.found
    }
}
