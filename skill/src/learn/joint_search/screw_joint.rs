//! A joint of one degree of freedom, moving points.

use crate::object::joint_geometry::JointGeometry;
use nalgebra::{Matrix3, Point3, Rotation3, Unit, UnitVector3, Vector3};
use std::f64::consts::TAU;

/// A slide, a hinge or a screw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScrewJoint {
    /// True for what turns.
    pub hinge: bool,
    /// Unit direction.
    pub axis: Vector3<f64>,
    /// A point on the hinge.
    pub origin: Point3<f64>,
    /// What a screw advances, metres a radian; `None` where nothing advances as it turns.
    pub pitch: Option<f64>,
}

/// What a joint does to points at one configuration.
#[derive(Debug, Clone, Copy)]
pub struct ScrewMotion {
    pub(super) rotation: Matrix3<f64>,
    pub(super) shift: Vector3<f64>,
}

impl ScrewMotion {
    /// Where a point of the part is.
    pub fn transform(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords + self.shift)
    }

    /// The point of the part that is there.
    pub fn inverse_transform(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation.tr_mul(&(p.coords - self.shift)))
    }
}

impl ScrewJoint {
    /// A slide.
    pub fn slide(axis: Vector3<f64>, origin: Point3<f64>) -> Self {
        Self { hinge: false, axis, origin, pitch: None }
    }

    /// A hinge.
    pub fn hinge(axis: Vector3<f64>, origin: Point3<f64>) -> Self {
        Self { hinge: true, axis, origin, pitch: None }
    }

    /// How far a turn by `q` takes the part along the axis.
    pub fn advance(&self, q: f64) -> Vector3<f64> {
        self.axis * (self.pitch.unwrap_or(0.0) * q)
    }

    /// Rodrigues' rotation of a vector about the axis.
    pub fn turn(&self, q: f64, v: &Vector3<f64>) -> Vector3<f64> {
        let (sin, cos) = q.sin_cos();
        v * cos + self.axis.cross(v) * sin + self.axis * (self.axis.dot(v) * (1.0 - cos))
    }

    /// Where a point of the part is at configuration `q`.
    pub fn move_point(&self, q: f64, p: &Point3<f64>) -> Point3<f64> {
        if !self.hinge {
            return p + self.axis * q;
        }
        self.origin + self.turn(q, &(p - self.origin)) + self.advance(q)
    }

    /// [`Self::move_point`] for many points at one configuration.
    pub fn at(&self, q: f64) -> ScrewMotion {
        if !self.hinge {
            return ScrewMotion { rotation: Matrix3::identity(), shift: self.axis * q };
        }
        let axis = Unit::new_unchecked(self.axis);
        let rotation = Rotation3::from_axis_angle(&axis, q).into_inner();
        let shift = self.origin.coords - rotation * self.origin.coords + self.advance(q);
        ScrewMotion { rotation, shift }
    }

    /// The configuration that takes `part_point` closest to `seen`; of a screw that which turns
    /// it there.
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

    /// Velocity of a moved point with the configuration.
    pub fn velocity(&self, moved: &Point3<f64>) -> Vector3<f64> {
        if !self.hinge {
            return self.axis;
        }
        self.axis.cross(&(moved - self.origin)) + self.advance(1.0)
    }

    /// Distance of a point from the hinge; 1 for slides, whose configuration is a length.
    pub fn lever(&self, p: &Point3<f64>) -> f64 {
        if self.hinge {
            crate::math::rigid::distance_to_line(&self.origin, &self.axis, p)
        } else {
            1.0
        }
    }

    /// As the geometry of a model's joint.
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
