//! `linkage simulate`.
use super::Outcome;
use crate::cli::{Common, SimulateArgs};
pub fn run(_: &SimulateArgs, _: &Common) -> Outcome { Ok(()) }
