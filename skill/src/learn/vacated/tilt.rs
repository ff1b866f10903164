//! Measures how far readings are turned against the place where a joint puts a surface. A front that slides keeps
//! its direction; one that turns about a line beside it does not. Distances of single points hardly distinguish the
//! two while the motion is short, but all points together do.
//!
//! In: a surface at rest, its motion, and the moving readings of a keyframe; base frame, metres.
//! Out: an angle, radians.
//! From: one step of ICP, point to plane (Chen and Medioni).

use super::moving_points::MovingPoints;
use super::rest_surface::RestSurface;
use crate::math::rigid::Pose;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Smallest share of the surface's points that must have a reading.
const LEAST_PAIRS: f64 = 0.3;
/// Damping of the rotation about the mean normal, and of the shift, as a share of what all pairs together determine: a
/// rotation about the normal of a flat surface is not determined, and counts as none. A rotation about the length of a
/// narrow strip is not damped: noise makes it large, so that nothing is concluded.
const DAMPING: f64 = 0.02;

/// Angle of the small rotation that, together with a small shift, brings a surface, where a motion puts it, to a
/// keyframe's readings there, radians; `None` if few readings are there.
pub fn tilt(surface: &RestSurface, motion: &Pose, view: &MovingPoints) -> Option<f64> {
    let centre = surface.centre();
    let back = motion.inverse();
    let (mut left, mut right) = (Matrix6::zeros(), Vector6::zeros());
    let (mut pairs, mut spread, mut normals) = (0.0, 0.0, Vector3::zeros());
    for (point, normal) in surface.points.iter().zip(&surface.normals) {
        let Some(reading) = view.nearest(&(motion * point), &(motion * normal)) else { continue };
        let arm: Vector3<f64> = point - centre;
        let turned = arm.cross(normal);
        let row = Vector6::new(turned.x, turned.y, turned.z, normal.x, normal.y, normal.z);
        left += row * row.transpose();
        right += row * normal.dot(&(back * reading - point));
        pairs += 1.0;
        spread += arm.norm_squared();
        normals += normal;
    }
    if pairs < LEAST_PAIRS * surface.points.len() as f64 {
        return None;
    }
    let mean = normals.try_normalize(1e-9)?;
    let mut rotation = left.fixed_view_mut::<3, 3>(0, 0);
    rotation += DAMPING * spread / 3.0 * mean * mean.transpose();
    let mut shift = left.fixed_view_mut::<3, 3>(3, 3);
    shift += Matrix3::from_diagonal_element(DAMPING * pairs);
    let step = left.cholesky()?.solve(&right);
    Some(step.fixed_rows::<3>(0).norm())
}

#[cfg(test)]
mod tests {
    use super::super::rest_surface::{End, vacated_surfaces};
    use super::super::test_data::{drawer, flap};
    use super::super::view::View;
    use super::*;
    use crate::learn::recording::Recording;
    use nalgebra::{Translation3, UnitQuaternion};

    /// Frame in which the part has moved a little.
    const MOVED: usize = 10;

    /// The tilt of the part's surface in frame [`MOVED`], for a motion.
    fn tilt_after(recording: &Recording, motion: &Pose) -> Option<f64> {
        let views = View::all(recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let moving = MovingPoints::near(&surface.centre(), 0.8, &views, &|_| Vec::new());
        let view = moving.iter().find(|view| view.frame() == MOVED).expect("a keyframe");
        tilt(surface, motion, view)
    }

    #[test]
    fn a_flap_that_has_turned_a_little_is_tilted_against_a_slide() {
        const TURN_RAD: f64 = 0.1;
        let turn = |frame: usize| match frame {
            0..8 => 0.0,
            8..14 => TURN_RAD,
            _ => 1.2,
        };
        // The middle of the flap is 12.5 cm above its foot, and comes so far towards the camera.
        let slide = Translation3::new(0.0, 0.0, -0.125 * TURN_RAD);
        let slide = Pose::from_parts(slide, UnitQuaternion::identity());
        let tilt = tilt_after(&flap(turn), &slide).expect("most points have readings");
        assert!((tilt - TURN_RAD).abs() < 0.02, "{tilt}");
    }

    #[test]
    fn a_front_that_has_slid_is_not_tilted_and_elsewhere_nothing_is_told() {
        let way = |frame: usize| match frame {
            0..8 => 0.0,
            8..14 => 0.1,
            _ => 0.3,
        };
        let recording = drawer(way, 0.3);
        let by = |way: f64| {
            let shift = Translation3::new(0.0, 0.0, -way);
            tilt_after(&recording, &Pose::from_parts(shift, UnitQuaternion::identity()))
        };
        assert!(by(0.1).is_some_and(|tilt| tilt < 0.01), "{:?}", by(0.1));
        assert_eq!(by(0.3), None);
    }
}
