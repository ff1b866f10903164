//! The `linkage` command line.

// What is printed goes through `console`: on a full disk the macros of `std` panic.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod allocator;
#[expect(clippy::print_stdout, reason = "its tables are for those who develop this")]
mod bench;
mod cli;
mod commands;
mod console;
mod export;
#[cfg(test)]
mod hostile;
mod interrupt;
mod outcome;
mod output;
mod report;
mod simulate;
mod source;
mod steps;
mod tags;
mod truth;
mod view;

use clap::Parser;
use cli::{Cli, Command};
use outcome::Outcome;
use std::process::ExitCode;

fn main() -> ExitCode {
    allocator::keep_for_the_next_frame();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors; both print themselves.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    // A command ends where nobody reads on, as `head` does; the service outlives who reads its log.
    if !matches!(cli.command, Command::Serve(_)) {
        sigpipe::reset();
    }
    let log_format = cli.common.log_format;
    console::start_logging(log_format);
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            console::report_failure(log_format, &failure.cause);
            ExitCode::from(failure.status)
        }
    }
}

/// Runs a command.
fn run(cli: Cli) -> Outcome {
    let common = &cli.common;
    match cli.command {
        Command::Demo(args) => commands::demo::run(&args, common),
        Command::Learn(args) => commands::learn::run(&args, common),
        Command::Recognise(args) => commands::recognise::run(&args, common),
        Command::Predict(args) => commands::predict::run(&args, common),
        Command::Serve(args) => commands::serve::run(&args, common),
        Command::Tell(args) => commands::command::run(&args),
        Command::Listen(args) => commands::listen::run(&args),
        Command::Record(args) => commands::record::run(&args, common),
        Command::Replay(args) => commands::replay::run(&args, common),
        Command::Fit(args) => commands::fit::run(&args, common),
        Command::Store(args) => commands::store::run(&args),
        Command::Export(args) => commands::export::run(&args),
        Command::Simulate(args) => commands::simulate::run(&args, common),
        Command::Vocabulary(args) => commands::vocabulary::run(&args, common),
        Command::Bench(args) => bench::run(&args, common),
        Command::Doctor(args) => commands::doctor::run(&args),
        Command::Config(args) => commands::config::run(&args, common),
    }
}
