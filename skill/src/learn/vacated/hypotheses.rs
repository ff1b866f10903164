//! Proposes joints that could have moved a surface from its rest to where it is when its place is empty: all hinges
//! of a coarse grid of lines, and slides, along given directions.
//!
//! In: a surface at rest, directions, lines of known joints, lines about which planes turned, and the moving readings
//! of each keyframe; base frame.
//! Out: the best hypotheses with their scores.
//! From: exhaustive search, coarse to fine.

use super::moving_points::{Evidence, MovingPoints};
use super::rest_surface::RestSurface;
use crate::math::rigid::{Pose, distance_to_line, line_angle, orthonormal_basis};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::{Point3, UnitVector3, Vector3};
use rayon::prelude::*;

/// Lines of the grid in each of the two directions across an axis.
const GRID: usize = 13;
/// How far the grid extends beyond the surface, as a share of its size.
const BEYOND: f64 = 0.5;
/// How much farther the grid extends beyond the surface, metres.
const BEYOND_M: f64 = 0.04;
/// Largest turn from the rest, radians.
const MAX_TURN_RAD: f64 = 2.5;
/// Largest shift from the rest, metres.
const MAX_SHIFT_M: f64 = 0.7;
/// Smallest reach of a surface from its line, metres; a smaller one counts as this.
const MIN_REACH_M: f64 = 0.02;
/// Largest reach of a surface from its line, metres; about a line farther away the surface slides.
const MAX_REACH_M: f64 = 3.0;
/// Distance that the surface moves between two configurations that are tried, metres.
const STEP_M: f64 = 0.025;
/// Number of points of the surface, and of keyframes, by which hypotheses are scored.
struct Effort {
    points: usize,
    keyframes: usize,
}
/// Effort for all hinges of the grid.
const COARSE: Effort = Effort { points: 20, keyframes: 3 };
/// Effort for the best hinges of the grid, the known lines, those of planes and the slides.
const FINE: Effort = Effort { points: 60, keyframes: 6 };
/// Share of the grid's hinges that is kept after coarse scoring.
const BEST: f64 = 0.2;
/// Smallest share of the points at rest that a keyframe must see through for the surface to be elsewhere.
const ELSEWHERE: f64 = 0.35;
/// Angle below which two lines may count as one, radians.
const SAME_RAD: f64 = 0.1;
/// Distance below which two lines may count as one, in steps of the grid.
const SAME_STEPS: f64 = 1.2;
/// Step that stands for the uncertainty of a line about which planes turned, metres.
const STEP_OF_PLANES_M: f64 = 0.03;

/// A joint that is tried, with its score: the mean over keyframes of the share of the surface's points that are
/// found, less those that are seen through, at the best configuration.
#[derive(Debug, Clone, Copy)]
pub struct Hypothesis {
    /// Line of the joint; configuration 0 is the rest.
    pub geometry: JointGeometry,
    /// Score, from -1 to 1.
    pub score: f64,
    /// True if the line is that of a known joint.
    pub is_known: bool,
    /// Distance between the lines of the grid, metres; [`STEP_OF_PLANES_M`] for a line of planes; 0 for a known line or a
    /// slide.
    step: f64,
}

/// The keyframes in which the surface is not where it rests.
fn elsewhere<'m, 'v, 'r>(
    surface: &RestSurface,
    moving: &'m [MovingPoints<'v, 'r>],
) -> Vec<&'m MovingPoints<'v, 'r>> {
    let is_vacated = |view: &&MovingPoints| {
        let camera_from_part = view.camera_from_part(&Pose::identity());
        let evidence = |(p, n)| view.evidence(&camera_from_part, p, n);
        let places = surface.points.iter().zip(&surface.normals);
        let through = places.filter(|place| evidence(*place) == Evidence::Through).count();
        through as f64 >= ELSEWHERE * surface.points.len() as f64
    };
    moving.iter().filter(is_vacated).collect()
}

/// At most `most` of the keyframes, evenly chosen.
fn evenly<'m, 'v, 'r>(
    all: &[&'m MovingPoints<'v, 'r>],
    most: usize,
) -> Vec<&'m MovingPoints<'v, 'r>> {
    let n = all.len().min(most);
    (0..n).map(|k| all[k * (all.len() - 1) / (n - 1).max(1)]).collect()
}

/// The best hypotheses: at most `hinges` distinct hinges and `slides` distinct slides. Lines of known joints come
/// before those of planes and of the grid.
pub fn best_hypotheses(
    surface: &RestSurface,
    directions: &[Vector3<f64>],
    lines: &[JointGeometry],
    of_planes: &[JointGeometry],
    moving: &[MovingPoints],
    [hinges, slides]: [usize; 2],
) -> Vec<Hypothesis> {
    let elsewhere = elsewhere(surface, moving);
    if elsewhere.is_empty() {
        return Vec::new();
    }
    let score_by = |effort: &Effort, hypotheses: &mut [Hypothesis]| {
        let few = surface.thinned(effort.points);
        let targets = evenly(&elsewhere, effort.keyframes);
        hypotheses.par_iter_mut().for_each(|h| h.score = score(&h.geometry, &few, &targets));
    };
    let untried = |geometry, step, is_known| Hypothesis { geometry, score: -1.0, is_known, step };
    let known = lines.iter().map(|&line| untried(line, 0.0, true));
    let grid = directions.iter().flat_map(|d| hinges_along(d, surface));
    let grid = grid.map(|(line, step)| untried(line, step, false));
    let slide = |d: &Vector3<f64>| {
        let direction = UnitVector3::new_normalize(*d);
        untried(JointGeometry::slide(direction, surface.centre()), 0.0, false)
    };
    let mut of_grid: Vec<Hypothesis> = grid.collect();
    score_by(&COARSE, &mut of_grid);
    of_grid.sort_by(|a, b| b.score.total_cmp(&a.score));
    of_grid.truncate((BEST * of_grid.len() as f64).ceil() as usize);
    // A line nearly parallel to a direction of the surroundings is also tried exactly parallel to it.
    let squared = |line: &JointGeometry| {
        let line = *line;
        let near = directions.iter().filter(move |d| line_angle(d, &line.axis) < SAME_RAD);
        let along = |d: &Vector3<f64>| UnitVector3::new_normalize(*d);
        let exact = near.map(move |d| JointGeometry { axis: along(d), ..line });
        exact.chain([line]).collect::<Vec<_>>()
    };
    let of_planes = of_planes.iter().flat_map(squared);
    let of_planes = of_planes.map(|line| untried(line, STEP_OF_PLANES_M, false));
    let mut scored: Vec<Hypothesis> =
        known.chain(of_planes).chain(of_grid).chain(directions.iter().map(slide)).collect();
    score_by(&FINE, &mut scored);
    scored.sort_by(|a, b| b.is_known.cmp(&a.is_known).then(b.score.total_cmp(&a.score)));
    let mut chosen: Vec<Hypothesis> = Vec::new();
    for hypothesis in scored {
        let of_kind = |kind| chosen.iter().filter(move |c| c.geometry.kind == kind);
        let kind = hypothesis.geometry.kind;
        let room = if kind == JointKind::Revolute { hinges } else { slides };
        if of_kind(kind).count() < room && !of_kind(kind).any(|c| is_same(c, &hypothesis)) {
            chosen.push(hypothesis);
        }
    }
    chosen
}

/// True if two hypotheses of one kind have about the same line.
fn is_same(a: &Hypothesis, b: &Hypothesis) -> bool {
    let (a_line, b_line) = (&a.geometry, &b.geometry);
    line_angle(&a_line.axis, &b_line.axis) < SAME_RAD
        && (a_line.kind != JointKind::Revolute
            || distance_to_line(&a_line.origin, &a_line.axis, &b_line.origin)
                < SAME_STEPS * a.step.max(b.step))
}

/// Hinges along a direction, on a grid across it near the surface, each with the distance between lines, metres.
fn hinges_along(
    direction: &Vector3<f64>,
    surface: &RestSurface,
) -> impl Iterator<Item = (JointGeometry, f64)> {
    let axis = UnitVector3::new_normalize(*direction);
    let (u, v) = orthonormal_basis(&axis);
    let centre = surface.centre();
    let places = |side: Vector3<f64>| {
        let along = surface.points.iter().map(|p| side.dot(&(p - centre)));
        let (low, high) = along.fold((0.0_f64, 0.0_f64), |(l, h), x| (l.min(x), h.max(x)));
        let beyond = BEYOND * (high - low) + BEYOND_M;
        let (low, high) = (low - beyond, high + beyond);
        let step = (high - low) / (GRID - 1) as f64;
        ((0..GRID).map(move |k| low + step * k as f64), step)
    };
    let ((along_u, step_u), (along_v, step_v)) = (places(u), places(v));
    let pairs = along_u.flat_map(move |x| along_v.clone().map(move |y| (x, y)));
    let hinge = move |(x, y)| JointGeometry::hinge(axis, centre + u * x + v * y);
    pairs.map(move |pair| (hinge(pair), step_u.max(step_v)))
}

/// Distance from a hinge's line to the farthest point of its surface, metres, within [`MIN_REACH_M`] and
/// [`MAX_REACH_M`]; 1 for a slide.
pub fn reach(geometry: &JointGeometry, points: &[Point3<f64>]) -> f64 {
    if geometry.kind != JointKind::Revolute {
        return 1.0;
    }
    let distances = points.iter().map(|p| distance_to_line(&geometry.origin, &geometry.axis, p));
    distances.fold(MIN_REACH_M, f64::max).min(MAX_REACH_M)
}

/// Configurations from the smallest to the largest, between which the surface moves by at most `step_m`, and the
/// difference between two of them; radians or metres.
pub fn configurations(
    geometry: &JointGeometry,
    points: &[Point3<f64>],
    step_m: f64,
) -> (Vec<f64>, f64) {
    let is_hinge = geometry.kind == JointKind::Revolute;
    let greatest = if is_hinge { MAX_TURN_RAD } else { MAX_SHIFT_M };
    let n = (greatest / (step_m / reach(geometry, points))).ceil() as i32;
    let step = greatest / f64::from(n);
    ((-n..=n).map(|k| step * f64::from(k)).collect(), step)
}

/// Score of a joint. All configurations are scored in one keyframe before the next one, so that its readings stay in
/// the processor's cache.
fn score(geometry: &JointGeometry, few: &RestSurface, targets: &[&MovingPoints]) -> f64 {
    let (configurations, _) = configurations(geometry, &few.points, STEP_M);
    let motions: Vec<Pose> = configurations.into_iter().map(|q| geometry.motion(q)).collect();
    let best_in = |view: &&MovingPoints| {
        motions.iter().map(|motion| few.margin(view, motion)).fold(-1.0_f64, f64::max)
    };
    targets.iter().map(best_in).sum::<f64>() / targets.len() as f64
}

#[cfg(test)]
mod tests {
    use super::super::rest_surface::{End, vacated_surfaces};
    use super::super::test_data::{PIVOT_M, lever, turn};
    use super::super::view::View;
    use super::*;

    #[test]
    fn the_best_hinge_is_near_the_true_line_and_better_than_a_slide() {
        let recording = lever(turn);
        let views = View::all(&recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let moving = MovingPoints::near(&surface.centre(), 0.6, &views, &|_| Vec::new());
        let directions = [Vector3::z(), Vector3::x()];
        let best = best_hypotheses(surface, &directions, &[], &[], &moving, [3, 1]);
        assert_eq!(best[0].geometry.kind, JointKind::Revolute);
        assert!(best[0].geometry.axis.z.abs() > 0.99);
        let off = distance_to_line(
            &best[0].geometry.origin,
            &best[0].geometry.axis,
            &Point3::from(PIVOT_M),
        );
        assert!(off < 0.06, "{off} m off, on a coarse grid");
        let slide = best.iter().find(|h| h.geometry.kind == JointKind::Prismatic).unwrap();
        assert!(slide.score < 0.7 * best[0].score);
    }

    #[test]
    fn configurations_are_as_far_apart_as_the_surface_may_go() {
        let hinge = JointGeometry::hinge(Vector3::z_axis(), Point3::origin());
        let (q, step) = configurations(&hinge, &[Point3::new(0.3, 0.0, 0.0)], 0.03);
        assert!((step - 0.1).abs() < 1e-9 && q.len() == 51);
        assert_eq!((q[0], q[25], q[50]), (-MAX_TURN_RAD, 0.0, MAX_TURN_RAD));
    }
}
