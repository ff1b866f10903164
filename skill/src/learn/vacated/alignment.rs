//! Aligns a joint's line and its configurations to all keyframes at once. Each point of the surface that faces the
//! camera is paired with the nearest moving reading.
//!
//! In: a surface at rest, a joint, its configuration in each keyframe, and the moving readings; base frame, metres
//! and radians.
//! Out: the line with the information of its four unknowns, and the configurations.
//! From: point-to-point ICP by Gauss-Newton; the configurations are eliminated (Schur complement), as bundle
//! adjustment eliminates points.

use super::moving_points::{MAX_DISTANCE_M, MovingPoints};
use super::rest_surface::RestSurface;
use crate::learn::line_step::moved_line;
use crate::math::rigid::{nearest_on_line, orthonormal_basis};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::{Matrix3x4, Matrix4, Point3, Vector3, Vector4};

/// Most Gauss-Newton steps.
const STEPS: usize = 8;
/// Fewest pairs of a keyframe that counts, as a share of the surface's points.
const MIN_PAIRS: f64 = 0.1;
/// Step of numerical derivatives, radians or metres.
const DIFFERENCE: f64 = 1e-5;
/// Largest change of a configuration in a step, radians or metres.
const MAX_CHANGE: f64 = 0.1;
/// Error that all pairs of a keyframe share, metres: a hand on the part counts as the part's surface.
const SHARED_M: f64 = 0.004;
/// Largest number of independent keyframes: a hand keeps its grip.
const INDEPENDENT: f64 = 8.0;
/// Standard deviation of a step of a hinge's place, metres: damps what the images do not determine.
const PLACE_M: f64 = 0.5;
/// Standard deviation of the place of a line that is that of a known joint, metres.
const KNOWN_PLACE_M: f64 = 0.01;
/// Standard deviation of a step of a slide's place, metres: a slide has no place, so that it must not move.
const NO_PLACE_M: f64 = 1e-6;

/// A line that was aligned to all keyframes.
#[derive(Clone)]
pub struct Aligned {
    /// The aligned line, base frame.
    pub geometry: JointGeometry,
    /// One configuration per keyframe, radians or metres.
    pub q: Vec<f64>,
    /// Information of the line's four unknowns.
    pub information: Matrix4<f64>,
}

/// What is known of a line before the alignment; base frame.
#[derive(Debug, Clone, Copy)]
pub struct LinePrior {
    /// Unit vector along the line.
    pub direction: Vector3<f64>,
    /// Standard deviation of the direction, radians.
    pub direction_sigma: f64,
    /// A point on the line, if one is known to within [`KNOWN_PLACE_M`].
    pub place: Option<Point3<f64>>,
}

/// Aligns a joint to all keyframes, starting from the configurations `q`, one per keyframe.
pub fn align(
    surface: &RestSurface,
    geometry: &JointGeometry,
    q: &[f64],
    expected: &LinePrior,
    moving: &[MovingPoints],
) -> Aligned {
    let mut line = *geometry;
    line.origin = nearest_on_line(&line.origin, &line.axis, &surface.centre());
    let mut q = q.to_vec();
    let mut information = Matrix4::identity();
    for _ in 0..STEPS {
        let keyframes: Vec<(usize, Normal)> = moving
            .iter()
            .enumerate()
            .filter_map(|(k, view)| Some((k, normal_equations(surface, &line, q[k], view)?)))
            .collect();
        let scale = INDEPENDENT.min(keyframes.len() as f64) / keyframes.len().max(1) as f64;
        let (mut left, mut right) = prior(&line, expected);
        for (_, n) in &keyframes {
            left += scale * (n.left - n.cross * n.cross.transpose() / n.own);
            right += scale * (n.right - n.cross * (n.own_right / n.own));
        }
        information = left;
        let Some(step) = left.cholesky().map(|c| c.solve(&right)) else { break };
        for (k, n) in &keyframes {
            let change = (n.own_right - n.cross.dot(&step)) / n.own;
            q[*k] += change.clamp(-MAX_CHANGE, MAX_CHANGE);
        }
        line = moved_line(&line, &step);
        line.origin = nearest_on_line(&line.origin, &line.axis, &surface.centre());
        if step.norm() < 1e-5 {
            break;
        }
    }
    Aligned { geometry: line, q, information }
}

/// Normal equations of one keyframe, for the unknowns of the line and the keyframe's configuration.
struct Normal {
    left: Matrix4<f64>,
    right: Vector4<f64>,
    cross: Vector4<f64>,
    own: f64,
    own_right: f64,
}

/// Normal equations of a keyframe; `None` if it has too few pairs.
fn normal_equations(
    surface: &RestSurface,
    line: &JointGeometry,
    q: f64,
    view: &MovingPoints,
) -> Option<Normal> {
    let motion = line.motion(q);
    let beside: [_; 4] = std::array::from_fn(|k| {
        let mut step = Vector4::zeros();
        step[k] = DIFFERENCE;
        moved_line(line, &step).motion(q)
    });
    let mut all = Normal {
        left: Matrix4::zeros(),
        right: Vector4::zeros(),
        cross: Vector4::zeros(),
        own: 0.0,
        own_right: 0.0,
    };
    let (mut pairs, mut weights) = (0, 0.0);
    for (point, normal) in surface.places() {
        let place = motion * point;
        let Some(reading) = view.nearest(&place, &(motion * normal)) else { continue };
        let off = reading - place;
        let w = (1.0 - off.norm_squared() / MAX_DISTANCE_M.powi(2)).max(0.0).powi(2);
        let slopes =
            Matrix3x4::from_columns(&beside.each_ref().map(|m| (m * point - place) / DIFFERENCE));
        let own = line.velocity(&place);
        all.left += w * slopes.transpose() * slopes;
        all.right += w * slopes.transpose() * off;
        all.cross += w * slopes.transpose() * own;
        all.own += w * own.norm_squared();
        all.own_right += w * own.dot(&off);
        pairs += 1;
        weights += w;
    }
    if (pairs as f64) < MIN_PAIRS * surface.points.len() as f64 || all.own < 1e-6 {
        return None;
    }
    // All pairs of a keyframe count as one measurement, because they share the error of what is taken for the
    // surface.
    let scale = 1.0 / (weights * SHARED_M.powi(2));
    all.left *= scale;
    all.right *= scale;
    all.cross *= scale;
    all.own *= scale;
    all.own_right *= scale;
    Some(all)
}

/// Normal equations of the prior, with the damping of the line's place.
fn prior(line: &JointGeometry, expected: &LinePrior) -> (Matrix4<f64>, Vector4<f64>) {
    let sense = if expected.direction.dot(&line.axis) < 0.0 { -1.0 } else { 1.0 };
    let turned = sense * expected.direction - line.axis.into_inner();
    let shifted = expected.place.map_or(Vector3::zeros(), |place| place - line.origin);
    let place_m = match (line.kind, expected.place) {
        (JointKind::Revolute, Some(_)) => KNOWN_PLACE_M,
        (JointKind::Revolute, None) => PLACE_M,
        _ => NO_PLACE_M,
    };
    let (u, v) = orthonormal_basis(&line.axis);
    let of_direction = 1.0 / expected.direction_sigma.powi(2);
    let of_place = 1.0 / place_m.powi(2);
    let left =
        Matrix4::from_diagonal(&Vector4::new(of_direction, of_direction, of_place, of_place));
    let right = Vector4::new(u.dot(&turned), v.dot(&turned), u.dot(&shifted), v.dot(&shifted));
    (left, left * right)
}

#[cfg(test)]
mod tests {
    use super::super::moving_points::MovingPoints;
    use super::super::rest_surface::{End, vacated_surfaces};
    use super::super::test_data::{FRAMES, PIVOT_M, hinge, lever, turn};
    use super::super::view::View;
    use super::*;
    use crate::math::rigid::{distance_to_line, line_angle};

    #[test]
    fn a_line_beside_the_true_one_is_corrected() {
        let recording = lever(turn);
        let views = View::all(&recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let moving = MovingPoints::near(&surface.centre(), 0.6, &views, &|_| Vec::new());
        let off = moved_line(&hinge(), &Vector4::new(0.03, -0.02, 0.015, -0.01));
        let q: Vec<f64> = (0..FRAMES).map(|frame| turn(frame) - 0.05).collect();
        let expected = LinePrior { direction: Vector3::z(), direction_sigma: 0.3, place: None };
        let aligned = align(surface, &off, &q, &expected, &moving);
        let line = aligned.geometry;
        assert!(line_angle(&line.axis, &Vector3::z()) < 0.02);
        let apart = distance_to_line(&line.origin, &line.axis, &Point3::from(PIVOT_M));
        // A reading is 9 mm from the next one in these pictures.
        assert!(apart < 0.012, "{apart} m off");
        assert!((aligned.q[FRAMES - 1] - turn(FRAMES - 1)).abs() < 0.03);
        assert!(aligned.information.cholesky().is_some());
    }
}
