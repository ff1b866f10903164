//! A joint of one degree of freedom, moving points.

use crate::articulate::{JointGeometry, JointKind};
use nalgebra::{Matrix3, Point3, Rotation3, Unit, UnitVector3, Vector3};

/// A slide or a hinge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dof {
    /// True for a hinge.
    pub hinge: bool,
    /// Unit direction.
    pub axis: Vector3<f64>,
    /// A point on the hinge.
    pub origin: Point3<f64>,
}

/// What a joint does to points at one configuration.
#[derive(Debug, Clone, Copy)]
pub struct Moved {
    rotation: Matrix3<f64>,
    shift: Vector3<f64>,
}

impl Moved {
    /// Where a point of the part is.
    pub fn forth(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords + self.shift)
    }

    /// The point of the part that is there.
    pub fn back(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation.tr_mul(&(p.coords - self.shift)))
    }
}

impl Dof {
    /// Rodrigues' rotation of a vector about the axis.
    pub fn turn(&self, q: f64, v: &Vector3<f64>) -> Vector3<f64> {
        let (sin, cos) = q.sin_cos();
        v * cos + self.axis.cross(v) * sin + self.axis * (self.axis.dot(v) * (1.0 - cos))
    }

    /// Where a point of the part is at configuration `q`.
    pub fn move_point(&self, q: f64, p: &Point3<f64>) -> Point3<f64> {
        if self.hinge { self.origin + self.turn(q, &(p - self.origin)) } else { p + self.axis * q }
    }

    /// [`Self::move_point`] for many points at one configuration.
    pub fn at(&self, q: f64) -> Moved {
        if !self.hinge {
            return Moved { rotation: Matrix3::identity(), shift: self.axis * q };
        }
        let axis = Unit::new_unchecked(self.axis);
        let rotation = Rotation3::from_axis_angle(&axis, q).into_inner();
        Moved { rotation, shift: self.origin.coords - rotation * self.origin.coords }
    }

    /// The configuration that takes `part_point` closest to `seen`.
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
        if self.hinge { self.axis.cross(&(moved - self.origin)) } else { self.axis }
    }

    /// Distance of a point from the hinge; 1 for slides, whose configuration is a length.
    pub fn lever(&self, p: &Point3<f64>) -> f64 {
        if self.hinge {
            crate::geometry::distance_to_line(&self.origin, &self.axis, p)
        } else {
            1.0
        }
    }

    /// As the geometry of a model's joint.
    pub fn geometry(&self) -> JointGeometry {
        JointGeometry {
            kind: if self.hinge { JointKind::Revolute } else { JointKind::Prismatic },
            axis: UnitVector3::new_normalize(self.axis),
            origin: self.origin,
        }
    }
}
