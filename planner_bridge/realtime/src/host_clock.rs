//! The host's clock beside the one that is never corrected.
//!
//! The processor may be taken away between the readings of the two. Were their difference taken as it
//! was read then, a setpoint would be stamped by milliseconds too late, and whoever goes by the stamps
//! would see the joint jump. So the difference is kept until readings that lie close together tell
//! another one.

/// Readings of both clocks within this time lie close together, microseconds.
const CLOSE_US: u64 = 50;
/// After so many readings on end that did not, the next one is taken as it is.
const MOST_APART: u32 = 200;

/// The host's clock as it was read, and the other clock before that and after it.
pub(crate) struct Reading {
    pub(crate) before_us: u64,
    pub(crate) utime: i64,
    pub(crate) after_us: u64,
}

/// The difference of the two clocks.
#[derive(Debug, Default)]
pub(crate) struct HostClock {
    /// The host's clock less the other one, microseconds.
    offset_us: Option<i64>,
    /// Readings on end that did not lie close together.
    apart: u32,
}

impl HostClock {
    /// An instant of the clock that is never corrected, by the host's clock.
    pub(crate) fn at(&mut self, instant_us: u64, reading: &Reading) -> i64 {
        let took_us = reading.after_us.saturating_sub(reading.before_us);
        let middle_us = reading.before_us.saturating_add(took_us / 2);
        let read_us = reading.utime.saturating_sub_unsigned(middle_us);
        let is_close = took_us <= CLOSE_US;
        let offset_us = match self.offset_us {
            Some(known) if !is_close && self.apart < MOST_APART => known,
            Some(known) if known.abs_diff(read_us) <= took_us => known,
            _ => read_us,
        };
        self.apart = if is_close { 0 } else { self.apart.saturating_add(1) };
        self.offset_us = Some(offset_us);
        offset_us.saturating_add_unsigned(instant_us)
    }
}
