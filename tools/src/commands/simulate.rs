//! `linkage simulate`.

use crate::cli::{Common, SimulateArgs};
use crate::console::answer;
use crate::outcome::Outcome;
use crate::simulate::{SCENES, Take};
use crate::steps::{FilmOrder, film};
use anyhow::anyhow;

pub fn run(args: &SimulateArgs, common: &Common) -> Outcome {
    if args.scene == "list" {
        for (name, description) in SCENES {
            answer(format!("{name:14} {description}"))?;
        }
        return Ok(());
    }
    let take = if args.encounter { Take::Encounter } else { Take::Demonstration };
    let out = args.out.as_deref().ok_or_else(|| anyhow!("say where to with --out DIR"))?;
    let order = FilmOrder {
        scene: &args.scene,
        take,
        surfaces: args.surfaces,
        with_tags: args.tags,
        seed: common.seed.unwrap_or(1),
    };
    film(&order, out, common.quiet)
}
