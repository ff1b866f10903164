//! The `linkage` command line (DESIGN 4.3).

mod allocator;
mod bench;
mod cli;
mod commands;
mod console;
mod export;
#[cfg(test)]
mod hostile;
mod interrupt;
mod report;
mod simulate;
mod tags;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    allocator::keep_for_the_next_frame();
    sigpipe::reset();
    let cli = match cli::Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors; both print themselves.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    let log_format = cli.common.log_format;
    console::start_logging(log_format);
    match commands::run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            console::report_failure(log_format, &failure.cause);
            ExitCode::from(failure.status)
        }
    }
}
