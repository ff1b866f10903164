//! The `linkage` command line (DESIGN 4.3).

mod bench;
mod cli;
mod commands;
mod console;
mod export;
mod report;
mod simulate;
mod tags;

use clap::Parser;
use std::process::ExitCode;

/// Memory that one thread takes and another gives back stays bounded.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    sigpipe::reset();
    let cli = match cli::Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors; both print themselves.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    console::start_logging();
    match commands::run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("linkage: {:#}", failure.cause);
            ExitCode::from(failure.status)
        }
    }
}
