//! What the user sees while a command runs: progress and logs, on standard error.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;

/// Logs through `tracing`, filtered by `RUST_LOG` (warnings by default).
pub fn start_logging() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
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
            eprintln!("{}: {outcome}", self.label);
        }
    }
}
