//! What a joint is fitted to: one observed pose of a part relative to another.

use crate::math::rigid::Pose;
use nalgebra::{Point3, UnitQuaternion};

/// One observation of a part relative to another (or of a marker).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSample {
    /// Seconds, or the sample's number where a log has no times.
    pub t: f64,
    /// Where the part's origin is, in the parent's frame, metres.
    pub position: Point3<f64>,
    /// How it is turned; `None` where that was not observed.
    pub orientation: Option<UnitQuaternion<f64>>,
}

impl PoseSample {
    /// A sample of a full pose, `parent_from_child`.
    pub fn from_pose(t: f64, parent_from_child: &Pose) -> Self {
        Self {
            t,
            position: Point3::from(parent_from_child.translation.vector),
            orientation: Some(parent_from_child.rotation),
        }
    }
}
