//! How far the shortlist carries: the learned things among many made-up ones.

use super::Question;
use linkage_skill::appearance::{Appearance, ModelFeature};
use linkage_skill::geometry::median;
use linkage_skill::recognise::{Index, Words};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::time::Instant;

/// Sizes of libraries.
const SIZES: [usize; 5] = [100, 1_000, 10_000, 30_000, 100_000];
/// Features of a made-up object: more than the index takes.
const FEATURES: usize = 700;
/// Places in the shortlist that are asked about.
const PLACES: [usize; 3] = [1, 5, 20];

/// A library of one size.
#[derive(Serialize)]
pub struct Row {
    objects: usize,
    /// Share of known things among the first of the shortlist, for each of [`PLACES`].
    recall: [f64; 3],
    /// Median time of a shortlist, milliseconds.
    milliseconds: f64,
    /// Time to add an object, milliseconds.
    insertion_milliseconds: f64,
    bytes_per_object: f64,
}

/// Looks for each question's thing in larger and larger libraries.
pub fn run(learned: &[Appearance], questions: &[Question]) -> Vec<Row> {
    let mut index = Index::new();
    let start = Instant::now();
    for appearance in learned {
        index.insert(&Words::of(appearance));
    }
    let insertion_milliseconds = start.elapsed().as_secs_f64() * 1e3 / learned.len().max(1) as f64;
    println!("\nshortlists: learned things among made-up ones");
    println!("objects  recall@1    @5   @20  median ms  bytes/object  insertion ms");
    let features: Vec<&ModelFeature> = learned.iter().flat_map(|a| &a.features).collect();
    let mut rows = Vec::new();
    for objects in SIZES {
        let more: Vec<Words> = (index.len()..objects)
            .into_par_iter()
            .map(|seed| Words::of(&made_up(&features, seed as u64)))
            .collect();
        more.iter().for_each(|words| index.insert(words));
        let row = ask(&index, questions, insertion_milliseconds);
        println!(
            "{:>7} {:>9.2} {:>5.2} {:>5.2} {:>10.1} {:>13.0} {:>13.1}",
            row.objects,
            row.recall[0],
            row.recall[1],
            row.recall[2],
            row.milliseconds,
            row.bytes_per_object,
            row.insertion_milliseconds
        );
        rows.push(row);
    }
    rows
}

fn ask(index: &Index, questions: &[Question], insertion_milliseconds: f64) -> Row {
    let mut times = Vec::new();
    let mut found = [0_usize; PLACES.len()];
    for question in questions {
        let start = Instant::now();
        let ranked = index.rank(&question.features, PLACES[PLACES.len() - 1]);
        times.push(start.elapsed().as_secs_f64() * 1e3);
        let place = ranked.iter().position(|(object, _)| Some(*object) == question.number);
        for (count, places) in found.iter_mut().zip(PLACES) {
            *count += usize::from(place.is_some_and(|p| p < places));
        }
    }
    let known = questions.iter().filter(|q| q.number.is_some()).count().max(1) as f64;
    Row {
        objects: index.len(),
        recall: found.map(|n| n as f64 / known),
        milliseconds: median(&mut times).unwrap_or(0.0),
        insertion_milliseconds,
        bytes_per_object: index.bytes() as f64 / index.len().max(1) as f64,
    }
}

/// An object with as many features as the index takes of a learned one: each descriptor is half of one learned
/// feature's and half of another's.
pub fn made_up(features: &[&ModelFeature], seed: u64) -> Appearance {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let features = (0..FEATURES)
        .map(|_| {
            let a = features[rng.random_range(0..features.len())];
            let b = loop {
                let b = features[rng.random_range(0..features.len())];
                if b.kind == a.kind {
                    break b;
                }
            };
            ModelFeature { descriptor: between(&a.descriptor, &b.descriptor), ..a.clone() }
        })
        .collect();
    Appearance { features, ..Appearance::default() }
}

/// The descriptor half way between two, as long as they are.
fn between(a: &[u8], b: &[u8]) -> Vec<u8> {
    let length = |d: &[f32]| d.iter().map(|x| x * x).sum::<f32>().sqrt();
    let own: Vec<f32> = a.iter().map(|x| f32::from(*x)).collect();
    let sum: Vec<f32> = a.iter().zip(b).map(|(x, y)| f32::from(*x) + f32::from(*y)).collect();
    let scale = length(&own) / length(&sum).max(1e-6);
    sum.iter().map(|x| (x * scale).round().min(255.0) as u8).collect()
}
