//! `linkage simulate`.

use super::Outcome;
use crate::cli::{Common, SimulateArgs};
use crate::console::Progress;
use crate::simulate::{SCENES, Take, record, scene};
use anyhow::anyhow;
use std::path::Path;

pub fn run(args: &SimulateArgs, common: &Common) -> Outcome {
    if args.scene == "list" {
        for (name, story) in SCENES {
            println!("{name:14} {story}");
        }
        return Ok(());
    }
    let take = if args.encounter { Take::Encounter } else { Take::Demonstration };
    let out = args.out.as_deref().ok_or_else(|| anyhow!("say where to with --out DIR"))?;
    film(&args.scene, take, args.tags, common.seed.unwrap_or(1), out, common.quiet)
}

/// Renders a scene with progress.
pub fn film(
    name: &str,
    take: Take,
    with_tags: bool,
    seed: u64,
    out: &Path,
    quiet: bool,
) -> Outcome {
    let scene = scene(name, seed).ok_or_else(|| {
        let known: Vec<&str> = SCENES.iter().map(|s| s.0).collect();
        anyhow!("no scene \"{name}\"; known: {}", known.join(", "))
    })?;
    let total = take.frames(&scene);
    let progress = Progress::new("rendering", Some(total), quiet);
    record(&scene, take, seed, out, with_tags, || progress.step())?;
    progress.finish(&format!("{total} frames in {}", out.display()));
    Ok(())
}
