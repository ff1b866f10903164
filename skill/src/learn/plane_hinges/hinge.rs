//! Finds the lines that turning planes keep their distance from, and the hinge of the planes about such a line.
//!
//! In: plane patches of all keyframes, and the edges of a part's face; base frame, metres.
//! Out: candidate lines, the best supported first; hinges with the turn of each plane (radians) and the information
//! of the line's place.
//! From: lines of all pairs of planes, ranked by their support; linear least squares; least trimmed squares.

use super::face_edge::{EdgePoint, FaceEdges};
use super::plane_segments::PlanePatch;
use super::planes_about_axis::{PoseAboutAxis, near};
use crate::learn::learned_joint::TurningPlane;
use crate::math::rigid::{distance_to_line, line_angle, orthonormal_basis};
use crate::object::joint_geometry::JointGeometry;
use nalgebra::{
    DMatrix, DVector, Matrix2, Matrix3, Matrix3x2, Point3, SymmetricEigen, UnitVector3, Vector3,
};
use rayon::prelude::*;

/// Range of the turn between two planes that suggest a hinge, radians.
const PAIR_TURN_RAD: std::ops::Range<f64> = 0.12..2.2;
/// Largest sine of the angle between a hinge and a plane that supports it.
const MAX_TILT: f64 = 0.08;
/// Largest distance between a hinge and a plane that supports it, metres.
const MAX_DISTANCE_M: f64 = 0.04;
/// Error of a hinge's direction that all planes share, radians; more planes do not reduce it.
pub const SYSTEMATIC_RAD: f64 = 0.0025;
/// Largest gap between a hinge's line and its part, metres.
const MAX_GAP_M: f64 = 0.25;
/// Largest distance of a part's far edge from the line, metres.
const MAX_REACH_M: f64 = 2.5;
/// Standard deviation of a plane's distance from the line, metres.
const RESIDUAL_M: f64 = 0.003;
/// Standard deviation of the line's distance from its part's face, metres: parts have a thickness, and
/// hinges stand out.
const OFFSET_M: f64 = 0.02;
/// Standard deviation of the line's distance from the faces of a plate that shows both, metres: one face is farther
/// by the thickness.
const OFFSET_OF_PLATE_M: f64 = 0.04;
/// Standard deviation of an observed point of an edge, metres, as if keyframes were independent.
const EDGE_READING_M: f64 = 0.03;
/// Standard deviation of the line's distance from the near edge of its part's face, metres.
const EDGE_M: f64 = 0.02;
/// Largest share of the planes that are removed as outliers.
const MAX_OUTLIERS: f64 = 0.25;
/// Smallest standard deviation that a plane's distance is given, metres: planes share errors.
const LEAST_RMSE_M: f64 = 0.001;
/// Factor on the standard deviation of a plane's distance, because the planes are correlated.
const CORRELATED: f64 = 6.0;
/// Standard deviation of a line's place, if it lies in the face of its part, below which the line is not aligned to
/// the depth images, metres. Aligned lines of doors whose planes were good were 3 to 7 cm off, their planes' 1 cm:
/// depth errors are correlated where a surface is seen edge-on.
const WELL_KNOWN_M: f64 = 0.01;
/// Fewest planes that determine the direction of their line.
const MIN_TELLING: usize = 8;
/// Smallest turn between planes that determine the direction of their line, radians.
const MIN_TELLING_TURN_RAD: f64 = 0.2;
/// Largest angle between two lines that count as one, radians.
const SAME_ANGLE_RAD: f64 = 0.1;
/// Largest distance between two lines that count as one, metres.
const SAME_LINE_M: f64 = 0.08;

/// A hinge and the planes that turn about it.
#[derive(Debug, Clone)]
pub struct Hinge {
    /// Unit direction of the line, base frame.
    pub axis: Vector3<f64>,
    /// A point on the line, base frame.
    pub origin: Point3<f64>,
    /// Frame and turn of each plane, radians; the turn of the first plane is 0.
    pub turns: Vec<(usize, f64)>,
    /// For each plane, in the order of `turns`, true if it is the face that faces the way the plate turns.
    is_outer: Vec<bool>,
    /// Points of the part at turn 0.
    pub points: Vec<Point3<f64>>,
    /// Index in `turns` of the largest plane, to which `points` belong.
    largest: usize,
    /// Sum over the planes of the normal's outer product with itself: how well it determines each direction.
    normal_scatter: Matrix3<f64>,
    /// Information (inverse covariance) of the line's place from the planes and the edges of the face, base frame.
    pub place_information: Matrix3<f64>,
    /// Information of the line's place if the line lay in the face, base frame.
    in_face_information: Matrix3<f64>,
    /// True if the edge of the face next to the line was seen.
    pub has_near_edge: bool,
    /// Distances of the planes from where the hinge puts them, in the order of `turns`, metres.
    pub residuals: Vec<f64>,
    /// Root mean square of `residuals`, metres.
    pub rmse: f64,
}

/// A line and the planes that turn about it.
pub struct Candidate {
    axis: Vector3<f64>,
    origin: Point3<f64>,
    /// Indices of the planes that lie about the line.
    pub support: Vec<usize>,
    /// Number of samples of the supporting planes.
    samples: usize,
}

impl Candidate {
    /// The hinge of the planes in `support`, and of the edges of their face.
    pub fn hinge(
        &self,
        patches: &[PlanePatch],
        support: &[usize],
        edges: &FaceEdges,
    ) -> Option<Hinge> {
        refined(patches, support, edges, &self.axis, &self.origin)
    }

    /// The hinge of the planes in `support`. If their residual exceeds `max_rmse` metres, outliers are removed from
    /// `support` (least trimmed squares). While another leaf moves beside a part, the part's plane takes readings of
    /// that leaf.
    pub fn hinge_without_outliers(
        &self,
        patches: &[PlanePatch],
        support: &mut Vec<usize>,
        max_rmse: f64,
    ) -> Option<Hinge> {
        let hinge_of = |planes: &[usize]| self.hinge(patches, planes, &FaceEdges::default());
        let all = hinge_of(support)?;
        if all.rmse <= max_rmse {
            return Some(all);
        }
        let mut kept = support.clone();
        for _ in 0..(MAX_OUTLIERS * support.len() as f64) as usize {
            let hinge = hinge_of(&kept)?;
            let distance = |k: &usize| hinge.residuals[*k].abs();
            kept.remove((0..kept.len()).max_by(|a, b| distance(a).total_cmp(&distance(b)))?);
        }
        let trimmed = hinge_of(&kept)?;
        if trimmed.rmse > max_rmse {
            return Some(all);
        }
        *support = kept;
        Some(trimmed)
    }

    /// The plane that turns about the line, if enough planes determine the direction.
    pub fn turning_plane(&self, patches: &[PlanePatch]) -> Option<TurningPlane> {
        let hinge = self.hinge(patches, &self.support, &FaceEdges::default())?;
        let [low, high] = hinge.range();
        let is_told = hinge.turns.len() >= MIN_TELLING && high - low > MIN_TELLING_TURN_RAD;
        let sum: Vector3<f64> = hinge.points.iter().map(|p| p.coords).sum();
        let middle = Point3::from(sum / hinge.points.len() as f64);
        is_told.then_some(TurningPlane { axis: hinge.axis, origin: hinge.origin, middle })
    }

    /// True if two candidates have about the same line and are mostly supported by the same planes.
    fn is_like(&self, other: &Self) -> bool {
        line_angle(&self.axis, &other.axis) < SAME_ANGLE_RAD
            && distance_to_line(&self.origin, &self.axis, &other.origin) < SAME_LINE_M
            && 2 * self.support.iter().filter(|k| other.support.contains(k)).count()
                > other.support.len()
    }
}

/// Lines that planes turn about, the best supported first, at most `most`. Of lines that count as one, only the best
/// is kept. A plane counts half for each line before that it supports: the planes of a trunk that sways lie about many
/// lines, and must not keep a door out of the list.
pub fn candidates(patches: &[PlanePatch], most: usize) -> Vec<Candidate> {
    let mut all: Vec<Candidate> = (0..patches.len())
        .into_par_iter()
        .flat_map_iter(|i| (i + 1..patches.len()).filter_map(move |j| candidate(patches, i, j)))
        .collect();
    all.sort_by_key(|c| std::cmp::Reverse(c.samples));
    let mut worth: Vec<f64> = patches.iter().map(|patch| patch.points.len() as f64).collect();
    let mut distinct: Vec<Candidate> = Vec::new();
    while distinct.len() < most {
        let supported = |c: &Candidate| c.support.iter().map(|&k| worth[k]).sum::<f64>();
        // Of equals the first one, which is that with most samples.
        let best =
            (0..all.len()).rev().max_by(|&a, &b| supported(&all[a]).total_cmp(&supported(&all[b])));
        let Some(best) = best else { break };
        let best = all.remove(best);
        best.support.iter().for_each(|&k| worth[k] *= 0.5);
        all.retain(|c| !best.is_like(c));
        distinct.push(best);
    }
    distinct
}

/// The line about which patch `i` may turn to become patch `j`.
fn candidate(patches: &[PlanePatch], i: usize, j: usize) -> Option<Candidate> {
    let (a, b) = (&patches[i], &patches[j]);
    if a.frame == b.frame {
        return None;
    }
    let (axis, origin) = line_between(a, b)?;
    let pose = PoseAboutAxis::of(a, &origin, &axis)?;
    PoseAboutAxis::of(b, &origin, &axis).filter(|other| pose.alike(other))?;
    if pose.least > MAX_GAP_M || pose.reach > MAX_REACH_M {
        return None;
    }
    let support = supporters(patches, &axis, &origin, &pose);
    let samples = support.iter().map(|&k| patches[k].points.len()).sum();
    Some(Candidate { axis, origin, support, samples })
}

/// The intersection of two planes: unit direction and a point, base frame.
fn line_between(a: &PlanePatch, b: &PlanePatch) -> Option<(Vector3<f64>, Point3<f64>)> {
    // A lid shows its other face when it has turned over, so the sign of a normal is ignored.
    let cross = a.normal.cross(&b.normal);
    let turn = cross.norm().atan2(a.normal.dot(&b.normal).abs());
    if !PAIR_TURN_RAD.contains(&turn) {
        return None;
    }
    let axis = cross.normalize();
    let rows = Matrix3::from_rows(&[a.normal.transpose(), b.normal.transpose(), axis.transpose()]);
    let n = a.points.len() as f64;
    let along = axis.dot(&(a.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n));
    let origin = rows.try_inverse()? * Vector3::new(a.offset, b.offset, along);
    Some((axis, Point3::from(origin)))
}

/// In each frame the largest patch that lies about the line, if any does.
fn supporters(
    patches: &[PlanePatch],
    axis: &Vector3<f64>,
    origin: &Point3<f64>,
    pose: &PoseAboutAxis,
) -> Vec<usize> {
    let mut found: Vec<usize> = Vec::new();
    for (k, patch) in patches.iter().enumerate() {
        let fits = patch.normal.dot(axis).abs() < MAX_TILT
            && (patch.offset - patch.normal.dot(&origin.coords)).abs() < MAX_DISTANCE_M
            && PoseAboutAxis::of(patch, origin, axis).is_some_and(|other| pose.alike(&other));
        if !fits {
            continue;
        }
        match found.last_mut() {
            Some(last) if patches[*last].frame == patch.frame => {
                if patch.points.len() > patches[*last].points.len() {
                    *last = k;
                }
            }
            _ => found.push(k),
        }
    }
    found
}

/// The line by least squares: its direction is perpendicular to all normals; its place keeps a constant distance from
/// the planes, one for each face, and is near the edge of the face.
fn refined(
    patches: &[PlanePatch],
    support: &[usize],
    edges: &FaceEdges,
    axis: &Vector3<f64>,
    origin: &Point3<f64>,
) -> Option<Hinge> {
    let planes: Vec<&PlanePatch> = support.iter().map(|&k| &patches[k]).collect();
    if planes.len() < 4 {
        return None;
    }
    let mut normal_scatter = Matrix3::zeros();
    for p in &planes {
        normal_scatter += p.normal * p.normal.transpose();
    }
    let eigen = SymmetricEigen::new(normal_scatter);
    let mut direction = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    if direction.dot(axis) < 0.0 {
        direction = -direction;
    }
    let arms: Vec<Vector3<f64>> = planes
        .iter()
        .map(|p| PoseAboutAxis::of(p, origin, &direction).map(|pose| pose.arm))
        .collect::<Option<_>>()?;
    let place = PlaceSystem::of(&planes, &arms, edges, &direction, origin);
    let solved = place.solution()?;
    let residuals = place.residuals_of_planes(&solved);
    let rmse = (residuals.norm_squared() / residuals.len() as f64).sqrt();
    let (place_information, in_face_information) = place.information(rmse);
    let (u, v) = orthonormal_basis(&direction);
    let origin = origin + u * solved[0] + v * solved[1];
    let turns: Vec<(usize, f64)> = unwrapped(&planes, &arms, &direction);
    let largest = (0..planes.len()).max_by_key(|&k| planes[k].points.len())?;
    let mut hinge = Hinge {
        axis: direction,
        origin,
        turns,
        is_outer: (0..planes.len()).map(|k| is_outer(planes[k], &arms[k], &direction)).collect(),
        points: Vec::new(),
        largest,
        normal_scatter,
        place_information,
        in_face_information,
        has_near_edge: !edges.near.is_empty(),
        residuals: residuals.iter().copied().collect(),
        rmse,
    };
    let back = hinge.geometry().motion(-hinge.turns[largest].1);
    hinge.points = planes[largest].points.iter().map(|p| back * p).collect();
    Some(hinge)
}

/// True if a plane is the face of a plate that faces the way the plate turns.
fn is_outer(plane: &PlanePatch, arm: &Vector3<f64>, direction: &Vector3<f64>) -> bool {
    direction.cross(arm).dot(&plane.normal) > 0.0
}

/// Linear equations for the place of a line of known direction. The unknowns are its shift along two directions
/// across it, the distance of each face from it, and those of the two edges of the face.
struct PlaceSystem {
    rows: DMatrix<f64>,
    right: DVector<f64>,
    /// Number of rows of planes, which come first; one row for each face follows.
    planes: usize,
    /// Number of columns of faces, after the two of the shift.
    faces: usize,
    /// The two directions of the shift, unit vectors.
    across: Matrix3x2<f64>,
}

impl PlaceSystem {
    fn of(
        planes: &[&PlanePatch],
        arms: &[Vector3<f64>],
        edges: &FaceEdges,
        direction: &Vector3<f64>,
        origin: &Point3<f64>,
    ) -> Self {
        let (u, v) = orthonormal_basis(direction);
        let outer = |k: usize| is_outer(planes[k], &arms[k], direction);
        let both = (0..planes.len()).any(outer) && !(0..planes.len()).all(outer);
        let faces = if both { 2 } else { 1 };
        let (near, far) = (2 + faces, 3 + faces);
        // A row is the unit vector along which it measures, the column of its distance, its weight, and the measured
        // value, metres.
        let mut rows: Vec<(Vector3<f64>, usize, f64, f64)> = Vec::new();
        for (k, plane) in planes.iter().enumerate() {
            let face = 2 + usize::from(both && !outer(k));
            let measured = plane.offset - plane.normal.dot(&origin.coords);
            rows.push((plane.normal, face, 1.0, measured));
        }
        // Prior: the line lies near its face, a distance that small turns hardly determine.
        let offset = if both { OFFSET_OF_PLATE_M } else { OFFSET_M };
        rows.extend((0..faces).map(|f| (Vector3::zeros(), 2 + f, RESIDUAL_M / offset, 0.0)));
        let nominal = CORRELATED * RESIDUAL_M;
        let reading = |column: usize| {
            move |(point, arm): &EdgePoint| {
                (*arm, column, nominal / EDGE_READING_M, arm.dot(&(point - origin)))
            }
        };
        rows.extend(edges.near.iter().map(reading(near)));
        rows.extend(edges.far.iter().map(reading(far)));
        // Prior: the line lies near the near edge. The column of an edge that is not seen has no effect.
        rows.push((Vector3::zeros(), near, nominal / EDGE_M, 0.0));
        rows.push((Vector3::zeros(), far, nominal, 0.0));
        let matrix = DMatrix::from_fn(rows.len(), far + 1, |k, c| {
            let (along, column, weight, _) = rows[k];
            match c {
                0 => weight * along.dot(&u),
                1 => weight * along.dot(&v),
                _ if c == column => weight,
                _ => 0.0,
            }
        });
        let right = DVector::from_iterator(rows.len(), rows.iter().map(|(.., w, m)| w * m));
        let across = Matrix3x2::from_columns(&[u, v]);
        Self { rows: matrix, right, planes: planes.len(), faces, across }
    }

    /// The unknowns by least squares, metres.
    fn solution(&self) -> Option<DVector<f64>> {
        self.rows.clone().svd(true, true).solve(&self.right, 1e-6).ok()
    }

    /// Distances of the planes from where a solution puts them, metres.
    fn residuals_of_planes(&self, solution: &DVector<f64>) -> DVector<f64> {
        (&self.rows * solution - &self.right).rows(0, self.planes).into_owned()
    }

    /// Information (inverse covariance) of the place, base frame: without the prior that the line lies near its face;
    /// and as if the line lay in the face.
    fn information(&self, rmse: f64) -> (Matrix3<f64>, Matrix3<f64>) {
        let after_faces = self.planes + self.faces;
        let of_planes = self.rows.rows(0, self.planes) / plane_sigma(rmse);
        let of_edges = self.rows.rows(after_faces, self.rows.nrows() - after_faces)
            / (CORRELATED * RESIDUAL_M);
        let all = of_planes.transpose() * &of_planes + of_edges.transpose() * &of_edges;
        let columns = all.ncols();
        let without_faces: Vec<usize> =
            (0..columns).filter(|c| !(2..2 + self.faces).contains(c)).collect();
        let in_face = all.select_columns(&without_faces).select_rows(&without_faces);
        let in_base = |own: Matrix2<f64>| self.across * own * self.across.transpose();
        (in_base(without_others(&all)), in_base(without_others(&in_face)))
    }
}

/// Information of the first two unknowns after the others are eliminated (Schur complement).
fn without_others(all: &DMatrix<f64>) -> Matrix2<f64> {
    let others = all.ncols() - 2;
    let own = all.fixed_view::<2, 2>(0, 0).into_owned();
    let cross = all.view((0, 2), (2, others)).into_owned();
    let inner = all.view((2, 2), (others, others)) + DMatrix::identity(others, others) * 1e-6;
    let explained = inner.cholesky().map(|c| &cross * c.solve(&cross.transpose()));
    explained.map_or(own, |e| own - e.fixed_view::<2, 2>(0, 0))
}

/// Standard deviation of a plane's distance from the line, metres, as if planes were independent.
fn plane_sigma(rmse: f64) -> f64 {
    rmse.max(LEAST_RMSE_M) * CORRELATED
}

/// Frame of each plane, and the turn of its arm from the first, without jumps of a whole turn.
fn unwrapped(
    planes: &[&PlanePatch],
    arms: &[Vector3<f64>],
    axis: &Vector3<f64>,
) -> Vec<(usize, f64)> {
    let mut before = 0.0;
    planes
        .iter()
        .zip(arms)
        .map(|(plane, arm)| {
            let turn = axis.dot(&arms[0].cross(arm)).atan2(arms[0].dot(arm));
            before = near(turn, before);
            (plane.frame, before)
        })
        .collect()
}

impl Hinge {
    /// The hinge as the geometry of a joint.
    pub fn geometry(&self) -> JointGeometry {
        JointGeometry::hinge(UnitVector3::new_normalize(self.axis), self.origin)
    }

    /// Smallest and largest turn, radians.
    pub fn range(&self) -> [f64; 2] {
        let turns = || self.turns.iter().map(|(_, q)| *q);
        [turns().fold(f64::INFINITY, f64::min), turns().fold(f64::NEG_INFINITY, f64::max)]
    }

    /// Number of planes that lie between the ends of the range, farther than `apart` radians from both.
    pub fn planes_between(&self, apart: f64) -> usize {
        let [low, high] = self.range();
        self.turns.iter().filter(|(_, q)| *q > low + apart && *q < high - apart).count()
    }

    /// Indices in `turns` of the largest plane and of the planes at the ends of the range; each once.
    pub fn ends(&self) -> Vec<usize> {
        let by_turn = |a: &usize, b: &usize| self.turns[*a].1.total_cmp(&self.turns[*b].1);
        let all = || 0..self.turns.len();
        let mut ends = vec![self.largest];
        for end in [all().min_by(by_turn), all().max_by(by_turn)].into_iter().flatten() {
            if !ends.contains(&end) {
                ends.push(end);
            }
        }
        ends
    }

    /// Largest number of consecutive planes whose turns stay within `still` radians.
    pub fn longest_rest(&self, still: f64) -> usize {
        let mut by_frame = self.turns.clone();
        by_frame.sort_by_key(|(frame, _)| *frame);
        let from = |start: usize| {
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            let stays = |(_, turn): &&(usize, f64)| {
                (low, high) = (low.min(*turn), high.max(*turn));
                high - low < still
            };
            by_frame[start..].iter().take_while(stays).count()
        };
        (0..by_frame.len()).map(from).max().unwrap_or(0)
    }

    /// Indices in `turns` of the planes of the other face than that of plane `plane`.
    pub fn of_other_face(&self, plane: usize) -> impl Iterator<Item = usize> {
        (0..self.turns.len()).filter(move |k| self.is_outer[*k] != self.is_outer[plane])
    }

    /// Standard deviation of the line's direction towards `side`, a unit vector across the line; radians.
    pub fn direction_sigma(&self, side: &Vector3<f64>) -> f64 {
        let seen = side.dot(&(self.normal_scatter * side)).max(1e-3);
        plane_sigma(self.rmse) / seen.sqrt() / self.reach().max(0.1)
    }

    /// The largest standard deviation of the line's place across it, metres, if the line lies in the
    /// face of its part.
    pub fn place_sigma_in_face(&self) -> f64 {
        let (u, v) = orthonormal_basis(&self.axis);
        let across = Matrix3x2::from_columns(&[u, v]);
        let seen = across.transpose() * self.in_face_information * across;
        1.0 / seen.symmetric_eigenvalues().min().max(1.0).sqrt()
    }

    /// True if the planes alone determine the place of the line well.
    pub fn is_well_known(&self) -> bool {
        self.place_sigma_in_face() < WELL_KNOWN_M
    }

    /// Distance from the line to the farthest point of the part, metres.
    pub fn reach(&self) -> f64 {
        self.points
            .iter()
            .map(|p| distance_to_line(&self.origin, &self.axis, p))
            .fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::rotation_about;

    /// A plain door, half a metre wide and a metre high, that opens by 80 degrees and rests.
    fn patches(axis: &UnitVector3<f64>, origin: &Point3<f64>) -> Vec<PlanePatch> {
        (0..20)
            .map(|k| {
                let q = 1.4 * (f64::from(k) / 12.0).min(1.0);
                let motion = rotation_about(origin, axis, q);
                let points: Vec<Point3<f64>> = (0..100)
                    .map(|i| {
                        let (x, y) = (f64::from(i % 10) * 0.05, f64::from(i / 10) * 0.1 - 0.5);
                        motion * (origin + Vector3::new(0.02 + x, y, -0.02))
                    })
                    .collect();
                let normal = motion * -Vector3::z();
                PlanePatch {
                    frame: 4 * k as usize,
                    normal,
                    offset: normal.dot(&points[0].coords),
                    points,
                }
            })
            .collect()
    }

    /// The patches, with one in `every` of them 4 cm off.
    fn with_outliers(patches: Vec<PlanePatch>, every: usize) -> Vec<PlanePatch> {
        let off = |(k, p): (usize, PlanePatch)| {
            let outlier = 0.04 * f64::from(u8::from(k % every == 1));
            PlanePatch { offset: p.offset + outlier, ..p }
        };
        patches.into_iter().enumerate().map(off).collect()
    }

    #[test]
    fn planes_that_turn_enough_tell_the_direction_of_their_line() {
        let axis = UnitVector3::new_normalize(Vector3::new(0.1, 1.0, 0.0));
        let planes = patches(&axis, &Point3::new(0.2, 0.0, 1.5));
        let found = candidates(&planes, 1);
        let told = found[0].turning_plane(&planes).unwrap();
        assert!(line_angle(&told.axis, &axis) < 1e-3);
        assert!((told.middle - Point3::new(0.445, -0.05, 1.5)).norm() < 0.1, "{}", told.middle);
        let few = &planes[..6];
        assert!(candidates(few, 1).iter().all(|c| c.turning_plane(few).is_none()));
    }

    #[test]
    fn planes_that_lie_about_many_lines_do_not_keep_a_door_out_of_the_list() {
        let (axis, origin) = (Vector3::y_axis(), Point3::new(-0.2, 0.1, 1.5));
        let mut planes = patches(&axis, &origin);
        // A trunk that sways: larger planes, which turn a little about lines of many directions.
        planes.extend((0..20).map(|k| {
            let wave = |speed: f64| 0.12 * (speed * f64::from(k)).sin();
            let normal = Vector3::new(wave(0.7), wave(1.1), -1.0).normalize();
            let points: Vec<Point3<f64>> = (0..300)
                .map(|i| Point3::new(0.8 + 0.01 * f64::from(i % 20), 0.02 * f64::from(i / 20), 1.2))
                .collect();
            PlanePatch {
                frame: 4 * k as usize,
                normal,
                offset: normal.dot(&points[0].coords),
                points,
            }
        }));
        let found = candidates(&planes, 6);
        let is_doors = |c: &Candidate| line_angle(&c.axis, &axis) < 0.02 && c.support.len() > 15;
        assert!(
            found.iter().any(is_doors),
            "{:?}",
            found.iter().map(|c| c.axis).collect::<Vec<_>>()
        );
        assert!(found[0].samples >= found.iter().map(|c| c.samples).max().unwrap());
    }

    #[test]
    fn the_longest_rest_is_counted_in_planes_on_end_in_time_order() {
        let (axis, origin) = (Vector3::y_axis(), Point3::new(-0.2, 0.1, 1.5));
        let mut planes = patches(&axis, &origin);
        planes.reverse();
        let support: Vec<usize> = (0..20).collect();
        let hinge = candidates(&planes, 1)[0].hinge(&planes, &support, &FaceEdges::default());
        // The door opens over 12 frames and rests for the other 8.
        assert_eq!(hinge.as_ref().unwrap().longest_rest(0.01), 8);
        assert_eq!(hinge.unwrap().longest_rest(10.0), 20);
    }

    #[test]
    fn a_few_outliers_among_the_planes_are_left_out() {
        let (axis, origin) = (Vector3::y_axis(), Point3::new(-0.2, 0.1, 1.5));
        let patches = with_outliers(patches(&axis, &origin), 5);
        let best = &candidates(&patches, 1)[0];
        let mut support: Vec<usize> = (0..20).collect();
        let hinge = best.hinge_without_outliers(&patches, &mut support, 0.008).unwrap();
        assert!(support.iter().all(|k| k % 5 != 1), "{support:?}");
        assert!(distance_to_line(&hinge.origin, &hinge.axis, &origin) < 6e-3);
    }

    #[test]
    fn of_planes_half_of_which_are_outliers_none_is_left_out() {
        let (axis, origin) = (Vector3::y_axis(), Point3::new(-0.2, 0.1, 1.5));
        let patches = with_outliers(patches(&axis, &origin), 2);
        let best = &candidates(&patches, 1)[0];
        let mut support: Vec<usize> = (0..20).collect();
        let hinge = best.hinge_without_outliers(&patches, &mut support, 0.008).unwrap();
        assert!(support.len() == 20 && hinge.rmse > 0.008);
    }

    #[test]
    fn a_plain_door_gives_its_hinge_beside_its_plane() {
        let (axis, origin) = (Vector3::y_axis(), Point3::new(-0.2, 0.1, 1.5));
        let patches = patches(&axis, &origin);
        let best = &candidates(&patches, 1)[0];
        let hinge = best.hinge(&patches, &best.support, &FaceEdges::default()).unwrap();
        assert!(hinge.axis.dot(&axis).abs() > 0.999_99);
        // The door's face lies 2 cm before its line, which is expected, but not for sure.
        assert!(distance_to_line(&hinge.origin, &hinge.axis, &origin) < 3e-3);
        let [low, high] = hinge.range();
        assert!((high - low - 1.4).abs() < 1e-3);
    }
}
