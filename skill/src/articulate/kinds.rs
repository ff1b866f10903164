//! The joints that are told apart, and how a part moves under each.

use crate::geometry::{Pose, rotation_about};
use nalgebra::{Point3, Translation3, UnitVector3};
use serde::{Deserialize, Serialize};

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
}

impl JointGeometry {
    /// What the joint does to the child when its configuration goes from 0 to `q`.
    pub fn motion(&self, q: f64) -> Pose {
        match self.kind {
            JointKind::Prismatic => {
                Pose::from_parts(Translation3::from(self.axis.into_inner() * q), Default::default())
            }
            JointKind::Revolute => rotation_about(&self.origin, &self.axis, q),
            JointKind::Fixed | JointKind::Helical | JointKind::Nonparametric => Pose::identity(),
        }
    }

    /// The same line seen from another frame.
    pub fn transformed(&self, other_from_this: &Pose) -> Self {
        Self {
            kind: self.kind,
            axis: UnitVector3::new_normalize(other_from_this * self.axis.into_inner()),
            origin: other_from_this * self.origin,
        }
    }
}
