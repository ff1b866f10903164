//! What the user sees while a command runs: progress and logs, on standard error.

use crate::outcome::Outcome;
use anyhow::Context;
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use linkage_driver::plain_text::harmless;
use std::fmt::Display;
use std::io::{IsTerminal, Write};

/// How log events are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// A line of text an event, in colour on a terminal
    Text,
    /// A line of JSON an event
    Json,
}

/// Logs through `tracing`, filtered by `RUST_LOG` (warnings by default). There are no colour
/// codes where nobody sees colours: in a file, in a pipe, in the journal.
pub fn start_logging(format: LogFormat) {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn"));
    // An event that cannot be written is lost: to tell that on standard error would panic.
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .log_internal_errors(false);
    match format {
        LogFormat::Text => builder.with_ansi(shows_colours()).init(),
        LogFormat::Json => builder.with_ansi(false).json().init(),
    }
}

/// On a terminal, unless `NO_COLOR` is set (<https://no-color.org>).
fn shows_colours() -> bool {
    let unwanted = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    std::io::stderr().is_terminal() && !unwanted
}

/// Writes a line to standard error. That nobody can read there any more is no fault of the work.
pub fn say(line: impl Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Writes a line of a command's answer to standard output.
///
/// # Errors
/// It cannot be written, as on a full disk.
pub fn answer(line: impl Display) -> Outcome {
    writeln!(std::io::stdout(), "{line}").context("standard output: cannot be written")?;
    Ok(())
}

/// Says why a command failed, as the log's format has it. It may quote foreign files and messages.
pub fn report_failure(format: LogFormat, cause: &anyhow::Error) {
    match format {
        LogFormat::Text => say(format!("linkage: {}", harmless(&format!("{cause:#}"), usize::MAX))),
        LogFormat::Json => tracing::error!("{cause:#}"),
    }
}

/// Progress through a known or unknown number of steps: a bar on a terminal, a plain line at
/// the end of it otherwise, nothing when quiet.
pub struct Progress {
    bar: ProgressBar,
    label: String,
    plain: bool,
}

impl Progress {
    /// Starts one.
    pub fn new(label: &str, total: Option<usize>, quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = match total {
            Some(n) => ProgressBar::new(n as u64),
            None => ProgressBar::no_length(),
        };
        let target = if terminal && !quiet {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        bar.set_draw_target(target);
        if let Ok(style) =
            ProgressStyle::with_template("{prefix:>24} {bar:32} {pos}/{len} {per_sec} {msg}")
        {
            bar.set_style(style);
        }
        bar.set_prefix(label.to_owned());
        Self { bar, label: label.to_owned(), plain: !terminal && !quiet }
    }

    /// One step further.
    pub fn step(&self) {
        self.bar.inc(1);
    }

    /// Done; `outcome` says how it ended.
    pub fn finish(self, outcome: &str) {
        self.bar.finish_and_clear();
        if self.plain {
            say(format!("{}: {outcome}", self.label));
        }
    }
}
