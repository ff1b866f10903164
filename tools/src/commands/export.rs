//! `linkage export`.

use crate::cli::{ExportArgs, ExportFormat};
use crate::export::{Description, mjcf, sdf, urdf};
use crate::outcome::Outcome;
use crate::output::{write_json, write_text};
use anyhow::Context;
use linkage_skill::store::Store;
use std::path::Path;

pub fn run(args: &ExportArgs) -> Outcome {
    let object = Store::open(&args.store)?.get(&args.object)?;
    let out = args.out.as_deref().unwrap_or(Path::new("-"));
    let write = match args.format {
        ExportFormat::Json => return write_json(out, &object.model),
        ExportFormat::Urdf => urdf,
        ExportFormat::Sdf => sdf,
        ExportFormat::Mjcf => mjcf,
    };
    let text = write(&Description::new(&object)?).context("writing the description")?;
    write_text(out, &text)
}
