//! The vocabulary: a tree of k-means centres whose leaves are words, and a code for each descriptor, by where it
//! lies about its word. One vocabulary serves all stores, so that words of objects learned later are the same.
//!
//! In: descriptors.
//! Out: words and codes.
//! From: tree by Nistér & Stewénius 2006, and Gálvez-López & Tardós 2012 for the paper's bag of words; code by
//! Hamming embedding, Jégou et al. 2008.

use crate::features::DESCRIPTOR_LENGTH;
use crate::features::quantised::{Descriptor, product, products, quantise};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Number of children of a node.
const BRANCHES: usize = 16;
/// Number of levels below the root.
const LEVELS: usize = 3;
/// Number of nodes without the root.
const NODES: usize = BRANCHES + BRANCHES * BRANCHES + WORDS;
/// Number of leaves.
pub const WORDS: usize = BRANCHES.pow(LEVELS as u32);
/// Number of bits of a code.
const BITS: usize = 64;
/// Number of rounds of k-means in a node.
const ROUNDS: usize = 10;

/// Word of a descriptor, and its code about that word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Coded {
    /// Number of the word.
    pub word: u16,
    /// Signs of the projections of the residual onto the directions of the code.
    pub code: u64,
}

/// A tree of words.
pub struct Vocabulary {
    /// Centres level by level; the children of node `n` of one level are nodes `16 n` to `16 n + 15` of the next.
    centres: Vec<Descriptor>,
    /// Directions of the code's bits, each with as many +1 as -1.
    directions: Vec<[i8; DESCRIPTOR_LENGTH]>,
}

/// Error: these bytes are not a vocabulary.
#[derive(Debug, thiserror::Error)]
#[error("a vocabulary has {needed} bytes, not {found}")]
pub struct NotAVocabulary {
    needed: usize,
    found: usize,
}

impl Vocabulary {
    /// The vocabulary with which stores are indexed, version 2; `linkage vocabulary` computes it again.
    pub fn standard() -> &'static Self {
        static STANDARD: OnceLock<Vocabulary> = OnceLock::new();
        STANDARD.get_or_init(|| {
            Self::from_bytes(include_bytes!("../../../assets/vocabulary-2.bin"))
                .expect("the vocabulary that is built in has the size of its version")
        })
    }

    /// Trains on descriptors, at least one; equal descriptors in equal order give equal words.
    pub fn train(descriptors: &[Descriptor]) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut centres = Vec::with_capacity(NODES);
        let mut groups: Vec<Vec<Descriptor>> = vec![descriptors.to_vec()];
        for _ in 0..LEVELS {
            let seeds: Vec<u64> = groups.iter().map(|_| rng.random()).collect();
            let split: Vec<(Vec<Descriptor>, Vec<Vec<Descriptor>>)> =
                groups.par_iter().zip(seeds).map(|(group, seed)| k_means(group, seed)).collect();
            groups = Vec::with_capacity(BRANCHES * split.len());
            for (own, parts) in split {
                centres.extend(own);
                groups.extend(parts);
            }
        }
        Self { centres, directions: directions() }
    }

    /// Stored form: all centres, level by level.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.centres.concat()
    }

    /// Reads [`Self::to_bytes`].
    ///
    /// # Errors
    /// [`NotAVocabulary`] for any other number of bytes.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NotAVocabulary> {
        let needed = NODES * DESCRIPTOR_LENGTH;
        if bytes.len() != needed {
            return Err(NotAVocabulary { needed, found: bytes.len() });
        }
        let (centres, _) = bytes.as_chunks::<DESCRIPTOR_LENGTH>();
        Ok(Self { centres: centres.to_vec(), directions: directions() })
    }

    /// The two nearest words of a descriptor among those of one branch, nearest first.
    pub fn words(&self, descriptor: &Descriptor) -> [Coded; 2] {
        let (mut level, mut node, mut second) = (0, 0, 0);
        let mut width = BRANCHES;
        for _ in 0..LEVELS {
            let children = &self.centres[level + node * BRANCHES..][..BRANCHES];
            let (mut best, mut next) = ((0, 0), (0, 0));
            for (child, nearness) in products(descriptor, children).into_iter().enumerate() {
                if nearness > best.0 {
                    (best, next) = ((nearness, child), best);
                } else if nearness > next.0 {
                    next = (nearness, child);
                }
            }
            second = node * BRANCHES + next.1;
            node = node * BRANCHES + best.1;
            level += width;
            width *= BRANCHES;
        }
        let leaves = NODES - WORDS;
        [node, second].map(|word| Coded {
            word: word as u16,
            code: self.code(descriptor, &self.centres[leaves + word]),
        })
    }

    fn code(&self, descriptor: &Descriptor, centre: &Descriptor) -> u64 {
        let residual: [i16; DESCRIPTOR_LENGTH] =
            std::array::from_fn(|i| i16::from(descriptor[i]) - i16::from(centre[i]));
        sides(&residual, &self.directions)
    }
}

/// One bit per direction: set if the residual points along it.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn sides(residual: &[i16; DESCRIPTOR_LENGTH], directions: &[[i8; DESCRIPTOR_LENGTH]]) -> u64 {
    directions.iter().enumerate().fold(0, |code, (bit, direction)| {
        let along: i32 =
            residual.iter().zip(direction).map(|(r, d)| i32::from(*r * i16::from(*d))).sum();
        code | u64::from(along > 0) << bit
    })
}

/// Directions of the code, equal for all vocabularies.
fn directions() -> Vec<[i8; DESCRIPTOR_LENGTH]> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    (0..BITS)
        .map(|_| {
            let mut direction: [i8; DESCRIPTOR_LENGTH] =
                std::array::from_fn(|i| if i % 2 == 0 { 1 } else { -1 });
            direction.shuffle(&mut rng);
            direction
        })
        .collect()
}

/// Centres of a group, and the members that are nearest to each. In a group that is too small, several centres share
/// a member.
fn k_means(group: &[Descriptor], seed: u64) -> (Vec<Descriptor>, Vec<Vec<Descriptor>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<usize> = (0..group.len()).collect();
    order.shuffle(&mut rng);
    let mut centres: Vec<Descriptor> =
        order.iter().cycle().take(BRANCHES).map(|&i| group[i]).collect();
    let mut parts = vec![Vec::new(); BRANCHES];
    for _ in 0..ROUNDS {
        parts = vec![Vec::new(); BRANCHES];
        for d in group {
            let nearest = (0..BRANCHES).max_by_key(|&k| product(&centres[k], d)).unwrap_or(0);
            parts[nearest].push(*d);
        }
        for (centre, part) in centres.iter_mut().zip(&parts) {
            if let Some(middle) = middle_of(part) {
                *centre = middle;
            }
        }
    }
    for (part, centre) in parts.iter_mut().zip(&centres) {
        if part.is_empty() {
            part.push(*centre);
        }
    }
    (centres, parts)
}

/// Unit vector in the mean direction; `None` without members.
fn middle_of(part: &[Descriptor]) -> Option<Descriptor> {
    let mut sum = [0.0_f32; DESCRIPTOR_LENGTH];
    for d in part {
        for (s, x) in sum.iter_mut().zip(d) {
            *s += f32::from(*x);
        }
    }
    let norm = sum.iter().map(|x| x * x).sum::<f32>().sqrt();
    (norm > 0.0).then(|| quantise(&sum.map(|x| x / norm)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some_descriptors() -> Vec<Descriptor> {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        (0..3000)
            .map(|_| {
                let raw: [f32; DESCRIPTOR_LENGTH] =
                    std::array::from_fn(|_| rng.random::<f32>().powi(4));
                let norm = raw.iter().map(|x| x * x).sum::<f32>().sqrt();
                quantise(&raw.map(|x| x / norm))
            })
            .collect()
    }

    #[test]
    fn the_same_descriptors_give_the_same_words() {
        let some = some_descriptors();
        let vocabulary = Vocabulary::train(&some);
        assert_eq!(vocabulary.to_bytes(), Vocabulary::train(&some).to_bytes());
        let read = Vocabulary::from_bytes(&vocabulary.to_bytes()).unwrap();
        assert!(some.iter().all(|d| read.words(d) == vocabulary.words(d)));
    }

    #[test]
    fn a_slightly_changed_descriptor_keeps_word_and_most_of_its_code() {
        let some = some_descriptors();
        let (training, others) = some.split_at(2000);
        let vocabulary = Vocabulary::train(training);
        let kept = others
            .iter()
            .filter(|d| {
                let changed = d.map(|x| x.saturating_add(u8::from(x % 3 == 0)));
                let (a, b) = (vocabulary.words(d)[0], vocabulary.words(&changed));
                b.iter().any(|b| b.word == a.word && (a.code ^ b.code).count_ones() < 16)
            })
            .count();
        assert!(kept > 800, "{kept} of 1000");
    }

    #[test]
    fn bytes_of_another_length_are_no_vocabulary() {
        assert!(Vocabulary::from_bytes(&[0; 100]).is_err());
    }
}
