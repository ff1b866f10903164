//! `linkage vocabulary`: makes the vocabulary again that stores are indexed with. Its pictures
//! are the simulator's things of the paper's ten kinds, none of which `bench --suite recognise`
//! learns.

use crate::cli::{Common, VocabularyArgs};
use crate::console::Progress;
use crate::outcome::Outcome;
use crate::simulate::{Shot, Take, instances, record, scene};
use crate::steps::last_frame;
use anyhow::{Context, anyhow};
use linkage_skill::internals::{Descriptor, Vocabulary, quantise};
use linkage_skill::recognise::Scene;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Viewpoints of each thing, degrees.
const TURNS: [f64; 3] = [-35.0, 5.0, 40.0];
/// Descriptors that the words are made of.
const DESCRIPTORS: usize = 200_000;

pub fn run(args: &VocabularyArgs, common: &Common) -> Outcome {
    let names: Vec<String> = instances::names().collect();
    let progress = Progress::new("describing", Some(names.len() * TURNS.len()), common.quiet);
    let mut descriptors: Vec<Descriptor> = Vec::new();
    for (i, name) in names.iter().enumerate() {
        for (k, turn) in TURNS.into_iter().enumerate() {
            let seed = 8800 + (TURNS.len() * i + k) as u64;
            let dir = args.work.join(format!("{name}_{k}"));
            descriptors.extend(described(name, turn, seed, &dir)?);
            progress.step();
        }
    }
    descriptors.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
    descriptors.truncate(DESCRIPTORS);
    progress.finish(&format!("{} descriptors", descriptors.len()));
    let vocabulary = Vocabulary::train(&descriptors);
    std::fs::write(&args.out, vocabulary.to_bytes())
        .with_context(|| args.out.display().to_string())?;
    Ok(())
}

/// All descriptors of a still.
fn described(
    name: &str,
    turn_deg: f64,
    seed: u64,
    dir: &std::path::Path,
) -> Outcome<Vec<Descriptor>> {
    if !dir.join("truth.json").is_file() {
        let staged = scene(name, seed).ok_or_else(|| anyhow!("no scene \"{name}\""))?;
        let shot = Shot {
            turn_deg,
            lift_deg: 0.0,
            roll_deg: 0.0,
            distance: 1.0,
            light: 1.0,
            open: 0.4,
            occluded: false,
        };
        record(&staged, Take::Still(shot), seed, dir, false, || {})?;
    }
    let frame = last_frame(&dir.display().to_string())?;
    let features = Scene::new(&frame)?.features;
    Ok(features.iter().map(|f| quantise(&f.descriptor)).collect())
}
