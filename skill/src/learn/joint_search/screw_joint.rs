//! A slide, a hinge or a screw, and its action on points. Lines and points are in the frame of the
//! joint's parent, metres; configurations are in radians (hinge, screw) or metres (slide).
//!
//! From: screw motion with Rodrigues' rotation formula.

use crate::object::joint_geometry::JointGeometry;
use nalgebra::{Matrix3, Point3, Rotation3, Unit, UnitVector3, Vector3};
use std::f64::consts::TAU;

/// A joint of one degree of freedom: a slide, a hinge or a screw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScrewJoint {
    /// True for a hinge and a screw, false for a slide.
    pub hinge: bool,
    /// Unit direction of the line.
    pub axis: Vector3<f64>,
    /// A point on the line, metres; the motion of a slide does not depend on it.
    pub origin: Point3<f64>,
    /// Advance of a screw along its axis, metres per radian; `None` for a hinge and a slide.
    pub pitch: Option<f64>,
}

/// Rigid motion of a joint's part at one configuration.
#[derive(Debug, Clone, Copy)]
pub struct ScrewMotion {
    pub(super) rotation: Matrix3<f64>,
    pub(super) shift: Vector3<f64>,
}

impl ScrewMotion {
    /// Place of a point of the part after the motion.
    pub fn transform(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords + self.shift)
    }

    /// Point of the part that the motion takes to `p`.
    pub fn inverse_transform(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation.tr_mul(&(p.coords - self.shift)))
    }
}

impl ScrewJoint {
    /// A slide along `axis`, a unit vector.
    pub fn slide(axis: Vector3<f64>, origin: Point3<f64>) -> Self {
        Self { hinge: false, axis, origin, pitch: None }
    }

    /// A hinge about the line through `origin` along `axis`, a unit vector.
    pub fn hinge(axis: Vector3<f64>, origin: Point3<f64>) -> Self {
        Self { hinge: true, axis, origin, pitch: None }
    }

    /// Translation of the part along the axis for a turn by `q` radians, metres; zero without a
    /// pitch.
    pub fn advance(&self, q: f64) -> Vector3<f64> {
        self.axis * (self.pitch.unwrap_or(0.0) * q)
    }

    /// Rodrigues' rotation of a vector about the axis by `q` radians.
    pub fn turn(&self, q: f64, v: &Vector3<f64>) -> Vector3<f64> {
        let (sin, cos) = q.sin_cos();
        v * cos + self.axis.cross(v) * sin + self.axis * (self.axis.dot(v) * (1.0 - cos))
    }

    /// Place of the part's point `p` at configuration `q`.
    pub fn move_point(&self, q: f64, p: &Point3<f64>) -> Point3<f64> {
        if !self.hinge {
            return p + self.axis * q;
        }
        self.origin + self.turn(q, &(p - self.origin)) + self.advance(q)
    }

    /// Motion of the part at configuration `q`: [`Self::move_point`] for many points.
    pub fn at(&self, q: f64) -> ScrewMotion {
        if !self.hinge {
            return ScrewMotion { rotation: Matrix3::identity(), shift: self.axis * q };
        }
        let axis = Unit::new_unchecked(self.axis);
        let rotation = Rotation3::from_axis_angle(&axis, q).into_inner();
        let shift = self.origin.coords - rotation * self.origin.coords + self.advance(q);
        ScrewMotion { rotation, shift }
    }

    /// Configuration that takes `part_point` closest to `seen`. For a screw only the rotation is
    /// used, not the advance.
    pub fn configuration(&self, part_point: &Point3<f64>, seen: &Point3<f64>) -> f64 {
        if !self.hinge {
            return self.axis.dot(&(seen - part_point));
        }
        let u = part_point - self.origin;
        let v = seen - self.origin;
        let cos = u.dot(&v) - self.axis.dot(&u) * self.axis.dot(&v);
        let sin = self.axis.cross(&u).dot(&v);
        sin.atan2(cos)
    }

    /// Derivative of a moved point with respect to the configuration.
    pub fn velocity(&self, moved: &Point3<f64>) -> Vector3<f64> {
        if !self.hinge {
            return self.axis;
        }
        self.axis.cross(&(moved - self.origin)) + self.advance(1.0)
    }

    /// Distance of a point from the axis, metres; 1 for slides, whose configuration is a length.
    pub fn lever(&self, p: &Point3<f64>) -> f64 {
        if self.hinge {
            crate::math::rigid::distance_to_line(&self.origin, &self.axis, p)
        } else {
            1.0
        }
    }

    /// The joint as the geometry of an object model, with a screw's pitch in metres per turn.
    pub fn geometry(&self) -> JointGeometry {
        let axis = UnitVector3::new_normalize(self.axis);
        match (self.hinge, self.pitch) {
            (false, _) => JointGeometry::slide(axis, self.origin),
            (true, None) => JointGeometry::hinge(axis, self.origin),
            (true, Some(pitch)) => JointGeometry::screw(axis, self.origin, pitch * TAU),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn points_go_back_where_they_came_from_and_at_their_velocity(
            hinge: bool,
            axis in prop::array::uniform3(-1.0..1.0_f64),
            origin in prop::array::uniform3(-1.0..1.0_f64),
            pitch in prop::option::of(-0.1..0.1_f64),
            point in prop::array::uniform3(-1.0..1.0_f64),
            q in -3.0..3.0_f64,
        ) {
            prop_assume!(Vector3::from(axis).norm() > 0.1);
            let axis = Vector3::from(axis).normalize();
            let (origin, point) = (Point3::from(origin), Point3::from(point));
            let dof = ScrewJoint { hinge, axis, origin, pitch };
            let moved = dof.move_point(q, &point);
            prop_assert!((dof.move_point(-q, &moved) - point).norm() < 1e-12);
            prop_assert!((dof.at(q).transform(&point) - moved).norm() < 1e-12);
            prop_assert!((dof.at(q).inverse_transform(&moved) - point).norm() < 1e-12);
            let geometry = dof.geometry();
            prop_assert!((geometry.motion(q) * point - moved).norm() < 1e-12);
            let step = (dof.move_point(q + 1e-6, &point) - moved) / 1e-6;
            prop_assert!((dof.velocity(&moved) - step).norm() < 1e-5);
            prop_assert!((geometry.velocity(&moved) - step).norm() < 1e-5);
        }
    }
}
