//! Matches between an object's features and a scene's: nearest descriptor among those of the
//! right metric size, distinctly nearer than the best one at another place.

use super::RecogniseConfig;
use super::scene::Scene;
use crate::appearance::{Appearance, DESCRIPTOR_LENGTH, FeatureKind, dequantise};
use nalgebra::{DMatrix, Point3, Vector3};

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
    /// Ratio of distances: the smaller the more distinct.
    pub ratio: f64,
    /// Tolerance of its place, metres.
    pub tolerance: f64,
}

/// Features of one kind, their descriptors as columns.
struct Table {
    kind: FeatureKind,
    descriptors: DMatrix<f32>,
    parts: Vec<usize>,
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    log_sizes: Vec<f32>,
}

/// An object's features, ready to be compared with a scene's.
pub struct FeatureTable(Vec<Table>);

impl FeatureTable {
    /// Unpacks an appearance.
    pub fn new(appearance: &Appearance) -> Self {
        let of = |kind: FeatureKind| {
            let features: Vec<_> = appearance.features.iter().filter(|f| f.kind == kind).collect();
            let mut descriptors = DMatrix::zeros(DESCRIPTOR_LENGTH, features.len());
            for (mut column, f) in descriptors.column_iter_mut().zip(&features) {
                for (x, value) in column.iter_mut().zip(dequantise(&f.descriptor)) {
                    *x = value;
                }
            }
            let wide = |a: [f32; 3]| Vector3::from(a).map(f64::from);
            Table {
                kind,
                descriptors,
                parts: features.iter().map(|f| usize::from(f.part)).collect(),
                points: features.iter().map(|f| Point3::from(wide(f.point))).collect(),
                normals: features.iter().map(|f| wide(f.normal)).collect(),
                log_sizes: features.iter().map(|f| f.size_m.max(1e-6).ln()).collect(),
            }
        };
        Self(vec![of(FeatureKind::Picture), of(FeatureKind::Rectified)])
    }
}

/// Features nearer to one another than this are one place, metres.
const ONE_PLACE_M: f64 = 0.03;
/// Largest distance of unit descriptors.
const MAX_DISTANCE: f32 = 0.85;
/// How many of the best are searched for one at another place.
const RUNNERS_UP: usize = 24;

/// The most distinct matches of both kinds.
pub fn match_features(scene: &Scene, table: &FeatureTable, config: &RecogniseConfig) -> Vec<Match> {
    let mut matches: Vec<Match> =
        table.0.iter().flat_map(|t| match_kind(scene, t, config)).collect();
    matches.sort_by(|a, b| a.ratio.total_cmp(&b.ratio));
    matches
}

fn match_kind(scene: &Scene, table: &Table, config: &RecogniseConfig) -> Vec<Match> {
    let queries: Vec<_> = scene.features.iter().filter(|f| f.kind == table.kind).collect();
    if queries.is_empty() || table.parts.len() < 2 {
        return Vec::new();
    }
    let mut described = DMatrix::<f32>::zeros(DESCRIPTOR_LENGTH, queries.len());
    for (mut column, q) in described.column_iter_mut().zip(&queries) {
        column.copy_from_slice(&q.descriptor);
    }
    let similarity = table.descriptors.tr_mul(&described);
    let size_gate = match table.kind {
        FeatureKind::Picture => 1.6_f32.ln(),
        FeatureKind::Rectified => 1.1_f32.ln(),
    };
    let mut matches: Vec<Match> = queries
        .iter()
        .enumerate()
        .filter_map(|(i, query)| {
            let log_size = (query.size as f32).max(1e-6).ln();
            let gated = |j: usize| {
                query.point.is_none() || (table.log_sizes[j] - log_size).abs() < size_gate
            };
            let column = similarity.column(i);
            let mut ranked: Vec<(f32, usize)> = Vec::with_capacity(RUNNERS_UP + 1);
            for (j, &s) in column.iter().enumerate() {
                let worst = ranked.last().map_or(f32::MIN, |r| r.0);
                if (ranked.len() <= RUNNERS_UP || s > worst) && gated(j) {
                    let at = ranked.partition_point(|r| r.0 >= s);
                    ranked.insert(at, (s, j));
                    ranked.truncate(RUNNERS_UP + 1);
                }
            }
            let &(best, j) = ranked.first()?;
            let elsewhere = ranked
                .iter()
                .find(|(_, k)| {
                    table.parts[*k] != table.parts[j]
                        || (table.points[*k] - table.points[j]).norm() > ONE_PLACE_M
                })
                .or(ranked.last().filter(|_| ranked.len() > 1))
                .map_or(0.0, |r| r.0);
            let distance = |s: f32| (2.0 - 2.0 * s).max(0.0).sqrt();
            let (d, second) = (distance(best), distance(elsewhere));
            let ratio = f64::from(d / second.max(1e-6));
            (ratio < config.max_ratio && d < MAX_DISTANCE).then(|| Match {
                part: table.parts[j],
                model_point: table.points[j],
                model_normal: table.normals[j],
                seen_point: query.point,
                seen_normal: query.normal,
                pixel: query.pixel,
                ratio,
                tolerance: query.point.map_or(0.0, |p| tolerance(p.z)),
            })
        })
        .collect();
    matches.sort_by(|a, b| a.ratio.total_cmp(&b.ratio));
    matches.truncate(config.max_matches);
    matches
}

/// Tolerance of a matched place at depth `z`, metres.
pub fn tolerance(z: f64) -> f64 {
    0.008 + 3.0 * linkage_driver::depth::depth_sigma(z)
}
