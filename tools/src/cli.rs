//! Options, as DESIGN 4.3 fixes them.

use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

/// Learns how articulated things move by watching a person move them once; recognises them,
/// predicts their motion, and publishes it over LCM.
#[derive(Debug, Parser)]
#[command(name = "linkage", version, max_term_width = 100)]
pub struct Cli {
    #[command(flatten)]
    pub common: Common,
    #[command(subcommand)]
    pub command: Command,
}

/// Options of all commands.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Configuration file: holds what differs from the profile
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Profile: default or paper
    #[arg(long, global = true, default_value = "default", value_name = "NAME")]
    pub profile: String,
    /// Seed of all random sampling
    #[arg(long, global = true, value_name = "N")]
    pub seed: Option<u64>,
    /// No progress
    #[arg(long, global = true)]
    pub quiet: bool,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Learn an object from demonstrations
    Learn(LearnArgs),
    /// Score recordings with truth beside them
    Bench(BenchArgs),
}

#[derive(Debug, Args)]
pub struct LearnArgs {
    /// Recordings of one object: a directory or tum:DIR
    #[arg(required = true)]
    pub sources: Vec<String>,
    /// Name of the object
    #[arg(long)]
    pub object: String,
    /// Store to put the object into
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
    /// Write the model as JSON (linkage.model/1); - for standard output
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write the pose of each part in each frame
    #[arg(long, value_name = "FILE.csv")]
    pub poses: Option<PathBuf>,
    /// Write a page to look at
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct BenchArgs {
    /// dir: score every recording of a folder
    #[arg(long, default_value = "dir")]
    pub suite: String,
    /// Folder of recordings, for --suite dir
    pub dir: Option<PathBuf>,
    /// Write the figures as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}
