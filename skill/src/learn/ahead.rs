//! Joints are sought while frames still arrive, on a thread of their own, so that little is
//! left to do after the last one.
//!
//! What is found depends on frame numbers alone, not on how fast the threads run: a search
//! starts every so many frames, and the end waits for it or drops it by how long ago that was.

use crate::base::find_base;
use crate::config::SkillConfig;
use crate::joints::{Memory, Watched};
use crate::keyframes::Keyframes;
use crate::track::TrackSet;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};

/// A search that runs beside the tracker.
pub struct SearchAhead {
    /// One thread: the tracker keeps the others.
    pool: Option<ThreadPool>,
    every: usize,
    found: Memory,
    running: Option<Running>,
}

struct Running {
    /// Frames that it was given.
    frames: usize,
    result: Receiver<Memory>,
    cancelled: Arc<AtomicBool>,
}

impl SearchAhead {
    /// Searches every `every` frames; never if 0.
    pub fn new(every: usize) -> Self {
        let pool = (every > 0)
            .then(|| ThreadPoolBuilder::new().num_threads(1).panic_handler(|_| {}).build().ok());
        Self { pool: pool.flatten(), every, found: Memory::default(), running: None }
    }

    /// Starts a search if one is due after `frames` frames, on what `snapshot` gives.
    pub fn offer(
        &mut self,
        frames: usize,
        config: &SkillConfig,
        snapshot: impl FnOnce() -> (TrackSet, Keyframes),
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
        let (set, keyframes) = snapshot();
        pool.spawn(move || {
            let base = find_base(&set, &config.base, config.seed);
            let watched =
                Watched { set: &set, base: &base, keyframes: &keyframes, config: &config };
            // Nobody waits for a search that was dropped.
            let _ = sender.send(watched.remember(&earlier, &stop));
        });
        self.running = Some(Running { frames, result, cancelled });
    }

    /// What is known when `frames` frames have come and no more will. A search that began late
    /// is dropped: waiting would take longer than doing without.
    pub fn settle(mut self, frames: usize) -> Memory {
        if let Some(running) = self.running.take() {
            if frames - running.frames >= self.every / 2 {
                return running.result.recv().unwrap_or_default();
            }
            running.cancelled.store(true, Ordering::Relaxed);
        }
        self.found
    }
}
