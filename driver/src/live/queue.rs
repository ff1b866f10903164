//! The bounded queue between the capture thread and whoever takes the frames.

use crate::frame::RgbdFrame;
use crate::statistics::SourceStatistics;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Frames in order; the oldest gives way to a new one.
pub struct FrameQueue {
    capacity: usize,
    state: Mutex<State>,
    filled: Condvar,
}

#[derive(Default)]
struct State {
    frames: VecDeque<RgbdFrame>,
    /// Why no more will come: `Some(None)` at a recording's end.
    closed: Option<Option<String>>,
    delivered: u64,
    dropped: u64,
    source: SourceStatistics,
}

impl FrameQueue {
    /// Room for so many frames, at least one.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), state: Mutex::default(), filled: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a frame; never waits.
    pub fn push(&self, frame: RgbdFrame) {
        let mut state = self.lock();
        if state.frames.len() == self.capacity {
            state.frames.pop_front();
            state.dropped += 1;
        }
        state.frames.push_back(frame);
        self.filled.notify_one();
    }

    /// Keeps what the capture thread has counted.
    pub fn note(&self, source: &SourceStatistics) {
        self.lock().source = *source;
    }

    /// No more will come; what waits can still be taken.
    pub fn close(&self, reason: Option<String>) {
        self.lock().closed = Some(reason);
        self.filled.notify_all();
    }

    /// Waits for the next frame; `Ok(None)` at the end, `Err` with the reason after a failure.
    pub fn pop(&self) -> Result<Option<RgbdFrame>, String> {
        let mut state = self.lock();
        loop {
            if let Some(frame) = state.frames.pop_front() {
                state.delivered += 1;
                return Ok(Some(frame));
            }
            match &state.closed {
                Some(Some(reason)) => return Err(reason.clone()),
                Some(None) => return Ok(None),
                None => {}
            }
            state = self.filled.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// All counts.
    pub fn statistics(&self) -> SourceStatistics {
        let state = self.lock();
        SourceStatistics { delivered: state.delivered, dropped: state.dropped, ..state.source }
    }
}
