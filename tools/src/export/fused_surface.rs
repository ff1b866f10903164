//! The surface of a part as an implicit function, fused from the pieces that were seen.
//!
//! Near a place the surface is the moving-least-squares plane through the pieces around it that face
//! the same way. It ends a little beyond the last piece, but not in a gap between pieces (`gap.rs`).
//! The surface is open, so it is thickened inwards: the outer side is where the surface was seen, and
//! the whole is a closed body.

use super::colour::srgb;
use super::cuboid::Cuboid;
use super::gap::is_surrounded;
use super::patch::Patch;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::HashMap;

/// Most pieces that are fused: more are thinned.
const MOST_PATCHES: usize = 4_000;
/// Most samples of the function.
const MOST_SAMPLES: f64 = 1.5e6;
/// Least distance of samples, metres.
const LEAST_STEP_M: f64 = 0.004;
/// Thickness of the body, in distances of samples; a thinner one would get holes.
const THICKNESS: f64 = 2.2;
/// The neighbour whose distance tells how dense the pieces lie.
const SPACING_NEIGHBOUR: usize = 6;
/// Share of the pieces that have as many neighbours that near.
const DENSE_PERCENT: usize = 85;
/// How far the surface goes on beyond a piece, in such distances.
const REACH: f64 = 0.8;
/// How far from a place in a gap pieces may lie, in such distances: pieces that are drawn by chance
/// leave no wider ones.
const GAP: f64 = 2.0;
/// How far it goes on beyond all pieces, metres.
const RIM_M: f64 = 0.004;
/// Cosine between the normals of pieces of one side.
const SAME_SIDE: f64 = 0.5;

/// Samples of a function that is negative within the body.
pub struct Samples {
    pub counts: [usize; 3],
    pub step_m: f64,
    /// Of the first one.
    pub origin: Vector3<f64>,
    pub values: Vec<f32>,
}

/// The surface of a part.
pub struct FusedSurface {
    patches: Vec<Patch>,
    /// Pieces by the cell of `2 * spacing` in which they lie.
    cells: HashMap<[i64; 3], Vec<usize>>,
    spacing_m: f64,
    step_m: f64,
    /// Holds all pieces, along the sides of the part's box.
    hull: Cuboid,
}

impl FusedSurface {
    /// Of pieces of a part whose box is turned like `like`; `None` with too few.
    pub fn new(patches: &[Patch], like: &Cuboid) -> Option<Self> {
        let stride = patches.len().div_ceil(MOST_PATCHES).max(1);
        let patches: Vec<Patch> = patches.iter().step_by(stride).copied().collect();
        if patches.len() <= SPACING_NEIGHBOUR {
            return None;
        }
        let spacing_m = spacing(&patches).max(LEAST_STEP_M);
        let own = patches.iter().map(|p| like.rotation.inverse() * p.place);
        let (low, high) = own
            .fold((Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)), |(low, high), p| {
                (low.inf(&p), high.sup(&p))
            });
        let hull = Cuboid::between(low, high, like.rotation);
        let volume = hull.size.map(|side| side + 2.0 * LEAST_STEP_M).product();
        // A hull that is turned takes a larger share of the samples' block.
        let step_m = (3.0 * volume / MOST_SAMPLES).cbrt().max(LEAST_STEP_M);
        let mut cells: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
        for (i, patch) in patches.iter().enumerate() {
            cells.entry(cell(&patch.place, 2.0 * spacing_m)).or_default().push(i);
        }
        Some(Self { patches, cells, spacing_m, step_m, hull })
    }

    /// How thick the body is, metres.
    pub fn thickness_m(&self) -> f64 {
        THICKNESS * self.step_m
    }

    /// Samples of the function over all of the body.
    pub fn samples(&self) -> Samples {
        let corners = self.hull.corners().map(|c| c.coords);
        let margin = Vector3::repeat(self.thickness_m() + 2.0 * self.step_m);
        let low = corners.iter().fold(corners[0], |a, b| a.inf(b)) - margin;
        let high = corners.iter().fold(corners[0], |a, b| a.sup(b)) + margin;
        // The block round a turned hull may be far larger than the hull.
        let block = (high - low).product();
        let step_m = self.step_m.max((block / (4.0 * MOST_SAMPLES)).cbrt());
        let counts: [usize; 3] =
            std::array::from_fn(|k| ((high[k] - low[k]) / step_m).ceil() as usize + 1);
        let [nx, ny, _] = counts;
        let at = |i: usize| {
            let index = Vector3::new(i % nx, i / nx % ny, i / (nx * ny));
            low + index.map(|n| n as f64) * step_m
        };
        let count = counts.iter().product();
        let values = (0..count).into_par_iter().map(|i| self.value(&at(i)) as f32).collect();
        Samples { counts, step_m, origin: low, values }
    }

    /// Negative within the body, metres.
    fn value(&self, at: &Vector3<f64>) -> f64 {
        let outside = 4.0 * self.step_m;
        let beyond = distance_beyond(&self.hull, at) - RIM_M;
        if beyond > self.thickness_m() + self.step_m {
            return outside;
        }
        let near = self.near(at);
        let nearest = near.iter().map(|i| &self.patches[*i]);
        let Some(first) = nearest
            .min_by(|a, b| (a.place - at).norm_squared().total_cmp(&(b.place - at).norm_squared()))
        else {
            return outside;
        };
        let (mut sum, mut weights, mut aside) = (0.0, 0.0, f64::MAX);
        for patch in near.iter().map(|i| &self.patches[*i]) {
            if patch.normal.dot(&first.normal) > SAME_SIDE {
                let way = at - patch.place;
                let above = way.dot(&patch.normal);
                let weight = (-way.norm_squared() / self.spacing_m.powi(2)).exp().max(1e-12);
                sum += weight * above;
                weights += weight;
                aside = aside.min((way - patch.normal * above).norm());
            }
        }
        let reach = REACH * self.spacing_m;
        let edge = if aside > reach && self.is_in_gap(at, first, &near) {
            -0.5 * self.step_m
        } else {
            aside - reach
        };
        let half = 0.5 * self.thickness_m();
        let within = (sum / weights + half).abs() - half;
        within.max(edge).max(beyond).min(outside)
    }

    /// True where pieces that continue the nearest one lie all round a place.
    fn is_in_gap(&self, at: &Vector3<f64>, nearest: &Patch, near: &[usize]) -> bool {
        let ways = near.iter().map(|i| &self.patches[*i]).filter_map(|patch| {
            let way = patch.place - at;
            let along = way - nearest.normal * way.dot(&nearest.normal);
            let level = (patch.place - nearest.place).dot(&nearest.normal).abs();
            let continues = patch.normal.dot(&nearest.normal) > SAME_SIDE && level < self.spacing_m;
            (continues && along.norm() < GAP * self.spacing_m).then_some(along)
        });
        is_surrounded(&nearest.normal, ways)
    }

    /// Colour of a place on it.
    pub fn colour(&self, at: &Point3<f64>, normal: &Vector3<f64>) -> [f64; 3] {
        let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
        for patch in self.near(&at.coords).iter().map(|i| &self.patches[*i]) {
            let way = at.coords - patch.place;
            let faces = if patch.normal.dot(normal) > SAME_SIDE { 1.0 } else { 1e-3 };
            let weight =
                faces * (-4.0 * way.norm_squared() / self.spacing_m.powi(2)).exp().max(1e-12);
            sum += Vector3::from(patch.lab).map(f64::from) * weight;
            weights += weight;
        }
        let mean = sum / f64::max(weights, 1e-15);
        srgb(mean.map(|x| x as f32).into())
    }

    /// Pieces around a place.
    fn near(&self, at: &Vector3<f64>) -> Vec<usize> {
        let [x, y, z] = cell(at, 2.0 * self.spacing_m);
        let around = (0..27).map(|i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        around.filter_map(|c| self.cells.get(&c)).flatten().copied().collect()
    }
}

fn cell(place: &Vector3<f64>, side: f64) -> [i64; 3] {
    place.map(|x| (x / side).floor() as i64).into()
}

/// Distance of a place from a box; negative within.
fn distance_beyond(shape: &Cuboid, at: &Vector3<f64>) -> f64 {
    let own = shape.rotation.inverse() * (at - shape.center.coords);
    (own.abs() - 0.5 * shape.size).max()
}

/// Distance at which most pieces have a few others round them.
fn spacing(patches: &[Patch]) -> f64 {
    let stride = patches.len().div_ceil(300).max(1);
    let to_neighbour = patches.iter().step_by(stride).map(|patch| {
        let mut all: Vec<f64> =
            patches.iter().map(|p| (p.place - patch.place).norm_squared()).collect();
        let (_, at, _) = all.select_nth_unstable_by(SPACING_NEIGHBOUR, f64::total_cmp);
        at.sqrt()
    });
    let mut all: Vec<f64> = to_neighbour.collect();
    all.sort_by(f64::total_cmp);
    all[all.len() * DENSE_PERCENT / 100]
}
