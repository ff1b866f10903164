//! One file a command.

mod learn;

use crate::cli::{Cli, Command, Common};
use anyhow::{Context, anyhow};
use linkage_skill::SkillConfig;
use std::path::Path;

pub use learn::demonstrate;

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

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { status: BAD_INPUT, cause: error.into() }
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
    match cli.command {
        Command::Learn(args) => learn::run(&args, &cli.common),
        Command::Bench(args) => crate::bench::run(&args, &cli.common),
    }
}

/// The effective configuration.
pub fn skill_config(common: &Common) -> Outcome<SkillConfig> {
    let mut config = SkillConfig::default();
    if let Some(seed) = common.seed {
        config.seed = seed;
    }
    Ok(config)
}

/// Writes JSON to a file, or to standard output for `-`.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Outcome {
    let text = serde_json::to_string_pretty(value)? + "\n";
    write_text(path, &text)
}

/// Writes a file whole or not at all; `-` is standard output.
pub fn write_text(path: &Path, text: &str) -> Outcome {
    use std::io::Write;
    if path == Path::new("-") {
        std::io::stdout().write_all(text.as_bytes())?;
        return Ok(());
    }
    let dir = path.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let write = || -> anyhow::Result<()> {
        let mut file = tempfile::NamedTempFile::new_in(dir)?;
        file.write_all(text.as_bytes())?;
        file.persist(path)?;
        Ok(())
    };
    write().with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(())
}
