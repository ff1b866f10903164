//! Frames that were lost on the way, over some time: a few do no harm, many degrade what is learned
//! from the others.

use std::time::{Duration, Instant};

/// Share of the frames from which their loss is told.
const MANY: f64 = 0.03;

/// Losses since an instant.
pub struct Losses {
    since: Instant,
    lost_before: u64,
    taken_before: u64,
}

impl Losses {
    /// Counts losses from now on, after `lost` frames were lost and `taken` frames were taken.
    pub fn begin(lost: u64, taken: u64) -> Self {
        Self { since: Instant::now(), lost_before: lost, taken_before: taken }
    }

    /// Since it began.
    pub fn age(&self) -> Duration {
        self.since.elapsed()
    }

    /// Says how many frames were lost beside those that were taken, if they are many.
    pub fn many(&self, lost: u64, taken: u64) -> Option<String> {
        let lost = lost.saturating_sub(self.lost_before);
        told(lost, taken.saturating_sub(self.taken_before))
    }
}

fn told(lost: u64, taken: u64) -> Option<String> {
    let sent = lost + taken;
    (lost as f64 > MANY * sent as f64).then(|| {
        format!(
            "{lost} of {sent} frames were lost: run \"linkage doctor --source SOURCE\" to see where, or send fewer a second"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_lost_frames_are_not_told_and_many_are() {
        assert_eq!(told(0, 0), None);
        assert_eq!(told(3, 100), None);
        assert!(told(104, 37).unwrap().contains("104 of 141 frames"));
        assert!(told(5, 0).is_some());
    }
}
