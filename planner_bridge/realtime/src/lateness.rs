//! How late the ticks of a stream come, counted without a list of them.

/// Buckets of lateness.
const BUCKETS: usize = 1024;
/// Microseconds a bucket.
const BUCKET_US: u64 = 10;

/// Lateness of ticks: a histogram in steps of 10 microseconds up to 10 ms, and the extremes.
#[derive(Debug, Clone)]
pub struct Lateness {
    counts: [u32; BUCKETS],
    ticks: u64,
    missed: u64,
    longest_us: u64,
}

impl Default for Lateness {
    fn default() -> Self {
        Self { counts: [0; BUCKETS], ticks: 0, missed: 0, longest_us: 0 }
    }
}

impl Lateness {
    /// Notes a tick that came `late_us` after it was due, in a stream of that period.
    pub fn note(&mut self, late_us: u64, period_us: u64) {
        let bucket = (late_us / BUCKET_US).min(BUCKETS as u64 - 1) as usize;
        if let Some(count) = self.counts.get_mut(bucket) {
            *count = count.saturating_add(1);
        }
        self.ticks += 1;
        self.missed += u64::from(late_us >= period_us);
        self.longest_us = self.longest_us.max(late_us);
    }

    /// Ticks.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Ticks that came when the next was due already.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// The latest, microseconds.
    pub fn longest_us(&self) -> u64 {
        self.longest_us
    }

    /// Lateness that a share of the ticks, 0 to 1, does not exceed: microseconds, rounded up to
    /// the histogram's steps.
    pub fn quantile_us(&self, share: f64) -> u64 {
        let wanted = share * self.ticks as f64;
        let mut sum = 0.0;
        for (bucket, count) in self.counts.iter().enumerate() {
            sum += f64::from(*count);
            if sum >= wanted {
                return ((bucket as u64 + 1) * BUCKET_US).min(self.longest_us);
            }
        }
        self.longest_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_and_missed_ticks_are_counted() {
        let mut lateness = Lateness::default();
        (0..99).for_each(|_| lateness.note(55, 5000));
        lateness.note(20_000, 5000);
        assert_eq!((lateness.ticks(), lateness.missed(), lateness.longest_us()), (100, 1, 20_000));
        assert_eq!((lateness.quantile_us(0.5), lateness.quantile_us(0.99)), (60, 60));
        assert_eq!(lateness.quantile_us(1.0), 10_240);
    }

    #[test]
    fn without_ticks_nothing_is_late() {
        assert_eq!(Lateness::default().quantile_us(0.99), 0);
    }
}
