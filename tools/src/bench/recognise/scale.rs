//! How far the shortlist carries: the learned things among many synthetic ones.

use super::question::Question;
use crate::outcome::Outcome;
use anyhow::{Context, anyhow};
use linkage_skill::internals::{Index, ModelFeature, Words, median};
use linkage_skill::object::{Appearance, StoredObject};
use linkage_skill::store::Store;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// Sizes of libraries.
const SIZES: [usize; 5] = [100, 1_000, 10_000, 30_000, 100_000];
/// Objects written at a time.
const AT_ONCE: usize = 500;
/// Features of a synthetic object: more than the index takes.
const FEATURES: usize = 700;
/// Places in the shortlist that are asked about.
const PLACES: [usize; 3] = [1, 5, MOST_PLACES];
const MOST_PLACES: usize = 20;

/// A library of one size.
#[derive(Serialize)]
pub struct Row {
    objects: usize,
    /// Share of known things among the first of the shortlist, for each of [`PLACES`].
    recall: [f64; 3],
    /// Median time of a shortlist, milliseconds.
    milliseconds: f64,
    bytes_per_object: f64,
    /// Times of a store that holds them; the largest libraries are not written to a store.
    store: Option<StoreTimes>,
}

/// How long a store takes, milliseconds.
#[derive(Serialize)]
struct StoreTimes {
    /// Time to open it and prepare it for the first picture.
    opening: f64,
    /// The shortlist of the first picture after that, for which what it needs is read.
    first_shortlist: f64,
    /// The median over the shortlists of the others, each seen for the first time.
    shortlist: f64,
    /// Time to insert one more object.
    insertion: f64,
}

/// Looks for each question's thing in larger and larger libraries, of which those of up to
/// `largest_store` objects are written to a store as well.
pub fn run(
    learned: &[StoredObject],
    questions: &[Question],
    largest_store: usize,
) -> Outcome<Vec<Row>> {
    println!("\nshortlists: learned things among made-up ones");
    println!("{:>57}   of a store, ms", "");
    println!(
        "objects  recall@1    @5   @20  median ms  bytes/object      open    first   others   insert"
    );
    let features: Vec<&ModelFeature> =
        learned.iter().flat_map(|l| &l.appearance.features).collect();
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("many.linkage");
    let mut store = Store::open_or_create(&path)?;
    store.put_all(learned)?;
    // Made-up features lie on parts of any of them.
    let most_parts = learned.iter().max_by_key(|l| l.model.parts.len());
    let like = most_parts.ok_or_else(|| anyhow!("nothing was learned"))?;
    let mut words: Vec<Words> = learned.iter().map(|l| Words::of(&l.appearance)).collect();
    let mut rows = Vec::new();
    for objects in SIZES {
        while words.len() < objects {
            let first = words.len();
            let more: Vec<Appearance> = (first..objects.min(first + AT_ONCE))
                .into_par_iter()
                .map(|seed| made_up(&features, seed as u64))
                .collect();
            words.par_extend(more.par_iter().map(Words::of));
            if objects <= largest_store {
                store.put_all(&stored(more, first, like))?;
            }
        }
        let (recall, milliseconds, bytes_per_object) =
            ask(&Index::new(words.iter().cloned()), questions);
        let store = if objects <= largest_store {
            Some(times(&mut store, &path, &learned[0], questions)?)
        } else {
            None
        };
        let row = Row { objects, recall, milliseconds, bytes_per_object, store };
        print_row(&row);
        rows.push(row);
    }
    Ok(rows)
}

fn print_row(row: &Row) {
    let [first, five, twenty] = row.recall;
    let of_store = row.store.as_ref().map_or_else(
        || ["-"; 4].map(|none| format!("{none:>8}")),
        |s| [s.opening, s.first_shortlist, s.shortlist, s.insertion].map(|ms| format!("{ms:>8.1}")),
    );
    println!(
        "{:>7} {first:>9.2} {five:>5.2} {twenty:>5.2} {:>10.1} {:>13.0}  {}",
        row.objects,
        row.milliseconds,
        row.bytes_per_object,
        of_store.join(" "),
    );
}

/// Made-up appearances under names of their own.
fn stored(appearances: Vec<Appearance>, first: usize, like: &StoredObject) -> Vec<StoredObject> {
    let named = |(number, appearance): (usize, Appearance)| {
        let mut model = like.model.clone();
        model.object = format!("made up {number}");
        StoredObject { model, appearance, provenance: Vec::new() }
    };
    (first..).zip(appearances).map(named).collect()
}

/// Opens a store that holds many objects, asks what is in pictures, and puts one more in and out.
fn times(
    store: &mut Store,
    path: &Path,
    object: &StoredObject,
    questions: &[Question],
) -> Outcome<StoreTimes> {
    let mut another = object.clone();
    another.model.object = "one more".to_owned();
    let (put, insertion) = timed(|| store.put(&another));
    put?;
    store.remove("one more")?;
    let (library, opening) = timed(|| Store::open(path)?.load());
    let library = library?;
    let mut shortlists = Vec::new();
    for question in questions {
        let (ranked, milliseconds) = timed(|| library.rank(&question.features, MOST_PLACES));
        ranked?;
        shortlists.push(milliseconds);
    }
    let (first, others) = shortlists.split_first_mut().context("no stills to look at")?;
    let shortlist = median(others).unwrap_or(0.0);
    Ok(StoreTimes { opening, first_shortlist: *first, shortlist, insertion })
}

/// Its result, and after how many milliseconds.
fn timed<T>(run: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = run();
    (result, start.elapsed().as_secs_f64() * 1e3)
}

/// Recall of a shortlist, its median time in milliseconds, and bytes an object takes.
fn ask(index: &Index, questions: &[Question]) -> ([f64; 3], f64, f64) {
    let mut times = Vec::new();
    let mut found = [0_usize; PLACES.len()];
    for question in questions {
        let (ranked, milliseconds) = timed(|| index.rank(&question.features, MOST_PLACES));
        times.push(milliseconds);
        let place = ranked.iter().position(|(object, _)| Some(*object) == question.number);
        for (count, places) in found.iter_mut().zip(PLACES) {
            *count += usize::from(place.is_some_and(|p| p < places));
        }
    }
    let known = questions.iter().filter(|q| q.number.is_some()).count().max(1) as f64;
    let bytes_per_object = index.bytes() as f64 / index.len().max(1) as f64;
    (found.map(|n| n as f64 / known), median(&mut times).unwrap_or(0.0), bytes_per_object)
}

/// An object with as many features as the index takes of a learned one: each descriptor is half of
/// one learned feature's and half of another's.
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
