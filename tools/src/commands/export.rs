//! `linkage export`.

use super::{Outcome, write_json};
use crate::cli::{ExportArgs, ExportFormat};
use crate::export::{Description, mjcf, sdf, urdf};
use anyhow::Context;
use linkage_skill::store::Store;
use std::path::Path;

pub fn run(args: &ExportArgs) -> Outcome {
    let object = Store::open(&args.store)?.get(&args.object)?;
    let write = match args.format {
        ExportFormat::Json => {
            return write_json(args.out.as_deref().unwrap_or(Path::new("-")), &object.model);
        }
        ExportFormat::Urdf => urdf,
        ExportFormat::Sdf => sdf,
        ExportFormat::Mjcf => mjcf,
    };
    let text = write(&Description::new(&object)?).context("writing the description")?;
    match &args.out {
        None => print!("{text}"),
        Some(path) => {
            std::fs::write(path, text).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}
