//! Selection of the objects, among many, that may be in an image. A feature votes for the objects that have its word
//! at its metric size with a similar code; votes count together where they lie together in space.
//!
//! In: words of objects; described features of a frame (camera frame, metres).
//! Out: objects, ranked by their votes.
//! From: paper, section III-E (bag of words); metric size and place, from depth, are ours.

mod postings;
mod vocabulary;
mod words;

pub(crate) use postings::{Posting, Postings};
pub use vocabulary::Vocabulary;
pub use words::Words;

use crate::features::quantised::quantise;
use crate::features::{DescribedFeature, FeatureKind};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::Arc;
use words::{SIZES, SMALLEST, list_of, size_step};

/// Largest number of bits in which codes of one surface point differ.
const MAX_BITS: u32 = 20;
/// Scale of the number of differing bits in the weight of a vote, exp(-(bits / SIGMA_BITS)^2).
const SIGMA_BITS: f64 = 12.0;
/// Side of a region whose votes count together, metres.
const REGION_M: f64 = 0.35;

/// Inverted index of many objects. The postings of some may be stored elsewhere and read on demand.
pub struct Index {
    vocabulary: &'static Vocabulary,
    postings: Postings,
    /// Numbers of the objects stored elsewhere, by their numbers in the postings that are read.
    others: HashMap<u32, u32>,
    objects: usize,
}

/// Lists in which one feature finds its votes, and its code in each.
type Sought = Vec<(usize, u64)>;

impl Index {
    /// Index of objects, which are numbered in their order.
    pub fn new(objects: impl IntoIterator<Item = Words>) -> Self {
        let objects: Vec<(u32, Words)> = (0..).zip(objects).collect();
        Self::of_some(&objects, HashMap::new())
    }

    /// Index of some objects by their numbers, and of others whose postings are read by [`Self::rank_reading`]:
    /// their numbers by those in the postings that are read.
    pub(crate) fn of_some(some: &[(u32, Words)], others: HashMap<u32, u32>) -> Self {
        let objects = some.len() + others.len();
        let postings = Postings::of(some);
        Self { vocabulary: Vocabulary::standard(), postings, others, objects }
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.objects
    }

    /// True if there is no object.
    pub fn is_empty(&self) -> bool {
        self.objects == 0
    }

    /// Size of the postings in memory, bytes.
    pub fn bytes(&self) -> usize {
        self.postings.bytes()
    }

    /// The first `places` objects with their votes, most votes first; objects with few votes are left out.
    pub fn rank(&self, seen: &[DescribedFeature], places: usize) -> Vec<(usize, f64)> {
        let nothing = |_: &[usize]| Ok::<_, Infallible>(Vec::new());
        let Ok(ranked) = self.rank_reading(seen, places, nothing);
        ranked
    }

    /// Ranks like [`Self::rank`] if postings of some objects are stored elsewhere: `read` gets the numbers of lists,
    /// each once, ascending, and returns their postings.
    ///
    /// # Errors
    /// Those of `read`.
    pub(crate) fn rank_reading<E>(
        &self,
        seen: &[DescribedFeature],
        places: usize,
        read: impl FnOnce(&[usize]) -> Result<Vec<Arc<[Posting]>>, E>,
    ) -> Result<Vec<(usize, f64)>, E> {
        let sought: Vec<Sought> = seen.par_iter().map(|f| self.sought(f)).collect();
        let lists = if self.others.is_empty() { Vec::new() } else { lists_of(&sought) };
        let kept = read(&lists)?;
        let of_list = |list: usize| -> &[Posting] {
            let place = lists.binary_search(&list).ok();
            place.and_then(|place| kept.get(place)).map_or(&[], |postings| postings)
        };
        let votes = sought.par_iter().map(|sought| self.votes_of(sought, of_list)).collect();
        Ok(self.rank_by(votes, seen, places))
    }

    fn rank_by(
        &self,
        votes: Vec<Vec<Vote>>,
        seen: &[DescribedFeature],
        places: usize,
    ) -> Vec<(usize, f64)> {
        // The votes of an object's best region are no more than all its votes. Regions are evaluated only for
        // objects that may be among the first.
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

    /// Objects with the votes of their best region, most votes first.
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

    fn sought(&self, feature: &DescribedFeature) -> Sought {
        let size = size_step(feature.size as f32);
        let sizes = match (feature.point, feature.kind) {
            (None, _) => SMALLEST..=SMALLEST + SIZES - 1,
            (_, FeatureKind::Rectified | FeatureKind::Upright) => size..=size,
            (_, FeatureKind::Picture) => size - 2..=size + 2,
        };
        let words = self.vocabulary.words(&quantise(&feature.descriptor)).into_iter();
        let lists = words.flat_map(|coded| {
            sizes.clone().map(move |size| (list_of(coded.word, feature.kind, size), coded.code))
        });
        lists.collect()
    }

    /// Votes of a feature, one per object; `read` gives the postings of a list that were read.
    fn votes_of<'p>(&self, sought: &Sought, read: impl Fn(usize) -> &'p [Posting]) -> Vec<Vote> {
        let mut fitting: Vec<(u32, u32)> = Vec::new();
        for &(list, code) in sought {
            let fits = |p: &Posting| {
                let bits = p.bits_apart(code);
                (bits <= MAX_BITS).then_some((p.object, bits))
            };
            fitting.extend(self.postings.list(list).iter().filter_map(fits));
            let of_others = |(object, bits)| Some((*self.others.get(&object)?, bits));
            fitting.extend(read(list).iter().filter_map(fits).filter_map(of_others));
        }
        fitting.sort_unstable();
        fitting.dedup_by_key(|v| v.0);
        // A feature that many objects have carries little information.
        let rarity = (self.objects as f64 / fitting.len().max(1) as f64).ln() + 1.0;
        let weight = |bits: u32| rarity * (-(f64::from(bits) / SIGMA_BITS).powi(2)).exp();
        fitting.into_iter().map(|(object, bits)| Vote { object, weight: weight(bits) }).collect()
    }
}

/// Numbers of all lists that are sought, each once, ascending.
fn lists_of(sought: &[Sought]) -> Vec<usize> {
    let mut lists: Vec<usize> = sought.iter().flatten().map(|(list, _)| *list).collect();
    lists.sort_unstable();
    lists.dedup();
    lists
}

/// Order by weight, largest first, then by number.
fn most_first(a: &(usize, f64), b: &(usize, f64)) -> Ordering {
    b.1.total_cmp(&a.1).then(a.0.cmp(&b.0))
}

/// Vote of a feature for an object.
struct Vote {
    object: u32,
    weight: f64,
}

/// Place of a feature, in cells half as wide as a region.
type Cell = [i32; 3];

fn cell_of(feature: &DescribedFeature) -> Cell {
    let number = |x: f64| (x / (0.5 * REGION_M)).floor() as i32;
    feature.point.map_or([0; 3], |p| [p.x, p.y, p.z].map(number))
}

/// Smallest number of votes of an object that is ranked.
const LEAST_VOTES: u32 = 3;

/// Largest weight of an object's votes within one region.
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
    use crate::test_data::{features, features_seen};
    use nalgebra::Point3;

    fn twenty_objects() -> Index {
        Index::new((0..20).map(|seed| Words::of(&features(seed))))
    }

    #[test]
    fn the_object_whose_features_are_seen_ranks_first() {
        let ranked = twenty_objects().rank(&features_seen(13, 1.0), 5);
        assert_eq!(ranked[0].0, 13);
        assert!(ranked.get(1).is_none_or(|second| ranked[0].1 > 3.0 * second.1), "{ranked:?}");
    }

    #[test]
    fn the_first_places_are_those_of_the_whole_ranking() {
        // Features of all objects are seen: the lower the number of the object, the more in one place.
        let seen: Vec<DescribedFeature> = (0..20)
            .flat_map(|number| {
                features_seen(number, 1.0).into_iter().enumerate().map(move |(i, feature)| {
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
    fn where_postings_are_kept_makes_no_difference() {
        let objects: Vec<(u32, Words)> =
            (0..20).map(|n| (n, Words::of(&features(n.into())))).collect();
        let (others, some) = objects.split_at(13);
        let there = |number: u32| 1_000 + 7 * number;
        let numbers = others.iter().map(|(number, _)| (there(*number), *number)).collect();
        let others: Vec<(u32, Words)> =
            others.iter().map(|(number, words)| (there(*number), words.clone())).collect();
        let elsewhere = Postings::of(&others);
        let index = Index::of_some(some, numbers);
        for seed in [3, 12, 13, 19] {
            let seen = features_seen(seed, 1.0);
            let read = |lists: &[usize]| {
                assert!(lists.is_sorted_by(|a, b| a < b));
                Ok::<_, ()>(lists.iter().map(|l| elsewhere.list(*l).into()).collect())
            };
            let ranked = index.rank_reading(&seen, 5, read).unwrap();
            assert_eq!(ranked, twenty_objects().rank(&seen, 5));
        }
    }

    #[test]
    fn what_cannot_be_read_is_told() {
        let index = Index::of_some(&[], HashMap::from([(1, 0)]));
        let ranked = index.rank_reading(&features_seen(13, 1.0), 5, |_| Err("no such file"));
        assert_eq!(ranked.unwrap_err(), "no such file");
    }

    #[test]
    fn what_has_another_size_is_another_thing() {
        let index = twenty_objects();
        let votes = |size| {
            index.rank(&features_seen(13, size), 20).iter().find(|r| r.0 == 13).map_or(0.0, |r| r.1)
        };
        assert!(votes(2.0) < 0.1 * votes(1.0));
    }
}
