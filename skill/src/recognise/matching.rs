//! Matches between an object's features and a scene's: nearest descriptor among those of the
//! right metric size, distinctly nearer than the best one at another place.

use super::RecogniseConfig;
use crate::appearance::{
    Appearance, DescribedFeature, Descriptor, FeatureKind, ModelFeature, bytes_of, products,
    quantise, similarity,
};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// One match.
#[derive(Debug, Clone)]
pub struct Match {
    /// Part of the object.
    pub part: usize,
    /// Place on the object at configuration 0.
    pub model_point: Point3<f64>,
    /// Normal there; zero where unknown.
    pub model_normal: Vector3<f64>,
    /// Place in the camera frame; `None` without depth.
    pub seen_point: Option<Point3<f64>>,
    /// Normal there; zero where unknown.
    pub seen_normal: Vector3<f64>,
    /// Pixel.
    pub pixel: [f32; 2],
    /// Distance of the descriptors,
    pub distance: f64,
    /// and its ratio to that of the best one at another place: the smaller the more distinct.
    pub ratio: f64,
    /// Tolerance of its place, metres.
    pub tolerance: f64,
}

/// Features of one kind, by size: a feature is compared with those of about its own size.
struct Table {
    kind: FeatureKind,
    descriptors: Vec<Descriptor>,
    parts: Vec<usize>,
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    /// Ascending.
    log_sizes: Vec<f32>,
}

/// An object's features, ready to be compared with a scene's.
pub struct FeatureTable(Vec<Table>);

impl FeatureTable {
    /// Unpacks an appearance.
    pub fn new(appearance: &Appearance) -> Self {
        let of = |kind: FeatureKind| {
            let log_size = |f: &ModelFeature| f.size_m.max(1e-6).ln();
            let mut features: Vec<&ModelFeature> =
                appearance.features.iter().filter(|f| f.kind == kind).collect();
            features.sort_by(|a, b| log_size(a).total_cmp(&log_size(b)));
            let wide = |a: [f32; 3]| Vector3::from(a).map(f64::from);
            Table {
                kind,
                descriptors: features.iter().map(|f| bytes_of(&f.descriptor)).collect(),
                parts: features.iter().map(|f| usize::from(f.part)).collect(),
                points: features.iter().map(|f| Point3::from(wide(f.point))).collect(),
                normals: features.iter().map(|f| wide(f.normal)).collect(),
                log_sizes: features.iter().map(|f| log_size(f)).collect(),
            }
        };
        Self(vec![of(FeatureKind::Picture), of(FeatureKind::Rectified)])
    }
}

impl Table {
    /// Indices of features whose size a query's may be.
    fn gated(&self, query: &DescribedFeature) -> std::ops::Range<usize> {
        if query.point.is_none() {
            return 0..self.parts.len();
        }
        let log_size = (query.size as f32).max(1e-6).ln();
        let gate = match self.kind {
            FeatureKind::Picture => 1.6_f32.ln(),
            FeatureKind::Rectified | FeatureKind::Upright => 1.1_f32.ln(),
        };
        self.log_sizes.partition_point(|s| *s <= log_size - gate)
            ..self.log_sizes.partition_point(|s| *s < log_size + gate)
    }
}

/// Features nearer to one another than this are one place, metres.
const ONE_PLACE_M: f64 = 0.03;
/// Largest distance of unit descriptors.
const MAX_DISTANCE: f64 = 0.85;

/// A scene's features compared with an object's, kind by kind.
pub struct Compared(Vec<Vec<Match>>);

/// Matches of all features.
pub struct Matches {
    /// The most distinct ones of both kinds, most distinct first.
    pub distinct: Vec<Match>,
    /// All, nearest first.
    pub all: Vec<Match>,
}

impl Compared {
    /// Compares them.
    pub fn new(seen: &[DescribedFeature], table: &FeatureTable) -> Self {
        Self(table.0.iter().map(|t| match_kind(seen, t)).collect())
    }

    /// Matches of features that lie where `is_free` says so.
    pub fn matches(
        &self,
        is_free: impl Fn(&Point3<f64>) -> bool,
        config: &RecogniseConfig,
    ) -> Matches {
        let free = |m: &&Match| m.seen_point.as_ref().is_none_or(&is_free);
        let of_kinds: Vec<Vec<&Match>> =
            self.0.iter().map(|of_kind| of_kind.iter().filter(free).collect()).collect();
        let mut distinct: Vec<Match> = Vec::new();
        for of_kind in &of_kinds {
            let mut of_kind: Vec<&Match> =
                of_kind.iter().copied().filter(|m| m.ratio < config.max_ratio).collect();
            of_kind.sort_by(|a, b| a.ratio.total_cmp(&b.ratio));
            distinct.extend(of_kind.into_iter().take(config.max_matches).cloned());
        }
        distinct.sort_by(|a, b| a.ratio.total_cmp(&b.ratio));
        let mut all: Vec<Match> = of_kinds.into_iter().flatten().cloned().collect();
        all.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        Matches { distinct, all }
    }
}

fn match_kind(seen: &[DescribedFeature], table: &Table) -> Vec<Match> {
    if table.parts.len() < 2 {
        return Vec::new();
    }
    let of_kind = seen.par_iter().filter(|f| f.kind == table.kind);
    of_kind.filter_map(|query| match_one(query, table)).collect()
}

fn match_one(query: &DescribedFeature, table: &Table) -> Option<Match> {
    let gated = table.gated(query);
    let first = gated.start;
    let products = products(&quantise(&query.descriptor), &table.descriptors[gated]);
    let best = products.iter().copied().max()?;
    let distance = |product: u32| (2.0 - 2.0 * similarity(product)).max(0.0).sqrt();
    let d = distance(best);
    if d >= MAX_DISTANCE {
        return None;
    }
    let j = first + products.iter().position(|p| *p == best)?;
    let is_elsewhere = |k: usize| {
        table.parts[k] != table.parts[j]
            || (table.points[k] - table.points[j]).norm_squared() > ONE_PLACE_M * ONE_PLACE_M
    };
    let elsewhere = products.iter().enumerate().fold(0, |most, (i, product)| {
        if *product > most && is_elsewhere(first + i) { *product } else { most }
    });
    Some(Match {
        part: table.parts[j],
        model_point: table.points[j],
        model_normal: table.normals[j],
        seen_point: query.point,
        seen_normal: query.normal,
        pixel: query.pixel,
        distance: d,
        ratio: d.max(1e-6) / distance(elsewhere).max(1e-6),
        tolerance: query.point.map_or(0.0, |p| tolerance(p.z)),
    })
}

/// Tolerance of a matched place at depth `z`, metres.
pub fn tolerance(z: f64) -> f64 {
    0.008 + 3.0 * linkage_driver::depth::depth_sigma(z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::appearance::DESCRIPTOR_LENGTH;

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
        let features = model.iter().map(|(number, x)| learned(*number, *x)).collect();
        let table = FeatureTable::new(&Appearance { features, ..Appearance::default() });
        let matches =
            Compared::new(&[seen(of)], &table).matches(|_| true, &RecogniseConfig::default());
        (matches.distinct.len(), matches.all.len())
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
}
