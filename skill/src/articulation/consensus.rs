//! Joints through few samples: initial states without outliers (Fischler & Bolles 1981).

use super::pose_sample::PoseSample;
use super::rest_state::State;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::{Point3, UnitQuaternion, UnitVector3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws of samples: with 30 % outliers all of 60 draws of three contain an outlier once in 10^10
/// logs.
const DRAWS: usize = 60;
/// Least angle between two orientations that tell an axis, radians.
const MIN_TURN: f64 = 0.1;

/// Joints of a kind, each through one, two or three samples drawn from all.
pub fn candidates(kind: JointKind, samples: &[PoseSample]) -> Vec<State> {
    if samples.is_empty() {
        return Vec::new();
    }
    let mut random = ChaCha8Rng::seed_from_u64(samples.len() as u64);
    let mut draw = || samples[random.random_range(0..samples.len())];
    (0..DRAWS)
        .flat_map(|_| {
            let (a, b, c) = (draw(), draw(), draw());
            match kind {
                JointKind::Fixed => vec![resting(&a)],
                JointKind::Prismatic => slide(&a, &b).into_iter().collect(),
                JointKind::Revolute => arc(&a, &b, &c).into_iter().chain(turn(&a, &b)).collect(),
                JointKind::Helical | JointKind::Nonparametric => Vec::new(),
            }
        })
        .collect()
}

fn state(geometry: JointGeometry, rest: &PoseSample) -> State {
    State {
        geometry,
        rest_position: rest.position,
        rest_orientation: rest.orientation.unwrap_or_else(UnitQuaternion::identity),
    }
}

fn resting(a: &PoseSample) -> State {
    let axis = Vector3::x_axis();
    state(JointGeometry { kind: JointKind::Fixed, axis, origin: a.position, pitch: 0.0 }, a)
}

fn slide(a: &PoseSample, b: &PoseSample) -> Option<State> {
    let axis = UnitVector3::try_new(b.position - a.position, 1e-6)?;
    Some(state(JointGeometry::slide(axis, a.position), a))
}

/// The circle through three places.
fn arc(a: &PoseSample, b: &PoseSample, c: &PoseSample) -> Option<State> {
    let (u, v) = (b.position - a.position, c.position - a.position);
    let normal = u.cross(&v);
    let axis = UnitVector3::try_new(normal, 1e-9)?;
    let to_centre = (u.norm_squared() * v.cross(&normal) + v.norm_squared() * normal.cross(&u))
        / (2.0 * normal.norm_squared());
    Some(state(JointGeometry::hinge(axis, a.position + to_centre), a))
}

/// The hinge that turns one pose into another.
fn turn(a: &PoseSample, b: &PoseSample) -> Option<State> {
    let turn = b.orientation? * a.orientation?.inverse();
    let (axis, angle) = turn.axis_angle()?;
    if angle < MIN_TURN {
        return None;
    }
    let step = b.position - a.position;
    let across = step - axis.into_inner() * axis.dot(&step);
    let to_centre = across / 2.0 + axis.cross(&across) / (2.0 * (angle / 2.0).tan());
    Some(state(JointGeometry::hinge(axis, Point3::from(a.position + to_centre)), a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hinge_is_told_by_three_places_and_by_two_poses() {
        let hinge = JointGeometry::hinge(Vector3::z_axis(), Point3::new(0.2, -0.3, 0.5));
        let rest = Point3::new(0.7, 0.1, 0.9);
        let at = |q: f64| PoseSample {
            t: q,
            position: hinge.motion(q) * rest,
            orientation: Some(hinge.motion(q).rotation),
        };
        for found in [arc(&at(0.0), &at(0.5), &at(0.9)), turn(&at(0.0), &at(0.7))] {
            let found = found.unwrap();
            assert!((found.geometry.axis.z - 1.0).abs() < 1e-9);
            assert!((found.geometry.origin - hinge.origin).xy().norm() < 1e-9);
        }
        assert!(turn(&at(0.0), &at(0.01)).is_none());
        assert!(slide(&at(0.3), &at(0.3)).is_none());
    }
}
