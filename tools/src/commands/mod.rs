//! One file a command.

mod command;
mod config;
mod demo;
mod destination;
mod doctor;
mod export;
mod fit;
mod learn;
mod listen;
mod output;
mod predict;
mod recognise;
mod record;
mod replay;
mod serve;
mod simulate;
mod source;
mod store;
mod vocabulary;

use crate::cli::{Cli, Command, Common};
use anyhow::anyhow;
use linkage_driver::RgbdFrame;
use linkage_skill::SkillConfig;

pub use learn::{demonstrate, demonstrate_past, remember, summary};
pub use output::{write_json, write_text};
pub use recognise::{describe, last_frame};
pub use serve::describe_stream;
pub use simulate::film;

/// A command that failed, with its exit status (DESIGN 4.3).
pub struct Failure {
    /// 1: no answer; 2: usage or bad input; 3: internal.
    pub status: u8,
    /// Why, with its chain of causes.
    pub cause: anyhow::Error,
}

/// The input did not allow an answer.
pub const NO_ANSWER: u8 = 1;
/// Usage or bad input.
pub const BAD_INPUT: u8 = 2;
/// A fault of this program or of a library that it uses.
pub const INTERNAL: u8 = 3;

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        let cause = error.into();
        let internal = cause.chain().any(|e| e.is::<opencv::Error>());
        Self { status: if internal { INTERNAL } else { BAD_INPUT }, cause }
    }
}

impl Failure {
    /// The input did not allow an answer.
    pub fn no_answer(message: impl std::fmt::Display) -> Self {
        Self { status: NO_ANSWER, cause: anyhow!("{message}") }
    }
}

/// How a command ends.
pub type Outcome<T = ()> = Result<T, Failure>;

/// Runs a command.
pub fn run(cli: Cli) -> Outcome {
    let common = &cli.common;
    match cli.command {
        Command::Demo(args) => demo::run(&args, common),
        Command::Learn(args) => learn::run(&args, common),
        Command::Recognise(args) => recognise::run(&args, common),
        Command::Predict(args) => predict::run(&args, common),
        Command::Serve(args) => serve::run(&args, common),
        Command::Tell(args) => command::run(&args),
        Command::Listen(args) => listen::run(&args),
        Command::Record(args) => record::run(&args, common),
        Command::Replay(args) => replay::run(&args, common),
        Command::Fit(args) => fit::run(&args, common),
        Command::Store(args) => store::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Simulate(args) => simulate::run(&args, common),
        Command::Vocabulary(args) => vocabulary::run(&args, common),
        Command::Bench(args) => crate::bench::run(&args, common),
        Command::Doctor(args) => doctor::run(&args),
        Command::Config(args) => config::run(&args, common),
    }
}

/// The effective configuration.
pub fn skill_config(common: &Common) -> Outcome<SkillConfig> {
    let mut config = SkillConfig::load(&common.profile, common.config.as_deref())?;
    if let Some(seed) = common.seed {
        config.seed = seed;
    }
    Ok(config)
}

/// Warns of a frame without depth.
pub fn warn_without_depth(frame: &RgbdFrame, source: &str) {
    if frame.depth.invalid_share() >= 1.0 {
        tracing::warn!(source, "no depth at all: poses come from colour alone and are less sure");
    }
}
