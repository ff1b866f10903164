//! The unknowns of a joint that is fitted, in the frame of its parent, metres and radians.

use crate::object::joint_geometry::JointGeometry;
use nalgebra::{Point3, UnitQuaternion};

/// Parameters of a joint while it is fitted.
#[derive(Debug, Clone, Copy)]
pub struct State {
    /// Its line.
    pub geometry: JointGeometry,
    /// Position of the part at configuration 0.
    pub rest_position: Point3<f64>,
    /// Orientation of the part at configuration 0.
    pub rest_orientation: UnitQuaternion<f64>,
}
