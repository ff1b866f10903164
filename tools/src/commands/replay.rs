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
            let due = Duration::from_secs_f64((frame.utime - first) as f64 * 1e-6 / args.rate);
            std::thread::sleep(due.saturating_sub(start.elapsed()));
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
