//! Which of many objects may be in a picture: the paper's bag of words (section III-E) with
//! what depth adds. A feature votes for the objects that have its word, in its metric size and
//! with a like code; votes count together where they lie together in space.

mod vocabulary;

pub use vocabulary::{NotAVocabulary, Vocabulary};

use crate::appearance::{
    Appearance, DescribedFeature, FeatureKind, ModelFeature, bytes_of, quantise,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};
use vocabulary::{Coded, WORDS};

/// Bits in which codes of one surface point may differ.
const MAX_BITS: u32 = 20;
/// Standard deviation of that difference, in the weight of a vote.
const SIGMA_BITS: f64 = 12.0;
/// Steps of size in an octave.
const SIZE_STEPS: f32 = 4.0;
/// Side of a region whose votes count together, metres.
const REGION_M: f64 = 0.35;

/// An object's features as the index needs them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Words(Vec<Word>);

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Word {
    word: u16,
    code: u64,
    kind: FeatureKind,
    size: i8,
}

impl Words {
    /// Of an object's features: of each part those that most keyframes bear out, which come
    /// first.
    pub fn of(appearance: &Appearance) -> Self {
        let vocabulary = Vocabulary::standard();
        let parts: HashSet<u16> = appearance.features.iter().map(|f| f.part).collect();
        let mut taken: HashMap<(u16, FeatureKind), usize> = HashMap::new();
        let chosen: Vec<&ModelFeature> = appearance
            .features
            .iter()
            .filter(|f| {
                let count = taken.entry((f.part, f.kind)).or_default();
                *count += 1;
                *count <= most_of(f.kind) / parts.len()
            })
            .collect();
        let word_of = |f: &&ModelFeature| {
            let Coded { word, code } = vocabulary.words(&bytes_of(&f.descriptor))[0];
            Word { word, code, kind: f.kind, size: size_step(f.size_m) }
        };
        Self(chosen.par_iter().map(word_of).collect())
    }
}

/// Features of an object that are indexed: rectified ones tell more.
fn most_of(kind: FeatureKind) -> usize {
    match kind {
        FeatureKind::Rectified => 320,
        FeatureKind::Picture => 160,
        FeatureKind::Upright => 0,
    }
}

/// A feature of an object, listed by its word, kind and size.
#[derive(Debug, Clone, Copy)]
struct Posting {
    code: u64,
    object: u32,
}

/// The inverted index of many objects.
pub struct Index {
    vocabulary: &'static Vocabulary,
    postings: Vec<Vec<Posting>>,
    objects: usize,
    features: usize,
}

/// Steps of size that are told apart.
const SIZES: i32 = 32;
/// The smallest of them: 1 mm.
const SMALLEST: i32 = -8;
/// Lists of a word: for each kind and size.
const LISTS: usize = 3 * SIZES as usize;

/// The list of a word, kind and size. A damaged word falls under another.
fn list_of(word: u16, kind: FeatureKind, size: i32) -> usize {
    let kind = kind as usize;
    let size = (size - SMALLEST).clamp(0, SIZES - 1) as usize;
    (usize::from(word) % WORDS) * LISTS + kind * SIZES as usize + size
}

impl Index {
    /// Of no objects yet.
    pub fn new() -> Self {
        Self {
            vocabulary: Vocabulary::standard(),
            postings: vec![Vec::new(); WORDS * LISTS],
            objects: 0,
            features: 0,
        }
    }

    /// Adds an object; objects are numbered in the order in which they are added.
    pub fn insert(&mut self, words: &Words) {
        let object = self.objects as u32;
        for &Word { word, code, kind, size } in &words.0 {
            let list = list_of(word, kind, i32::from(size));
            self.postings[list].push(Posting { code, object });
        }
        self.features += words.0.len();
        self.objects += 1;
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.objects
    }

    /// True before the first object.
    pub fn is_empty(&self) -> bool {
        self.objects == 0
    }

    /// Bytes that the postings take.
    pub fn bytes(&self) -> usize {
        self.features * size_of::<Posting>()
    }

    /// The first `places` objects by their votes, most first; those with few are left out.
    pub fn rank(&self, seen: &[DescribedFeature], places: usize) -> Vec<(usize, f64)> {
        let votes: Vec<Vec<Vote>> = seen.par_iter().map(|f| self.votes_of(f)).collect();
        // All votes of an object are no fewer than those of its best region: these alone are
        // counted for objects that may come among the first.
        let mut totals = vec![(0_u32, 0.0); self.objects];
        for vote in votes.iter().flatten() {
            let (count, total) = &mut totals[vote.object as usize];
            *count += 1;
            *total += vote.weight;
        }
        let mut hopeful: Vec<(u32, f64)> = (0..)
            .zip(&totals)
            .filter(|(_, (count, _))| *count >= LEAST_VOTES)
            .map(|(object, (_, total))| (object, *total))
            .collect();
        let first = (2 * places).min(hopeful.len());
        if first < hopeful.len() {
            hopeful.select_nth_unstable_by(first, |a, b| b.1.total_cmp(&a.1));
        }
        let others = hopeful.split_off(first);
        let mut ranked = self.in_regions(&votes, seen, &hopeful);
        let least = ranked.get(places.saturating_sub(1)).map_or(0.0, |r| r.1);
        let others: Vec<(u32, f64)> = others.into_iter().filter(|o| o.1 >= least).collect();
        ranked.extend(self.in_regions(&votes, seen, &others));
        ranked.sort_by(most_first);
        ranked.truncate(places);
        ranked
    }

    /// Objects by the votes of their best regions, most first.
    fn in_regions(
        &self,
        votes: &[Vec<Vote>],
        seen: &[DescribedFeature],
        objects: &[(u32, f64)],
    ) -> Vec<(usize, f64)> {
        const NONE: u32 = u32::MAX;
        let mut slots = vec![NONE; self.objects];
        for (slot, (object, _)) in (0..).zip(objects) {
            slots[*object as usize] = slot;
        }
        let mut placed: Vec<Vec<(Cell, f64)>> = vec![Vec::new(); objects.len()];
        for (feature, votes) in seen.iter().zip(votes) {
            let cell = cell_of(feature);
            for vote in votes {
                let slot = slots[vote.object as usize];
                if slot != NONE {
                    placed[slot as usize].push((cell, vote.weight));
                }
            }
        }
        let mut ranked: Vec<(usize, f64)> = objects
            .par_iter()
            .zip(placed)
            .map(|((object, _), votes)| (*object as usize, most_in_a_region(votes)))
            .collect();
        ranked.sort_by(most_first);
        ranked
    }

    /// Objects that a feature votes for, each once.
    fn votes_of(&self, feature: &DescribedFeature) -> Vec<Vote> {
        let size = i32::from(size_step(feature.size as f32));
        let sizes = match (feature.point, feature.kind) {
            (None, _) => SMALLEST..=SMALLEST + SIZES - 1,
            (_, FeatureKind::Rectified | FeatureKind::Upright) => size..=size,
            (_, FeatureKind::Picture) => size - 2..=size + 2,
        };
        let mut fitting: Vec<(u32, u32)> = Vec::new();
        for coded in self.vocabulary.words(&quantise(&feature.descriptor)) {
            for size in sizes.clone() {
                for p in &self.postings[list_of(coded.word, feature.kind, size)] {
                    let bits = (p.code ^ coded.code).count_ones();
                    if bits <= MAX_BITS {
                        fitting.push((p.object, bits));
                    }
                }
            }
        }
        fitting.sort_unstable();
        fitting.dedup_by_key(|v| v.0);
        // What many objects have tells little.
        let rarity = (self.objects as f64 / fitting.len().max(1) as f64).ln() + 1.0;
        let weight = |bits: u32| rarity * (-(f64::from(bits) / SIGMA_BITS).powi(2)).exp();
        fitting.into_iter().map(|(object, bits)| Vote { object, weight: weight(bits) }).collect()
    }
}

/// By weight, then by number.
fn most_first(a: &(usize, f64), b: &(usize, f64)) -> Ordering {
    b.1.total_cmp(&a.1).then(a.0.cmp(&b.0))
}

/// A feature's vote for an object.
struct Vote {
    object: u32,
    weight: f64,
}

/// Where a feature is, in halves of a region.
type Cell = [i32; 3];

fn cell_of(feature: &DescribedFeature) -> Cell {
    let number = |x: f64| (x / (0.5 * REGION_M)).floor() as i32;
    feature.point.map_or([0; 3], |p| [p.x, p.y, p.z].map(number))
}

/// Fewest votes of an object that is ranked.
const LEAST_VOTES: u32 = 3;

/// The greatest weight of an object's votes that lie in one region.
fn most_in_a_region(mut votes: Vec<(Cell, f64)>) -> f64 {
    votes.sort_by_key(|v| v.0);
    let cells: Vec<(Cell, f64)> = votes
        .chunk_by(|a, b| a.0 == b.0)
        .map(|same| (same[0].0, same.iter().map(|c| c.1).sum()))
        .collect();
    let from = |corner: &Cell| -> f64 {
        let inside = |c: &Cell| (0..3).all(|k| (0..2).contains(&(c[k] - corner[k])));
        cells.iter().filter(|(c, _)| inside(c)).map(|c| c.1).sum()
    };
    cells.iter().map(|(corner, _)| from(corner)).fold(0.0, f64::max)
}

impl Default for Index {
    fn default() -> Self {
        Self::new()
    }
}

fn size_step(size_m: f32) -> i8 {
    (SIZE_STEPS * (size_m.max(1e-6) / 0.004).log2()).round().clamp(-100.0, 100.0) as i8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::appearance::DESCRIPTOR_LENGTH;
    use nalgebra::{Point3, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn descriptor(rng: &mut ChaCha8Rng) -> [f32; DESCRIPTOR_LENGTH] {
        let raw: [f32; DESCRIPTOR_LENGTH] = std::array::from_fn(|_| rng.random::<f32>().powi(4));
        let norm = raw.iter().map(|x| x * x).sum::<f32>().sqrt();
        raw.map(|x| x / norm)
    }

    fn object(seed: u64) -> Appearance {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let features = (0..200)
            .map(|_| ModelFeature {
                part: 0,
                kind: FeatureKind::Rectified,
                point: [0.0; 3],
                normal: [0.0; 3],
                size_m: 0.016,
                descriptor: quantise(&descriptor(&mut rng)).to_vec(),
            })
            .collect();
        Appearance { features, ..Appearance::default() }
    }

    /// Every third feature of an object, `size` times as large as it is.
    fn seen(seed: u64, size: f64) -> Vec<DescribedFeature> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..200)
            .map(|_| descriptor(&mut rng))
            .step_by(3)
            .map(|descriptor| DescribedFeature {
                kind: FeatureKind::Rectified,
                pixel: [0.0; 2],
                point: Some(Point3::new(0.1, 0.1, 1.0)),
                normal: Vector3::zeros(),
                size: 0.016 * size,
                descriptor,
            })
            .collect()
    }

    fn twenty_objects() -> Index {
        let mut index = Index::new();
        (0..20).for_each(|seed| index.insert(&Words::of(&object(seed))));
        index
    }

    #[test]
    fn the_object_whose_features_are_seen_ranks_first() {
        let ranked = twenty_objects().rank(&seen(13, 1.0), 5);
        assert_eq!(ranked[0].0, 13);
        assert!(ranked.get(1).is_none_or(|second| ranked[0].1 > 3.0 * second.1), "{ranked:?}");
    }

    #[test]
    fn the_first_places_are_those_of_the_whole_ranking() {
        // Of each object something is seen, the more of it in one place the lower its number.
        let seen: Vec<DescribedFeature> = (0..20)
            .flat_map(|number| {
                seen(number, 1.0).into_iter().enumerate().map(move |(i, feature)| {
                    let apart = (i % (1 + number as usize)) as f64;
                    DescribedFeature { point: Some(Point3::new(apart, 0.0, 1.0)), ..feature }
                })
            })
            .collect();
        let index = twenty_objects();
        let whole = index.rank(&seen, 20);
        assert_eq!(whole.len(), 20);
        for places in 1..20 {
            assert_eq!(index.rank(&seen, places), whole[..places]);
        }
    }

    #[test]
    fn what_has_another_size_is_another_thing() {
        let index = twenty_objects();
        let votes =
            |size| index.rank(&seen(13, size), 20).iter().find(|r| r.0 == 13).map_or(0.0, |r| r.1);
        assert!(votes(2.0) < 0.1 * votes(1.0));
    }
}
