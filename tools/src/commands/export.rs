//! `linkage export`.

use crate::cli::{ExportArgs, ExportFormat};
use crate::export::{Description, json, mjcf, sdf, urdf, usd};
use crate::outcome::Outcome;
use crate::output::{write_json, write_text};
use anyhow::{Context, anyhow, bail};
use linkage_planner_bridge::Rig;
use linkage_skill::store::Store;
use std::path::Path;

pub fn run(args: &ExportArgs) -> Outcome {
    if args.mesh && matches!(args.format, ExportFormat::Json) {
        let reason =
            "json has no meshes: leave --mesh out, or give --format urdf, sdf, mjcf or usd";
        return Err(anyhow!(reason).into());
    }
    let object = Store::open(&args.store)?.get(&args.object)?;
    let out = args.out.as_deref().unwrap_or(Path::new("-"));
    let rig = match &args.rig {
        Some(path) => Rig::read(path)?,
        None => Rig::default(),
    };
    let write = match args.format {
        ExportFormat::Json => return write_json(out, &json(&object.model, &rig)),
        ExportFormat::Urdf => urdf,
        ExportFormat::Sdf => sdf,
        ExportFormat::Mjcf => mjcf,
        ExportFormat::Usd => usd,
    };
    let mut description = Description::new(&object, &rig)?;
    for link in description.links.iter().filter(|link| !link.is_seen) {
        let (object, part) = (&args.object, &link.name);
        tracing::warn!(
            object,
            part,
            "nothing of its surface was learned: a box of 4 cm stands for it"
        );
    }
    for pair in description.overlapping() {
        let [one, other] = pair.map(|link| description.links[link].name.as_str());
        tracing::warn!(
            object = args.object,
            one,
            other,
            "their boxes overlap at the beginning or in the middle of the range: MJCF excludes their contact; in other formats filter it"
        );
    }
    if let Some(share) = description.little_of_base() {
        let object = &args.object;
        let percent = (100.0 * share).round();
        tracing::warn!(
            object,
            percent,
            "little was seen of what the parts hang on: its boxes have that share of the volume of theirs. Demonstrate it \
             from where its sides are seen, too"
        );
    }
    if args.mesh {
        description = description.with_meshes(&object, &meshes_folder(out)?);
        write_meshes(&description, out)?;
    }
    let text = write(&description).context("writing the description")?;
    write_text(out, &text)
}

/// Name of the folder beside a file that holds its meshes.
fn meshes_folder(out: &Path) -> anyhow::Result<String> {
    match out.file_stem().and_then(|stem| stem.to_str()) {
        Some(stem) if stem != "-" => Ok(format!("{stem}_meshes")),
        _ => bail!("{}: meshes need an --out that is a file with a readable name", out.display()),
    }
}

fn write_meshes(description: &Description, out: &Path) -> Outcome {
    let folder = out.parent().unwrap_or(Path::new(""));
    for link in &description.links {
        if let Some(mesh) = &link.mesh {
            write_text(&folder.join(&mesh.file), &mesh.obj(&link.name))?;
        }
    }
    Ok(())
}
