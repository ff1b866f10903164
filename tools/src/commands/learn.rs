//! `linkage learn`.

use super::{Outcome, skill_config, write_json, write_text};
use crate::cli::{Common, LearnArgs};
use crate::console::Progress;
use anyhow::Context;
use linkage_skill::geometry::pose_to_array;
use linkage_skill::{Demonstration, Learner, SkillConfig};
use std::fmt::Write;

pub fn run(args: &LearnArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let demonstration = demonstrate(&args.sources[0], &args.object, &config, common.quiet)?;
    if let Some(path) = &args.json {
        write_json(path, &demonstration.model)?;
    }
    if let Some(path) = &args.poses {
        write_text(path, &poses_csv(&demonstration))?;
    }
    Ok(())
}

/// Learns from one recording, with progress.
pub fn demonstrate(
    source: &str,
    object: &str,
    config: &SkillConfig,
    quiet: bool,
) -> Outcome<Demonstration> {
    let mut frames = linkage_driver::open(source)?;
    let progress = Progress::new("watching", frames.frame_count(), quiet);
    let mut learner = Learner::new(config);
    let mut count = 0;
    while let Some(frame) = frames.next_frame()? {
        learner.push(&frame).with_context(|| frames.name().to_owned())?;
        progress.step();
        count += 1;
    }
    progress.finish(&format!("{count} frames of {source}"));
    Ok(learner.finish(object).with_context(|| frames.name().to_owned())?)
}

/// `t,part,x,y,z,qx,qy,qz,qw`: camera_from_part (DESIGN 4.4).
fn poses_csv(demonstration: &Demonstration) -> String {
    let mut text = String::from("t,part,x,y,z,qx,qy,qz,qw\n");
    for (frame, utime) in demonstration.frame_utimes.iter().enumerate() {
        for (part, poses) in demonstration.camera_from_part.iter().enumerate() {
            if let Some(pose) = &poses[frame] {
                let numbers = pose_to_array(pose).map(|x| format!("{x:.9}")).join(",");
                let _ = writeln!(text, "{:.6},{part},{numbers}", *utime as f64 * 1e-6);
            }
        }
    }
    text
}
