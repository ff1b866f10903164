//! Which of many objects may be in a picture: the paper's bag of words (section III-E) with
//! what depth adds. A feature votes for the objects that have its word, in its metric size and
//! with a like code; votes count together where they lie together in space.

mod vocabulary;
mod words;

pub use vocabulary::{NotAVocabulary, Vocabulary};
pub use words::Words;

use crate::appearance::{DescribedFeature, FeatureKind, quantise};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::ops::Range;
use words::{LISTS, SIZES, SMALLEST, list_of, size_step};

/// Bits in which codes of one surface point may differ.
const MAX_BITS: u32 = 20;
/// Standard deviation of that difference, in the weight of a vote.
const SIGMA_BITS: f64 = 12.0;
/// Side of a region whose votes count together, metres.
const REGION_M: f64 = 0.35;

/// The inverted index of many objects.
pub struct Index {
    vocabulary: &'static Vocabulary,
    shelves: Vec<Shelf>,
    objects: usize,
}

/// Postings of some neighbouring lists, one list after the other.
struct Shelf {
    lists: Range<usize>,
    /// Where the postings of each list begin, and where those of the last one end.
    starts: Vec<u32>,
    postings: Vec<Posting>,
}

/// A feature of an object.
#[derive(Debug, Clone, Copy, Default)]
struct Posting {
    /// In halves, the lower first: a whole one would leave gaps.
    code: [u32; 2],
    object: u32,
}

impl Posting {
    fn bits_apart(&self, code: u64) -> u32 {
        let [low, high] = self.code.map(u64::from);
        ((low | high << 32) ^ code).count_ones()
    }
}

/// An index in the making: postings are counted before any is put in its place, so that all words
/// are gone through twice and need not be in memory at once.
pub struct Counted {
    shelves: Vec<Shelf>,
    objects: usize,
}

/// Its postings have places: all that were counted are put there, in any order.
pub struct Filled {
    shelves: Vec<(Shelf, Vec<u32>)>,
    objects: usize,
}

impl Counted {
    /// Of no objects yet.
    pub fn new() -> Self {
        let lists = LISTS.div_ceil(rayon::current_num_threads());
        let shelf = |first: usize| {
            let lists = first..(first + lists).min(LISTS);
            let starts = vec![0; lists.len() + 1];
            Shelf { lists, starts, postings: Vec::new() }
        };
        Self { shelves: (0..LISTS).step_by(lists).map(shelf).collect(), objects: 0 }
    }

    /// Counts the words of some objects.
    pub fn count(&mut self, objects: &[(u32, Words)]) {
        self.objects += objects.len();
        self.shelves.par_iter_mut().for_each(|shelf| {
            for (list, _) in objects.iter().flat_map(|(_, words)| words.iter()) {
                if shelf.lists.contains(&list) {
                    shelf.starts[list - shelf.lists.start + 1] += 1;
                }
            }
        });
    }

    /// All are counted.
    pub fn counted(self) -> Filled {
        let with_places = |mut shelf: Shelf| {
            for list in 0..shelf.lists.len() {
                shelf.starts[list + 1] += shelf.starts[list];
            }
            shelf.postings = vec![Posting::default(); shelf.starts[shelf.lists.len()] as usize];
            let next = shelf.starts.clone();
            (shelf, next)
        };
        let shelves = self.shelves.into_par_iter().map(with_places).collect();
        Filled { shelves, objects: self.objects }
    }
}

impl Filled {
    /// Puts the words of some objects, which have these numbers, in their places.
    pub fn fill(&mut self, objects: &[(u32, Words)]) {
        self.shelves.par_iter_mut().for_each(|(shelf, next)| {
            for &(object, ref words) in objects {
                for (list, code) in words.iter().filter(|(list, _)| shelf.lists.contains(list)) {
                    let place = &mut next[list - shelf.lists.start];
                    let code = [code as u32, (code >> 32) as u32];
                    shelf.postings[*place as usize] = Posting { code, object };
                    *place += 1;
                }
            }
        });
    }

    /// All are in their places.
    pub fn filled(self) -> Index {
        Index {
            vocabulary: Vocabulary::standard(),
            shelves: self.shelves.into_iter().map(|(shelf, _)| shelf).collect(),
            objects: self.objects,
        }
    }
}

impl Index {
    /// Of objects, which are numbered in their order.
    pub fn new(objects: impl IntoIterator<Item = Words>) -> Self {
        let objects: Vec<(u32, Words)> = (0..).zip(objects).collect();
        let mut counted = Counted::new();
        counted.count(&objects);
        let mut filled = counted.counted();
        filled.fill(&objects);
        filled.filled()
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.objects
    }

    /// True where nothing is known.
    pub fn is_empty(&self) -> bool {
        self.objects == 0
    }

    /// Bytes that the postings take.
    pub fn bytes(&self) -> usize {
        self.shelves.iter().map(|shelf| size_of_val(&shelf.postings[..])).sum()
    }

    fn postings(&self, list: usize) -> &[Posting] {
        let shelf = &self.shelves[list / self.shelves[0].lists.len()];
        let own = list - shelf.lists.start;
        &shelf.postings[shelf.starts[own] as usize..shelf.starts[own + 1] as usize]
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
        let size = size_step(feature.size as f32);
        let sizes = match (feature.point, feature.kind) {
            (None, _) => SMALLEST..=SMALLEST + SIZES - 1,
            (_, FeatureKind::Rectified | FeatureKind::Upright) => size..=size,
            (_, FeatureKind::Picture) => size - 2..=size + 2,
        };
        let mut fitting: Vec<(u32, u32)> = Vec::new();
        for coded in self.vocabulary.words(&quantise(&feature.descriptor)) {
            for size in sizes.clone() {
                for posting in self.postings(list_of(coded.word, feature.kind, size)) {
                    let bits = posting.bits_apart(coded.code);
                    if bits <= MAX_BITS {
                        fitting.push((posting.object, bits));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::appearance::{Appearance, DESCRIPTOR_LENGTH, ModelFeature};
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
        Index::new((0..20).map(|seed| Words::of(&object(seed))))
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
    fn objects_may_come_in_any_order_and_a_few_at_a_time() {
        let objects: Vec<(u32, Words)> =
            (0..20).rev().map(|n| (n, Words::of(&object(u64::from(n))))).collect();
        let mut counted = Counted::new();
        objects.chunks(7).for_each(|some| counted.count(some));
        let mut filled = counted.counted();
        objects.chunks(3).for_each(|some| filled.fill(some));
        let seen = seen(13, 1.0);
        assert_eq!(filled.filled().rank(&seen, 5), twenty_objects().rank(&seen, 5));
    }

    #[test]
    fn what_has_another_size_is_another_thing() {
        let index = twenty_objects();
        let votes =
            |size| index.rank(&seen(13, size), 20).iter().find(|r| r.0 == 13).map_or(0.0, |r| r.1);
        assert!(votes(2.0) < 0.1 * votes(1.0));
    }
}
