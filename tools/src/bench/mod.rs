//! `linkage bench`: figures that anyone can run again.

mod ablation;
mod dir;
mod disturb;
mod false_reports;
mod follow;
mod live;
mod logs;
mod motion;
mod paper;
mod recognise;
mod score;
mod serve;
mod soak;
mod stall;
mod tags;
mod tracking;
pub use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use anyhow::anyhow;

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    match args.suite.as_str() {
        "ablation" => ablation::run(args, common),
        "dir" => dir::run(args, common),
        "false-reports" => false_reports::run(args, common),
        "follow" => follow::run(args, common),
        "logs" => logs::run(args),
        "paper" => paper::run(args, common),
        "recognise" => recognise::run(args, common),
        "serve" => serve::run(args, common),
        "soak" => soak::run(args, common),
        "tracking" => tracking::run(args, common),
        other => Err(anyhow!(
            "no suite \"{other}\"; known: ablation, dir, false-reports, follow, logs, paper, recognise, serve, soak, tracking"
        )
        .into()),
    }
}
