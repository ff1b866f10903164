//! Times of numbered pairs.
//!
//! In: pairs of pictures by their numbers. Out: the same pairs with the times that a file tells, or with assumed ones.

use super::numbered::NumberedPair;
use super::odometry;
use crate::error::SourceError;
use crate::tum::FramePair;
use std::path::Path;

/// Frames a second where nothing tells the times.
const ASSUMED_RATE_HZ: f64 = 30.0;

/// Pairs at the times that a file of odometry tells; those of which it tells none are left out.
///
/// # Errors
/// [`SourceError::Recording`] names the file and the line that is wrong.
pub fn told_by(file: &Path, pairs: Vec<NumberedPair>) -> Result<Vec<FramePair>, SourceError> {
    let odometry = odometry::read(file)?;
    let count = pairs.len();
    let with_time = |pair: NumberedPair| Some(timed(*odometry.utimes.get(&pair.number)?, pair));
    let told: Vec<FramePair> = pairs.into_iter().filter_map(with_time).collect();
    if told.is_empty() {
        let line = odometry.first_line;
        let reason = format!("from line {line} on, no line names a frame that has pictures");
        return Err(SourceError::Recording { path: file.display().to_string(), reason });
    }
    let untimed = count - told.len();
    if untimed > 0 {
        tracing::warn!(untimed, file = %file.display(), "frames that it gives no time for were left out");
    }
    Ok(told)
}

/// Pairs at the times of their numbers, 30 a second, which the log is told.
pub fn assumed(dir: &Path, pairs: Vec<NumberedPair>) -> Vec<FramePair> {
    tracing::warn!(
        recording = %dir.display(),
        "nothing tells the times of the pictures: assumed are {ASSUMED_RATE_HZ} frames a second"
    );
    let utime = |number: u64| (number as f64 * 1e6 / ASSUMED_RATE_HZ).round() as i64;
    pairs.into_iter().map(|pair| timed(utime(pair.number), pair)).collect()
}

fn timed(utime: i64, pair: NumberedPair) -> FramePair {
    FramePair { utime, color: pair.color, depth: pair.depth, gap_us: 0 }
}
