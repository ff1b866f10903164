//! The joints that are told apart, and how a part moves under each.

use crate::math::rigid::{Pose, rotation_about};
use nalgebra::{Point3, Translation3, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Kind of a joint, named as in the JSON contract.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JointKind {
    /// No motion: the two are one part.
    Fixed,
    /// A slide; configuration in metres.
    Prismatic,
    /// A hinge; configuration in radians.
    Revolute,
    /// A screw; configuration in radians, `pitch` metres a turn.
    Helical,
    /// A motion without parameters.
    Nonparametric,
}

impl JointKind {
    /// The name used in JSON and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Prismatic => "prismatic",
            Self::Revolute => "revolute",
            Self::Helical => "helical",
            Self::Nonparametric => "nonparametric",
        }
    }

    /// Unit of its configuration.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Revolute | Self::Helical => "rad",
            _ => "m",
        }
    }
}

/// A joint's line in some frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointGeometry {
    /// Which joint.
    pub kind: JointKind,
    /// Direction of the slide, or of the hinge (right-handed with the configuration).
    pub axis: UnitVector3<f64>,
    /// A point on the hinge; for slides any point of the part.
    pub origin: Point3<f64>,
    /// Metres a turn, for screws; else 0.
    pub pitch: f64,
}

impl JointGeometry {
    /// A slide along `axis`.
    pub fn slide(axis: UnitVector3<f64>, origin: Point3<f64>) -> Self {
        Self { kind: JointKind::Prismatic, axis, origin, pitch: 0.0 }
    }

    /// A hinge about the line through `origin` along `axis`.
    pub fn hinge(axis: UnitVector3<f64>, origin: Point3<f64>) -> Self {
        Self { kind: JointKind::Revolute, axis, origin, pitch: 0.0 }
    }

    /// A screw about that line, which advances `pitch` metres a turn.
    pub fn screw(axis: UnitVector3<f64>, origin: Point3<f64>, pitch: f64) -> Self {
        Self { kind: JointKind::Helical, axis, origin, pitch }
    }

    /// How far a screw has gone along its axis at `q` radians, metres.
    fn advance(&self, q: f64) -> Vector3<f64> {
        self.axis.into_inner() * (self.pitch * q / TAU)
    }

    /// Velocity with the configuration of a point that the joint has moved.
    pub fn velocity(&self, moved: &Point3<f64>) -> Vector3<f64> {
        let turning = || self.axis.cross(&(moved - self.origin));
        match self.kind {
            JointKind::Prismatic => self.axis.into_inner(),
            JointKind::Revolute => turning(),
            JointKind::Helical => turning() + self.advance(1.0),
            JointKind::Fixed | JointKind::Nonparametric => Vector3::zeros(),
        }
    }

    /// What the joint does to the child when its configuration goes from 0 to `q`.
    pub fn motion(&self, q: f64) -> Pose {
        match self.kind {
            JointKind::Prismatic => {
                Pose::from_parts(Translation3::from(self.axis.into_inner() * q), Default::default())
            }
            JointKind::Revolute => rotation_about(&self.origin, &self.axis, q),
            JointKind::Helical => {
                let advance = Translation3::from(self.advance(q));
                advance * rotation_about(&self.origin, &self.axis, q)
            }
            JointKind::Fixed | JointKind::Nonparametric => Pose::identity(),
        }
    }

    /// The same line seen from another frame.
    pub fn transformed(&self, other_from_this: &Pose) -> Self {
        Self {
            axis: UnitVector3::new_normalize(other_from_this * self.axis.into_inner()),
            origin: other_from_this * self.origin,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: &Point3<f64>, b: [f64; 3]) -> bool {
        (a - Point3::from(b)).norm() < 1e-12
    }

    #[test]
    fn a_slide_moves_every_point_along_its_axis() {
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::new(5.0, 5.0, 5.0));
        assert!(near(&(slide.motion(0.3) * Point3::new(1.0, 2.0, 3.0)), [1.3, 2.0, 3.0]));
        assert_eq!(slide.kind.unit(), "m");
    }

    #[test]
    fn a_hinge_turns_about_its_line_and_leaves_it_in_place() {
        let hinge = JointGeometry::hinge(Vector3::z_axis(), Point3::new(1.0, 0.0, 0.0));
        let quarter = hinge.motion(TAU / 4.0);
        assert!(near(&(quarter * Point3::new(2.0, 0.0, 0.5)), [1.0, 1.0, 0.5]));
        assert!(near(&(quarter * Point3::new(1.0, 0.0, 7.0)), [1.0, 0.0, 7.0]));
    }

    #[test]
    fn a_screw_advances_by_its_pitch_in_a_turn() {
        let screw = JointGeometry::screw(Vector3::y_axis(), Point3::origin(), 0.02);
        assert!(near(&(screw.motion(TAU) * Point3::new(0.3, 0.0, 0.0)), [0.3, 0.02, 0.0]));
    }

    #[test]
    fn velocity_is_the_derivative_of_the_motion() {
        let (axis, origin) = (Vector3::y_axis(), Point3::new(0.2, 0.0, 0.1));
        for joint in [
            JointGeometry::slide(axis, origin),
            JointGeometry::hinge(axis, origin),
            JointGeometry::screw(axis, origin, 0.05),
        ] {
            let (q, h, p) = (0.4, 1e-6, Point3::new(0.5, 0.3, -0.2));
            let numeric = (joint.motion(q + h) * p - joint.motion(q - h) * p) / (2.0 * h);
            let told = joint.velocity(&(joint.motion(q) * p));
            assert!((numeric - told).norm() < 1e-8, "{}: {numeric} {told}", joint.kind.name());
        }
    }

    #[test]
    fn a_line_seen_from_another_frame_moves_points_alike() {
        let hinge = JointGeometry::hinge(Vector3::z_axis(), Point3::new(1.0, 0.0, 0.0));
        let other_from_this = Pose::new(Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.0, 0.7, 0.1));
        let p = Point3::new(0.4, 0.5, 0.6);
        let there = hinge.transformed(&other_from_this).motion(0.8) * (other_from_this * p);
        assert!((there - other_from_this * (hinge.motion(0.8) * p)).norm() < 1e-12);
    }
}
