//! A device's own clock, told in the host's time.

use std::time::{SystemTime, UNIX_EPOCH};

/// The host's time in microseconds.
pub fn host_utime() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_micros() as i64)
}

/// Largest step between pictures that is accepted, microseconds: a device that restarts counts from
/// anywhere.
const MAX_STEP_US: f64 = 1_000_000.0;
/// After a longer step the device's time holds if it agrees with the host's this well.
const MAX_DISAGREEMENT_US: i64 = 500_000;

/// Turns a counter that wraps into microseconds that go on.
#[derive(Debug, Clone)]
pub struct DeviceClock {
    ticks_per_us: f64,
    /// Counter and host time at which it was set.
    set: Option<(u32, i64)>,
}

impl DeviceClock {
    /// A counter of this many ticks a microsecond.
    pub fn new(ticks_per_us: f64) -> Self {
        Self { ticks_per_us, set: None }
    }

    /// Time of a count in microseconds; `host_utime` is the host's time at its arrival.
    pub fn utime(&mut self, ticks: u32, host_utime: i64) -> i64 {
        if let Some((count, utime)) = self.set {
            // A picture of the other camera may be a little older than the last one.
            let passed = f64::from(ticks.wrapping_sub(count) as i32) / self.ticks_per_us;
            let told = utime + passed.round() as i64;
            let goes_on =
                passed.abs() < MAX_STEP_US || (told - host_utime).abs() < MAX_DISAGREEMENT_US;
            if goes_on {
                if passed > 0.0 {
                    self.set = Some((ticks, told));
                }
                return told;
            }
        }
        self.set = Some((ticks, host_utime));
        host_utime
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MHZ_60: f64 = 60.0;

    #[test]
    fn the_counter_may_wrap() {
        let mut clock = DeviceClock::new(MHZ_60);
        assert_eq!(clock.utime(u32::MAX - 599_999, 1_000_000), 1_000_000);
        assert_eq!(clock.utime(600_000, 1_020_500), 1_020_000);
        assert_eq!(clock.utime(0, 1_020_500), 1_010_000);
    }

    #[test]
    fn a_device_that_restarts_goes_on_in_the_hosts_time() {
        let mut clock = DeviceClock::new(MHZ_60);
        clock.utime(4_000_000_000, 5_000_000);
        assert_eq!(clock.utime(17, 9_000_000), 9_000_000);
    }
}
