//! Around every live camera: a thread that captures, a bounded queue that drops the oldest, a
//! watchdog, and reconnection with growing patience.

mod clock;
mod pairing;
mod queue;

pub use clock::{DeviceClock, host_utime};
pub use pairing::{Paired, Pairing};

use crate::frame::RgbdFrame;
use crate::source::{RgbdSource, SourceError};
use crate::statistics::{Gate, SourceStatistics};
use queue::FrameQueue;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A camera that is open.
pub trait Camera: Send {
    /// Waits for the next frame, at most about as long as it is told; `None` when none came.
    ///
    /// # Errors
    /// Why the camera is lost.
    fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault>;

    /// Pictures of colour or depth that found no partner so far, and the largest difference
    /// of time within a pair, microseconds.
    fn pairing(&self) -> (u64, i64) {
        (0, 0)
    }
}

/// What a camera says when it delivers no frame.
#[derive(Debug)]
pub enum CameraFault {
    /// One frame could not be read; the next may.
    Damaged(String),
    /// The camera is gone and must be opened again.
    Lost(String),
    /// It has come to its end, as recordings do.
    Ended,
}

/// Opens a camera, again after it was lost.
pub type Opener = dyn FnMut() -> Result<Box<dyn Camera>, SourceError> + Send;

/// How a live camera is watched.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveConfig {
    /// Frames that wait to be taken; more push out the oldest.
    pub queue: usize,
    /// Silence after which the camera is closed and opened again.
    pub stall: Duration,
    /// First and longest wait before it is opened again; each failure doubles it.
    pub patience: [Duration; 2],
    /// A camera that does not come back for this long ends the source with an error.
    pub give_up: Duration,
}

impl Default for LiveConfig {
    fn default() -> Self {
        Self {
            queue: 4,
            stall: Duration::from_secs(2),
            patience: [Duration::from_millis(100), Duration::from_secs(5)],
            give_up: Duration::from_secs(30),
        }
    }
}

/// A camera with its thread and queue.
pub struct LiveSource {
    name: String,
    queue: Arc<FrameQueue>,
    dropped: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Longest wait for a frame before the thread looks whether it is to stop.
const POLL: Duration = Duration::from_millis(100);

impl LiveSource {
    /// Opens the camera and starts to capture; once `stop` is set the source ends as a
    /// recording does.
    ///
    /// # Errors
    /// What the opener says the first time; later failures are retried.
    pub fn start(
        name: &str,
        mut opener: Box<Opener>,
        config: LiveConfig,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let camera = opener()?;
        let queue = Arc::new(FrameQueue::new(config.queue));
        let dropped = Arc::new(AtomicBool::new(false));
        let watch = Watch {
            name: name.to_owned(),
            opener,
            config,
            queue: Arc::clone(&queue),
            stop: [stop, Arc::clone(&dropped)],
            gate: Gate::default(),
            unpaired_before: 0,
        };
        let thread = std::thread::Builder::new()
            .name("capture".to_owned())
            .spawn(move || watch.run(camera))
            .map_err(|e| SourceError::Device { name: name.to_owned(), reason: e.to_string() })?;
        Ok(Self { name: name.to_owned(), queue, dropped, thread: Some(thread) })
    }
}

impl RgbdSource for LiveSource {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        self.queue.pop().map_err(|reason| SourceError::Device { name: self.name.clone(), reason })
    }

    fn frame_count(&self) -> Option<usize> {
        None
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn is_live(&self) -> bool {
        true
    }

    fn statistics(&self) -> SourceStatistics {
        self.queue.statistics()
    }
}

impl Drop for LiveSource {
    fn drop(&mut self) {
        self.dropped.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!(source = self.name, "the capture thread failed");
        }
    }
}

/// What the capture thread owns.
struct Watch {
    name: String,
    opener: Box<Opener>,
    config: LiveConfig,
    queue: Arc<FrameQueue>,
    /// Either one ends it: the user's, or that nobody takes frames any more.
    stop: [Arc<AtomicBool>; 2],
    gate: Gate,
    /// Pictures without partner of cameras that were closed.
    unpaired_before: u64,
}

/// Why a camera is not asked any more.
enum End {
    Stopped,
    Ended,
    Lost(String),
}

impl Watch {
    fn run(mut self, mut camera: Box<dyn Camera>) {
        loop {
            let end = self.capture(&mut *camera);
            self.unpaired_before += camera.pairing().0;
            drop(camera);
            match end {
                End::Stopped | End::Ended => return self.queue.close(None),
                End::Lost(reason) => {
                    tracing::warn!(source = self.name, reason, "camera lost; it is opened again");
                    match self.reopen(reason) {
                        Ok(again) => camera = again,
                        Err(reason) => return self.queue.close(reason),
                    }
                }
            }
        }
    }

    fn capture(&mut self, camera: &mut dyn Camera) -> End {
        let mut last = Instant::now();
        while !self.is_stopped() {
            match camera.next_frame(POLL) {
                Ok(Some(frame)) => {
                    last = Instant::now();
                    self.take(frame, camera.pairing());
                }
                Ok(None) if last.elapsed() > self.config.stall => {
                    return End::Lost(format!("no frame for {:?}", self.config.stall));
                }
                Ok(None) => {}
                Err(CameraFault::Damaged(reason)) => {
                    last = Instant::now();
                    self.gate.statistics.damaged += 1;
                    tracing::debug!(source = self.name, reason, "damaged frame");
                    self.queue.note(&self.gate.statistics);
                }
                Err(CameraFault::Lost(reason)) => return End::Lost(reason),
                Err(CameraFault::Ended) => return End::Ended,
            }
        }
        End::Stopped
    }

    fn is_stopped(&self) -> bool {
        self.stop.iter().any(|s| s.load(Ordering::Relaxed))
    }

    fn take(&mut self, frame: RgbdFrame, (unpaired, gap_us): (u64, i64)) {
        let frame = self.gate.pass(frame);
        let statistics = &mut self.gate.statistics;
        statistics.unpaired = self.unpaired_before + unpaired;
        statistics.largest_pair_gap_us = statistics.largest_pair_gap_us.max(gap_us);
        self.queue.note(statistics);
        if let Some(frame) = frame {
            self.queue.push(frame);
        }
    }

    /// Opens the camera again, with growing patience; `Err(None)` when told to stop.
    fn reopen(&mut self, lost: String) -> Result<Box<dyn Camera>, Option<String>> {
        let since = Instant::now();
        let [mut wait, longest] = self.config.patience;
        let mut reason = lost;
        while since.elapsed() < self.config.give_up {
            let until = Instant::now() + wait.min(self.config.give_up);
            while Instant::now() < until {
                if self.is_stopped() {
                    return Err(None);
                }
                std::thread::sleep(POLL.min(until.saturating_duration_since(Instant::now())));
            }
            match (self.opener)() {
                Ok(camera) => {
                    self.gate.statistics.reconnections += 1;
                    self.queue.note(&self.gate.statistics);
                    tracing::info!(source = self.name, "camera is back");
                    return Ok(camera);
                }
                Err(e) => reason = e.to_string(),
            }
            wait = (2 * wait).min(longest);
        }
        Err(Some(format!("lost, and not back within {:?}: {reason}", self.config.give_up)))
    }
}
