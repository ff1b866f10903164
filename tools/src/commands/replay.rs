//! `linkage replay`: any source as a camera on LCM.

use crate::cli::{Common, ReplayArgs};
use crate::console::Progress;
use crate::outcome::{Failure, Outcome};
use crate::source::open;
use anyhow::anyhow;
use linkage_driver::RgbdSource;
use linkage_driver::lcm::{Packing, encode_frame};
use linkage_lcm::Lcm;
use std::time::{Duration, Instant};

pub fn run(args: &ReplayArgs, common: &Common) -> Outcome {
    if !(args.rate.is_finite() && args.rate >= 0.0) {
        return Err(anyhow!("--rate must be 0 or above").into());
    }
    let lcm = Lcm::new(&args.publish)?;
    let mut frames = open(&args.source, &args.take)?;
    let packing = Packing { jpeg: args.jpeg, zlib: true };
    let progress = Progress::new("sending", frames.frame_count(), common.quiet);
    let start = Instant::now();
    let (mut first_utime, mut count) = (None, 0);
    while let Some(frame) = frames.next_frame()? {
        let message = encode_frame(&frame, packing)?;
        let first = *first_utime.get_or_insert(frame.utime);
        if args.rate > 0.0 {
            std::thread::sleep(due(first, frame.utime, args.rate).saturating_sub(start.elapsed()));
        }
        lcm.publish(&args.channel, &message)?;
        progress.step();
        count += 1;
    }
    if count == 0 {
        return Err(Failure::no_answer(format!("{}: no frame", args.source)));
    }
    progress.finish(&format!("{count} frames sent to {} on {}", args.publish, args.channel));
    Ok(())
}

/// How long after the first frame another one is sent; at once where its stamp is before the first.
fn due(first_utime: i64, utime: i64, rate: f64) -> Duration {
    let seconds = utime.saturating_sub(first_utime).max(0) as f64 * 1e-6 / rate;
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_sent_in_time_whatever_its_stamp_and_the_rate() {
        assert_eq!(due(1_000_000, 3_000_000, 2.0), Duration::from_secs(1));
        assert_eq!(due(1_000_000, 0, 1.0), Duration::ZERO);
        assert_eq!(due(i64::MIN, i64::MAX, 1e-300), Duration::MAX);
    }
}
