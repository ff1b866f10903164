//! A rate limit for the log: errors that come without a pause do not fill the disk. The longer they go
//! on, the fewer are logged, and each line tells how many were left out before it. The caller does not
//! count an error that repeats the one before it.

use std::time::{Duration, Instant};

/// Time between two lines of the log at first.
const SHORTEST: Duration = Duration::from_millis(200);
/// Longest time between two lines while errors go on.
const LONGEST: Duration = Duration::from_secs(30);

/// Which errors are logged. The time between two lines doubles while errors come, up to
/// half a minute, and is short again after as long without one.
#[derive(Debug)]
pub struct LogRateLimit {
    pause: Duration,
    logged: Option<Instant>,
    left_out: u64,
}

impl Default for LogRateLimit {
    fn default() -> Self {
        Self { pause: SHORTEST, logged: None, left_out: 0 }
    }
}

impl LogRateLimit {
    /// An error came: `Some` if it is to be logged, with the number of those before it that
    /// were not.
    pub fn admit(&mut self, now: Instant) -> Option<u64> {
        let since = self.logged.map(|at| now.saturating_duration_since(at));
        if since.is_some_and(|since| since < self.pause) {
            self.left_out += 1;
            return None;
        }
        let was_quiet = since.is_none_or(|since| since > self.pause + LONGEST);
        self.pause = if was_quiet { SHORTEST } else { (self.pause * 2).min(LONGEST) };
        self.logged = Some(now);
        Some(std::mem::take(&mut self.left_out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_flood_that_lasts_an_hour_few_lines_are_logged_and_none_is_uncounted() {
        let (mut limit, start) = (LogRateLimit::default(), Instant::now());
        let (mut lines, mut counted) = (0, 0);
        for i in 0..36_000 {
            if let Some(left_out) = limit.admit(start + Duration::from_millis(100 * i)) {
                lines += 1;
                counted += left_out + 1;
            }
        }
        assert!((100..150).contains(&lines), "{lines}");
        assert!(counted > 35_700, "{counted}");
    }

    #[test]
    fn single_errors_are_all_logged_and_a_pause_ends_a_flood() {
        let (mut limit, mut now) = (LogRateLimit::default(), Instant::now());
        for _ in 0..10 {
            assert_eq!(limit.admit(now), Some(0));
            now += Duration::from_secs(61);
        }
        for _ in 0..1000 {
            let _ = limit.admit(now);
            now += Duration::from_millis(50);
        }
        now += Duration::from_secs(90);
        assert!(limit.admit(now).is_some());
        assert!(limit.admit(now + SHORTEST).is_some());
    }
}
