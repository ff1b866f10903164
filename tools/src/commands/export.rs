//! `linkage export`.

use super::{Outcome, write_json};
use crate::cli::ExportArgs;
use anyhow::anyhow;
use linkage_skill::store::Store;
use std::path::Path;

pub fn run(args: &ExportArgs) -> Outcome {
    if args.format != "json" {
        return Err(anyhow!("no format \"{}\"; known: json", args.format).into());
    }
    let model = Store::open(&args.store)?.get(&args.object)?.model;
    write_json(args.out.as_deref().unwrap_or(Path::new("-")), &model)
}
