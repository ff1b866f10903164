//! A joint's line by least squares over all depth pictures at once: the surface of the part is
//! aligned to each keyframe (point to plane), with the line's four unknowns shared by all
//! keyframes and one configuration a keyframe. The configurations are eliminated (Schur
//! complement), as bundle adjustment eliminates points.
//!
//! A plane that turns little hardly tells how far the line lies from it along its normal. There a
//! prior holds: a hinge is within some centimetres of the face of its part.

use super::depth_following::{Following, Surface, residuals};
use super::hinge::Hinge;
use crate::learn::line_step::{line_covariance, moved_line};
use crate::learn::recording::Recording;
use crate::math::rigid::orthonormal_basis;
use crate::object::joint_geometry::JointGeometry;
use nalgebra::{Matrix3x2, Matrix4, Matrix6, Point3, Vector3, Vector4};

/// Gauss-Newton steps.
const STEPS: usize = 6;
/// Standard deviation of a residual, metres.
const RESIDUAL_M: f64 = 0.004;
/// Independent residuals of one keyframe. It has many more, but neighbouring readings of a depth
/// camera share their errors.
const INDEPENDENT: f64 = 8.0;
/// Standard deviation of a hinge's distance from its part's face, metres: parts have a thickness.
const OFFSET_M: f64 = 0.03;
/// Largest standard deviation of the direction that the planes gave, radians.
const PRIOR_RAD: f64 = 0.01;
/// Largest standard deviation of the place that the planes gave, metres.
const PRIOR_M: f64 = 0.05;
/// Residual from which a reading counts no more (Tukey's biweight), metres.
const CUT_M: f64 = 0.02;
/// Step for derivatives, radians or metres.
const DIFFERENCE: f64 = 1e-5;

/// A line that was aligned.
#[derive(Debug, Clone)]
pub struct AlignedLine {
    /// The line.
    pub geometry: JointGeometry,
    /// Covariance of (axis, origin) by residuals and prior, without errors that all readings share.
    pub covariance: Matrix6<f64>,
    /// Root mean square residual, metres.
    pub rmse: f64,
}

/// Aligns a line to the keyframes that show its part, where its planes do not give its place well: a
/// good line gains nothing, for all readings of a keyframe may be of the wrong surface together.
pub fn align_line(
    surface: &Surface,
    from_planes: &Hinge,
    following: &Following,
    recording: &Recording,
) -> AlignedLine {
    let mut geometry = from_planes.geometry();
    let covariance = line_covariance(&geometry, &prior(surface, from_planes, &geometry).left);
    if from_planes.is_well_known() {
        return AlignedLine { geometry, covariance, rmse: from_planes.rmse };
    }
    let mut q: Vec<(usize, f64)> = following.shown().map(|p| (p.frame, p.q)).collect();
    let mut information = Matrix4::identity();
    let mut rmse = 0.0;
    for _ in 0..STEPS {
        let (system, squares, weight) = reduced_system(surface, &geometry, &mut q, recording);
        rmse = (squares / weight.max(1e-9)).sqrt();
        let known = prior(surface, from_planes, &geometry);
        information = system.left + known.left;
        let right = system.right + known.right;
        let Some(step) = information.cholesky().map(|c| c.solve(&right)) else { break };
        geometry = moved_line(&geometry, &step);
        if step.norm() < 1e-6 {
            break;
        }
    }
    let covariance = line_covariance(&geometry, &information);
    AlignedLine { geometry, covariance, rmse }
}

/// Normal equations of the line's four unknowns.
struct LineSystem {
    left: Matrix4<f64>,
    right: Vector4<f64>,
}

/// The normal equations without the configurations, which are brought up to date; then the sum of
/// squared residuals, and of their weights.
fn reduced_system(
    surface: &Surface,
    geometry: &JointGeometry,
    q: &mut [(usize, f64)],
    recording: &Recording,
) -> (LineSystem, f64, f64) {
    let mut all = LineSystem { left: Matrix4::zeros(), right: Vector4::zeros() };
    let (mut squares, mut weights) = (0.0, 0.0);
    let shifted: [JointGeometry; 4] = std::array::from_fn(|k| {
        let mut step = Vector4::zeros();
        step[k] = DIFFERENCE;
        moved_line(geometry, &step)
    });
    for (frame, q) in q {
        let Some((_, picture)) = recording.keyframes.iter().find(|(f, _)| f == frame) else {
            continue;
        };
        let camera_from_base = recording.ego_motion.camera_from_base[*frame];
        let motion = geometry.motion(*q);
        let beside = shifted.each_ref().map(|g| g.motion(*q));
        let (mut left, mut right) = (Matrix4::zeros(), Vector4::zeros());
        let (mut cross, mut own, mut own_right) = (Vector4::zeros(), 0.0, 0.0);
        let mut found = 0.0;
        for r in residuals(surface, &motion, picture, &camera_from_base) {
            let place = motion * r.point;
            let slope = r.normal.dot(&geometry.velocity(&place));
            let slopes =
                Vector4::from_fn(|k, _| r.normal.dot(&(beside[k] * r.point - place)) / DIFFERENCE);
            let w = (1.0 - (r.distance / CUT_M).powi(2)).max(0.0).powi(2);
            left += w * slopes * slopes.transpose();
            right += w * slopes * r.distance;
            cross += w * slopes * slope;
            own += w * slope * slope;
            own_right += w * slope * r.distance;
            squares += w * r.distance * r.distance;
            found += w;
        }
        if own < 1e-9 || found < 1.0 {
            continue;
        }
        *q += own_right / own;
        let weight = INDEPENDENT.min(found) / found / RESIDUAL_M.powi(2);
        all.left += weight * (left - cross * cross.transpose() / own);
        all.right += weight * (right - cross * own_right / own);
        weights += found;
    }
    (all, squares, weights)
}

/// What is known without these residuals: the line that the planes gave, with its standard deviations,
/// and that a hinge lies near the face of its part.
fn prior(surface: &Surface, from_planes: &Hinge, now: &JointGeometry) -> LineSystem {
    let (u, v) = orthonormal_basis(&now.axis);
    let n = surface.points.len().max(1) as f64;
    let mean = Point3::from(surface.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
    let mut all = LineSystem { left: Matrix4::zeros(), right: Vector4::zeros() };
    let mut add = |slopes: Vector4<f64>, off: f64, sigma: f64| {
        all.left += slopes * slopes.transpose() / sigma.powi(2);
        all.right -= slopes * off / sigma.powi(2);
    };
    let turned = now.axis.into_inner() - from_planes.axis;
    let shifted = now.origin - from_planes.origin;
    for (k, side) in [u, v].iter().enumerate() {
        let unit = |k: usize| Vector4::from_fn(|i, _| f64::from(u8::from(i == k)));
        add(unit(k), side.dot(&turned), from_planes.direction_sigma(side).min(PRIOR_RAD));
        add(unit(k + 2), side.dot(&shifted), PRIOR_M);
    }
    let across = Vector4::new(0.0, 0.0, surface.normal.dot(&u), surface.normal.dot(&v));
    add(across, surface.normal.dot(&(now.origin - mean)), OFFSET_M);
    let sides = Matrix3x2::from_columns(&[u, v]);
    let information = sides.transpose() * from_planes.place_information;
    let mut place = all.left.fixed_view_mut::<2, 2>(2, 2);
    place += information * sides;
    let mut right = all.right.fixed_rows_mut::<2>(2);
    right -= information * shifted;
    all
}

/// The largest standard deviation of a line's place, metres.
pub fn largest_place_sigma(covariance: &Matrix6<f64>) -> f64 {
    let place = covariance.fixed_view::<3, 3>(3, 3).into_owned();
    place.symmetric_eigenvalues().max().max(0.0).sqrt()
}
