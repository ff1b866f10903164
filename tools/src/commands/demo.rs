//! `linkage demo`.
use super::Outcome;
use crate::cli::{Common, DemoArgs};
pub fn run(_: &DemoArgs, _: &Common) -> Outcome { Ok(()) }
