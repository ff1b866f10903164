//! Matches of an object's features with those of a scene: the nearest descriptor among those of the right metric
//! size, and how much nearer it is than the best one at another place.
//!
//! In: features of an object (object frame at configuration 0) and of a scene (camera frame), metres.
//! Out: matches.
//! From: paper, section III-E, which matches descriptors; ratio test of Lowe (2004).

use super::config::RecogniseConfig;
use crate::features::quantised::{bytes_of, quantise, similarity};
use crate::features::{DESCRIPTOR_LENGTH, DescribedFeature, FeatureKind};
use crate::math::extremes::larger;
use crate::object::appearance::ModelFeature;
use linkage_frames::depth::DepthSensor;
use nalgebra::{DMatrix, Point3, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// A match of a feature of an object with one of a scene.
#[derive(Debug, Clone)]
pub struct Match {
    /// Part of the object.
    pub part: usize,
    /// Point on the object at configuration 0, object frame, metres.
    pub model_point: Point3<f64>,
    /// Unit normal at the model point, object frame; zero if unknown.
    pub model_normal: Vector3<f64>,
    /// Point in the camera frame, metres; `None` without depth.
    pub seen_point: Option<Point3<f64>>,
    /// Unit normal at the seen point, camera frame; zero if unknown.
    pub seen_normal: Vector3<f64>,
    /// Pixel of the seen feature.
    pub pixel: [f32; 2],
    /// Distance between the unit descriptors.
    pub distance: f64,
    /// Ratio of `distance` to the distance of the best descriptor at another place: the smaller, the more distinct.
    pub ratio: f64,
    /// Tolerance of the seen point, metres; 0 without depth.
    pub tolerance: f64,
}

/// Kinds of features that are compared.
const KINDS: [FeatureKind; 2] = [FeatureKind::Picture, FeatureKind::Rectified];

/// Features of one kind of an object, by size: a feature is compared only with those of about its size.
struct Table {
    kind: FeatureKind,
    /// Descriptors in bytes, one row per feature.
    descriptors: DMatrix<u8>,
    parts: Vec<usize>,
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    /// Natural logarithm of each size in metres, ascending.
    log_sizes: Vec<f32>,
}

/// Features of an object, prepared for matching with a scene.
pub struct FeatureTable([Table; KINDS.len()]);

impl FeatureTable {
    /// Unpacks the features, and sorts them by kind and size.
    pub fn new(features: &[ModelFeature]) -> Self {
        let of = |kind: FeatureKind| {
            let mut features: Vec<&ModelFeature> =
                features.iter().filter(|f| f.kind == kind).collect();
            features.sort_by(|a, b| log_size(a.size_m).total_cmp(&log_size(b.size_m)));
            let wide = |a: [f32; 3]| Vector3::from(a).map(f64::from);
            let descriptors = features.iter().flat_map(|f| bytes_of(&f.descriptor));
            Table {
                kind,
                descriptors: DMatrix::from_row_iterator(
                    features.len(),
                    DESCRIPTOR_LENGTH,
                    descriptors,
                ),
                parts: features.iter().map(|f| usize::from(f.part)).collect(),
                points: features.iter().map(|f| Point3::from(wide(f.point))).collect(),
                normals: features.iter().map(|f| wide(f.normal)).collect(),
                log_sizes: features.iter().map(|f| log_size(f.size_m)).collect(),
            }
        };
        Self(KINDS.map(of))
    }
}

fn log_size(size_m: f32) -> f32 {
    size_m.max(1e-6).ln()
}

impl Table {
    /// Indices of the features that are compared with a query: those of about its size; all if the query has no
    /// depth.
    fn gated(&self, query: &DescribedFeature) -> Range<usize> {
        if query.point.is_none() {
            return 0..self.parts.len();
        }
        let log_size = log_size(query.size as f32);
        let gate = match self.kind {
            FeatureKind::Picture => 1.6_f32.ln(),
            FeatureKind::Rectified | FeatureKind::Upright => 1.1_f32.ln(),
        };
        self.log_sizes.partition_point(|s| *s <= log_size - gate)
            ..self.log_sizes.partition_point(|s| *s < log_size + gate)
    }
}

/// Features of one kind of a scene.
struct QueriesOfKind {
    /// Indices into all features of the scene, by size; those without depth come last.
    order: Vec<usize>,
    /// Descriptors, bytes as floats, one column per feature.
    descriptors: DMatrix<f32>,
}

/// Features of a scene, prepared for matching with many objects.
pub struct Queries {
    kinds: [QueriesOfKind; KINDS.len()],
    /// Sensor that measured the depth.
    sensor: DepthSensor,
}

impl Queries {
    /// Prepares all features of a scene.
    pub fn new(features: &[DescribedFeature], sensor: DepthSensor) -> Self {
        let of = |kind: FeatureKind| {
            let size = |i: &usize| features[*i].point.map_or(f64::INFINITY, |_| features[*i].size);
            let mut order: Vec<usize> =
                (0..features.len()).filter(|i| features[*i].kind == kind).collect();
            order.sort_by(|a, b| size(a).total_cmp(&size(b)));
            let bytes = order.iter().flat_map(|i| quantise(&features[*i].descriptor));
            let descriptors =
                DMatrix::from_iterator(DESCRIPTOR_LENGTH, order.len(), bytes.map(f32::from));
            QueriesOfKind { order, descriptors }
        };
        Self { kinds: KINDS.map(of), sensor }
    }
}

/// Largest distance between features that count as one place, metres.
const ONE_PLACE_M: f64 = 0.03;
/// Largest distance between the unit descriptors of a match.
const MAX_DISTANCE: f64 = 0.85;

/// Matches of a scene's features with an object's, one list per kind.
pub struct Compared(Vec<Vec<Match>>);

impl Compared {
    /// Matches the features of a scene, of which `queries` were made, with those of an object.
    pub fn new(seen: &[DescribedFeature], queries: &Queries, table: &FeatureTable) -> Self {
        let of_kind = |(of_kind, table)| match_kind(seen, of_kind, table, queries.sensor);
        Self(queries.kinds.iter().zip(&table.0).map(of_kind).collect())
    }

    /// The most distinct matches of both kinds, most distinct first. Features at places for which `is_free` is false
    /// are left out.
    pub fn distinct(
        &self,
        is_free: impl Fn(&Point3<f64>) -> bool,
        config: &RecogniseConfig,
    ) -> Vec<Match> {
        let is_wanted =
            |m: &&Match| m.ratio < config.max_ratio && m.seen_point.as_ref().is_none_or(&is_free);
        let by_ratio = |a: &&Match, b: &&Match| a.ratio.total_cmp(&b.ratio);
        let mut distinct: Vec<&Match> = Vec::new();
        for of_kind in &self.0 {
            let mut of_kind: Vec<&Match> = of_kind.iter().filter(is_wanted).collect();
            of_kind.sort_by(by_ratio);
            distinct.extend(of_kind.into_iter().take(MAX_MATCHES));
        }
        distinct.sort_by(by_ratio);
        distinct.into_iter().cloned().collect()
    }

    /// All matches, smallest distance first.
    pub fn all(&self) -> Vec<Match> {
        let mut all: Vec<&Match> = self.0.iter().flatten().collect();
        all.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        all.into_iter().cloned().collect()
    }
}

/// Largest number of distinct matches that are kept of each kind.
const MAX_MATCHES: usize = 400;
/// Number of queries that are compared at a time.
const BLOCK: usize = 64;

/// Matches of one kind of features. Products of descriptors are computed as products of matrices; whole numbers of
/// this size are exact in floats.
fn match_kind(
    seen: &[DescribedFeature],
    queries: &QueriesOfKind,
    table: &Table,
    sensor: DepthSensor,
) -> Vec<Match> {
    if table.parts.len() < 2 {
        return Vec::new();
    }
    let descriptors = table.descriptors.map(f32::from);
    let gates: Vec<Range<usize>> = queries.order.iter().map(|i| table.gated(&seen[*i])).collect();
    let mut blocks = Vec::new();
    let mut end = 0;
    // Rectified features have only a few sizes: queries are grouped so that other sizes cost no work.
    for alike in gates.chunk_by(|a, b| b.start < a.end) {
        let all = end..end + alike.len();
        end = all.end;
        blocks.extend(all.clone().step_by(BLOCK).map(|first| first..(first + BLOCK).min(all.end)));
    }
    let matches_of = |block: Range<usize>| {
        let gates = &gates[block.clone()];
        let first = gates.iter().map(|g| g.start).min().unwrap_or(0);
        let last = gates.iter().map(|g| g.end).max().unwrap_or(0);
        let columns = queries.descriptors.columns(block.start, block.len());
        let products = descriptors.rows(first, last - first) * columns;
        let order = &queries.order[block];
        let found = order.iter().zip(gates).enumerate().filter_map(|(column, (&i, gate))| {
            let products = &products.as_slice()[column * (last - first)..][..last - first];
            let products = &products[gate.start - first..gate.end - first];
            Some((i, matched(&seen[i], table, sensor, gate.start, products)?))
        });
        found.collect::<Vec<_>>()
    };
    let mut matches: Vec<(usize, Match)> =
        blocks.into_par_iter().flat_map_iter(matches_of).collect();
    matches.sort_unstable_by_key(|(i, _)| *i);
    matches.into_iter().map(|(_, m)| m).collect()
}

/// Match of a query, by the products of its descriptor with those of the features from index `first` on.
fn matched(
    query: &DescribedFeature,
    table: &Table,
    sensor: DepthSensor,
    first: usize,
    products: &[f32],
) -> Option<Match> {
    let Nearest { index: j, product, elsewhere } = nearest(products, first, table)?;
    let distance = |product: f32| (2.0 - 2.0 * similarity(product as u32)).max(0.0).sqrt();
    let d = distance(product);
    Some(Match {
        part: table.parts[j],
        model_point: table.points[j],
        model_normal: table.normals[j],
        seen_point: query.point,
        seen_normal: query.normal,
        pixel: query.pixel,
        distance: d,
        ratio: d.max(1e-6) / distance(elsewhere).max(1e-6),
        tolerance: query.point.map_or(0.0, |p| tolerance(sensor, p.z)),
    })
    .filter(|m| m.distance < MAX_DISTANCE)
}

/// The feature with the largest product, and the largest product among the features at another place.
struct Nearest {
    index: usize,
    product: f32,
    elsewhere: f32,
}

/// Number of products that are compared at a time.
const LANES: usize = 32;

/// Finds the nearest feature; loops are as wide as the processor allows, with the same results on all.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn nearest(products: &[f32], first: usize, table: &Table) -> Option<Nearest> {
    let of_chunks: Vec<f32> = products.chunks(LANES).map(highest).collect();
    let product = of_chunks.iter().copied().fold(0.0, larger);
    let chunk = of_chunks.iter().position(|highest| *highest == product)?;
    let in_chunk = products[chunk * LANES..].iter().position(|p| *p == product)?;
    let index = first + chunk * LANES + in_chunk;
    let is_elsewhere = |k: usize| {
        table.parts[k] != table.parts[index]
            || (table.points[k] - table.points[index]).norm_squared() > ONE_PLACE_M * ONE_PLACE_M
    };
    let mut elsewhere = 0.0;
    for (number, chunk) in products.chunks(LANES).enumerate() {
        if of_chunks[number] <= elsewhere {
            continue;
        }
        for (i, product) in chunk.iter().enumerate() {
            if *product > elsewhere && is_elsewhere(first + number * LANES + i) {
                elsewhere = *product;
            }
        }
    }
    Some(Nearest { index, product, elsewhere })
}

/// Largest of up to [`LANES`] products.
#[inline(always)]
fn highest(products: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    lanes[..products.len()].copy_from_slice(products);
    let mut width = LANES;
    while width > 1 {
        width /= 2;
        for i in 0..width {
            lanes[i] = larger(lanes[i], lanes[width + i]);
        }
    }
    lanes[0]
}

/// Tolerance of a seen point at depth `z`, metres.
fn tolerance(sensor: DepthSensor, z: f64) -> f64 {
    0.008 + 3.0 * sensor.reading_sigma(z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::quantised::product;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A unit descriptor that differs from others by its number.
    fn descriptor(number: usize) -> [f32; DESCRIPTOR_LENGTH] {
        let mut descriptor = [0.0; DESCRIPTOR_LENGTH];
        (0..4).for_each(|i| descriptor[4 * number + i] = 0.5);
        descriptor
    }

    fn learned(number: usize, x: f32) -> ModelFeature {
        ModelFeature {
            part: 0,
            kind: FeatureKind::Picture,
            point: [x, 0.0, 1.0],
            normal: [0.0, 0.0, -1.0],
            size_m: 0.01,
            descriptor: quantise(&descriptor(number)).to_vec(),
        }
    }

    fn seen(number: usize) -> DescribedFeature {
        DescribedFeature {
            kind: FeatureKind::Picture,
            pixel: [100.0, 100.0],
            point: Some(Point3::new(0.0, 0.0, 1.0)),
            normal: -Vector3::z(),
            size: 0.01,
            descriptor: descriptor(number),
        }
    }

    /// Distinct matches and all, of a feature seen where these were learned: number and place.
    fn counts(of: usize, model: &[(usize, f32)]) -> (usize, usize) {
        let features: Vec<ModelFeature> =
            model.iter().map(|(number, x)| learned(*number, *x)).collect();
        let table = FeatureTable::new(&features);
        let seen = [seen(of)];
        let compared = Compared::new(&seen, &Queries::new(&seen, DepthSensor::default()), &table);
        let distinct = compared.distinct(|_| true, &RecogniseConfig::default());
        (distinct.len(), compared.all().len())
    }

    #[test]
    fn a_mark_that_is_nowhere_else_is_distinct() {
        assert_eq!(counts(1, &[(1, 0.0), (2, 0.3)]), (1, 1));
        // Two views of one place are no rivals.
        assert_eq!(counts(1, &[(1, 0.0), (1, 0.01), (2, 0.3)]), (1, 1));
    }

    #[test]
    fn a_mark_that_repeats_matches_and_is_not_distinct() {
        assert_eq!(counts(1, &[(1, 0.0), (1, 0.3)]), (0, 1));
    }

    #[test]
    fn what_resembles_nothing_does_not_match() {
        assert_eq!(counts(3, &[(1, 0.0), (2, 0.3)]), (0, 0));
    }

    /// A unit descriptor near to another one's.
    fn near(descriptor: &[f32], noise: f32, rng: &mut ChaCha8Rng) -> [f32; DESCRIPTOR_LENGTH] {
        let noisy: [f32; DESCRIPTOR_LENGTH] =
            std::array::from_fn(|i| descriptor[i] + noise * rng.random::<f32>());
        let length = noisy.iter().map(|x| x * x).sum::<f32>().sqrt();
        noisy.map(|x| x / length)
    }

    #[test]
    fn each_feature_matches_the_nearest_one_of_about_its_size_however_many_there_are() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let model: Vec<ModelFeature> = (0..700)
            .map(|i| ModelFeature {
                size_m: rng.random_range(0.005..0.05),
                descriptor: quantise(&near(&[0.0; DESCRIPTOR_LENGTH], 1.0, &mut rng)).to_vec(),
                ..learned(0, i as f32)
            })
            .collect();
        let queries: Vec<DescribedFeature> = (0..300)
            .map(|i| {
                let like = &model[rng.random_range(0..model.len())];
                let descriptor: Vec<f32> =
                    like.descriptor.iter().map(|x| f32::from(*x) / 510.0).collect();
                let feature = DescribedFeature {
                    pixel: [i as f32, 0.0],
                    size: f64::from(like.size_m) * rng.random_range(0.5..2.0),
                    descriptor: near(&descriptor, 0.05, &mut rng),
                    ..seen(0)
                };
                DescribedFeature { point: feature.point.filter(|_| i % 10 != 0), ..feature }
            })
            .collect();
        let table = FeatureTable::new(&model);
        let matches =
            Compared::new(&queries, &Queries::new(&queries, DepthSensor::default()), &table).all();
        for query in &queries {
            let found = matches.iter().find(|m| m.pixel == query.pixel);
            let likeness = |f: &&ModelFeature| product(&quantise(&query.descriptor), &f.descriptor);
            let is_of_its_size = |f: &&ModelFeature| {
                query.point.is_none() || (f.size_m / query.size as f32).ln().abs() < 1.6_f32.ln()
            };
            let nearest = model.iter().filter(is_of_its_size).max_by_key(likeness);
            assert_eq!(found.map(|m| m.model_point.x as f32), nearest.map(|f| f.point[0]));
        }
    }
}
