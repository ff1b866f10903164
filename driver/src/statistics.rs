//! What a source has delivered and what it has lost.

/// Counts of a source since it was opened.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SourceStatistics {
    /// Frames handed out.
    pub delivered: u64,
    /// Frames that came faster than they were taken; the oldest were dropped.
    pub dropped: u64,
    /// Frames that were sent and did not arrive, as far as a network tells.
    pub missing: u64,
    /// Pictures of colour or depth without a partner near enough in time.
    pub unpaired: u64,
    /// Frames whose message or picture could not be read.
    pub damaged: u64,
    /// Frames that were not later than the one before them: repeated, or out of order.
    pub out_of_order: u64,
    /// Frames whose stamp could not be, and whose time was reckoned from their arrival.
    pub restamped: u64,
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
        self.dropped + self.missing + self.unpaired + self.damaged + self.out_of_order
    }
}
