//! What a source has delivered and what it has lost.

use crate::frame::RgbdFrame;

/// Counts of a source since it was opened.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SourceStatistics {
    /// Frames handed out.
    pub delivered: u64,
    /// Frames that came faster than they were taken; the oldest gave way.
    pub dropped: u64,
    /// Pictures of colour or depth without a partner near enough in time.
    pub unpaired: u64,
    /// Frames whose message or picture could not be read.
    pub damaged: u64,
    /// Frames that were not later than the one before them: repeated, or out of order.
    pub out_of_order: u64,
    /// How often the device was opened again, or its clock began again.
    pub reconnections: u64,
    /// Largest difference of time between colour and depth of one frame, microseconds.
    pub largest_pair_gap_us: i64,
    /// Share of the last frame's pixels without depth, 0 to 1.
    pub invalid_depth: f64,
    /// Frames a second by their own time stamps; 0 before the second one.
    pub rate_hz: f64,
}

impl SourceStatistics {
    /// Frames and pictures that did not arrive, for whatever reason.
    pub fn lost(&self) -> u64 {
        self.dropped + self.unpaired + self.damaged + self.out_of_order
    }
}

/// Keeps frames in the order of time, and counts.
#[derive(Debug, Clone, Default)]
pub struct Gate {
    first_utime: Option<i64>,
    last_utime: Option<i64>,
    passed: u64,
    /// What it has counted.
    pub statistics: SourceStatistics,
}

/// A step back in time this long is no disorder but another beginning, microseconds.
const NEW_BEGINNING_US: i64 = 1_000_000;

impl Gate {
    /// The same for a camera that may begin again: one that was restarted, or another recording
    /// on its channel.
    pub fn pass_again(&mut self, frame: RgbdFrame) -> Option<RgbdFrame> {
        if self.last_utime.is_some_and(|last| frame.utime < last - NEW_BEGINNING_US) {
            self.statistics.reconnections += 1;
            (self.first_utime, self.last_utime, self.passed) = (None, None, 0);
        }
        self.pass(frame)
    }

    /// Lets a frame pass that is later than the one before it.
    pub fn pass(&mut self, frame: RgbdFrame) -> Option<RgbdFrame> {
        if self.last_utime.is_some_and(|last| frame.utime <= last) {
            self.statistics.out_of_order += 1;
            return None;
        }
        let first = *self.first_utime.get_or_insert(frame.utime);
        self.last_utime = Some(frame.utime);
        self.passed += 1;
        if frame.utime > first {
            self.statistics.rate_hz = (self.passed - 1) as f64 * 1e6 / (frame.utime - first) as f64;
        }
        self.statistics.invalid_depth = frame.depth.invalid_share();
        Some(frame)
    }
}
