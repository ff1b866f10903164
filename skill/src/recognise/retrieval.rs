//! The bag of words (paper, section III-E, after Gálvez-López & Tardós 2012): descriptors
//! become words of a vocabulary, objects and pictures weighted sets of them, and an inverted
//! index gives the objects that share rare words with a picture.

use crate::appearance::{Appearance, DESCRIPTOR_LENGTH, FeatureKind, dequantise};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Branches of a node of the vocabulary.
const BRANCHES: usize = 10;
/// Levels: up to 1000 words.
const LEVELS: usize = 3;
/// Descriptors that a vocabulary is trained on.
const MAX_TRAINING: usize = 40_000;
/// Rounds of k-means in a node.
const ROUNDS: usize = 8;

type Descriptor = [f32; DESCRIPTOR_LENGTH];

/// A tree of k-means centres over RootSIFT descriptors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Vocabulary {
    nodes: Vec<Node>,
    words: u32,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Node {
    centre: Vec<f32>,
    /// Child nodes; a leaf has none.
    children: Vec<u32>,
    /// Number of a leaf.
    word: u32,
}

impl Vocabulary {
    /// Trains on the features of objects; the same objects give the same vocabulary.
    pub fn train<'a>(appearances: impl Iterator<Item = &'a Appearance>) -> Self {
        let mut descriptors: Vec<Descriptor> = appearances.flat_map(words_of).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        descriptors.shuffle(&mut rng);
        descriptors.truncate(MAX_TRAINING);
        let mut vocabulary = Self { nodes: Vec::new(), words: 0 };
        vocabulary.grow(vec![0.0; DESCRIPTOR_LENGTH], &descriptors, LEVELS, &mut rng);
        vocabulary
    }

    /// Number of words.
    pub fn words(&self) -> usize {
        self.words as usize
    }

    fn grow(
        &mut self,
        centre: Vec<f32>,
        descriptors: &[Descriptor],
        levels: usize,
        rng: &mut ChaCha8Rng,
    ) -> u32 {
        let number = self.nodes.len() as u32;
        self.nodes.push(Node { centre, children: Vec::new(), word: self.words });
        if levels == 0 || descriptors.len() < 2 * BRANCHES {
            self.words += 1;
            return number;
        }
        let (centres, assignment) = k_means(descriptors, rng);
        for (k, centre) in centres.into_iter().enumerate() {
            let own: Vec<Descriptor> = descriptors
                .iter()
                .zip(&assignment)
                .filter(|(_, a)| **a == k)
                .map(|(d, _)| *d)
                .collect();
            if !own.is_empty() {
                let child = self.grow(centre.to_vec(), &own, levels - 1, rng);
                self.nodes[number as usize].children.push(child);
            }
        }
        number
    }

    fn word(&self, descriptor: &Descriptor) -> u32 {
        let mut node = &self.nodes[0];
        while !node.children.is_empty() {
            let nearest =
                node.children.iter().map(|&c| &self.nodes[c as usize]).max_by(|a, b| {
                    dot(&a.centre, descriptor).total_cmp(&dot(&b.centre, descriptor))
                });
            match nearest {
                Some(next) => node = next,
                None => break,
            }
        }
        node.word
    }

    fn histogram(&self, descriptors: impl Iterator<Item = Descriptor>) -> HashMap<u32, f64> {
        let mut histogram = HashMap::new();
        for d in descriptors {
            *histogram.entry(self.word(&d)).or_insert(0.0) += 1.0;
        }
        histogram
    }
}

fn words_of(appearance: &Appearance) -> impl Iterator<Item = Descriptor> + '_ {
    appearance.features.iter().filter(|f| f.kind == FeatureKind::Picture).map(|f| {
        let mut descriptor = [0.0; DESCRIPTOR_LENGTH];
        for (x, value) in descriptor.iter_mut().zip(dequantise(&f.descriptor)) {
            *x = value;
        }
        descriptor
    })
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Spherical k-means: descriptors are unit vectors.
fn k_means(descriptors: &[Descriptor], rng: &mut ChaCha8Rng) -> (Vec<Descriptor>, Vec<usize>) {
    let mut order: Vec<usize> = (0..descriptors.len()).collect();
    order.partial_shuffle(rng, BRANCHES);
    let mut centres: Vec<Descriptor> =
        order.iter().rev().take(BRANCHES).map(|&i| descriptors[i]).collect();
    let mut assignment = vec![0; descriptors.len()];
    for _ in 0..ROUNDS {
        assignment = descriptors
            .par_iter()
            .map(|d| {
                (0..centres.len())
                    .max_by(|&a, &b| dot(&centres[a], d).total_cmp(&dot(&centres[b], d)))
                    .unwrap_or(0)
            })
            .collect();
        for (k, centre) in centres.iter_mut().enumerate() {
            let mut sum = [0.0; DESCRIPTOR_LENGTH];
            for (d, _) in descriptors.iter().zip(&assignment).filter(|(_, a)| **a == k) {
                for (s, x) in sum.iter_mut().zip(d) {
                    *s += x;
                }
            }
            let norm = dot(&sum, &sum).sqrt();
            if norm > 0.0 {
                *centre = sum.map(|x| x / norm);
            }
        }
    }
    (centres, assignment)
}

/// The inverted index of all objects.
pub struct Index {
    vocabulary: Vocabulary,
    /// By word: (object, weight).
    postings: HashMap<u32, Vec<(usize, f64)>>,
    inverse_document_frequency: HashMap<u32, f64>,
    objects: usize,
}

impl Index {
    /// Indexes objects in their order.
    pub fn new<'a>(
        vocabulary: Vocabulary,
        appearances: impl Iterator<Item = &'a Appearance>,
    ) -> Self {
        let histograms: Vec<HashMap<u32, f64>> =
            appearances.map(|a| vocabulary.histogram(words_of(a))).collect();
        let mut document_count: HashMap<u32, f64> = HashMap::new();
        for h in &histograms {
            for word in h.keys() {
                *document_count.entry(*word).or_default() += 1.0;
            }
        }
        let n = histograms.len() as f64;
        let inverse_document_frequency: HashMap<u32, f64> =
            document_count.into_iter().map(|(w, c)| (w, (1.0 + n / c).ln())).collect();
        let mut postings: HashMap<u32, Vec<(usize, f64)>> = HashMap::new();
        for (object, histogram) in histograms.iter().enumerate() {
            for (word, weight) in weighted(histogram, &inverse_document_frequency) {
                postings.entry(word).or_default().push((object, weight));
            }
        }
        Self { vocabulary, postings, inverse_document_frequency, objects: histograms.len() }
    }

    /// Objects by similarity to a picture's descriptors, most similar first (tf-idf, L1
    /// normalised, shared weight).
    pub fn rank(&self, descriptors: impl Iterator<Item = Descriptor>) -> Vec<(usize, f64)> {
        let histogram = self.vocabulary.histogram(descriptors);
        let mut scores = vec![0.0; self.objects];
        for (word, weight) in weighted(&histogram, &self.inverse_document_frequency) {
            for (object, other) in self.postings.get(&word).into_iter().flatten() {
                scores[*object] += weight.min(*other);
            }
        }
        let mut ranked: Vec<(usize, f64)> = scores.into_iter().enumerate().collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
        ranked
    }
}

fn weighted(histogram: &HashMap<u32, f64>, idf: &HashMap<u32, f64>) -> Vec<(u32, f64)> {
    let mut weights: Vec<(u32, f64)> = histogram
        .iter()
        .filter_map(|(word, count)| Some((*word, count * idf.get(word)?)))
        .collect();
    weights.sort_by_key(|w| w.0);
    let total: f64 = weights.iter().map(|w| w.1).sum();
    weights.iter_mut().for_each(|w| w.1 /= total.max(1e-12));
    weights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::appearance::ModelFeature;
    use rand::Rng;

    fn object(seed: u64) -> Appearance {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let features = (0..200)
            .map(|_| ModelFeature {
                part: 0,
                kind: FeatureKind::Picture,
                point: [0.0; 3],
                normal: [0.0; 3],
                size_m: 0.01,
                descriptor: (0..DESCRIPTOR_LENGTH)
                    .map(|_| if rng.random::<f32>() < 0.2 { rng.random_range(40..120) } else { 0 })
                    .collect(),
            })
            .collect();
        Appearance { features, surfels: Vec::new() }
    }

    #[test]
    fn the_object_whose_words_are_seen_ranks_first() {
        let objects: Vec<Appearance> = (0..20).map(object).collect();
        let index = Index::new(Vocabulary::train(objects.iter()), objects.iter());
        let seen = words_of(&objects[13]).step_by(3);
        assert_eq!(index.rank(seen)[0].0, 13);
    }
}
