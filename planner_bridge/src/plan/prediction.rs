//! What is published of a plan: the recognition, each joint's trajectory, and where the moving parts
//! are along it. Its JSON form is `linkage.prediction/1`.
//!
//! Times are seconds from the beginning of the motion, configurations radians or metres, poses
//! `camera_from_object` and `camera_from_part` as x, y, z in metres and a quaternion x, y, z, w.

use linkage_skill::internals;
use linkage_skill::recognise::JointState;
use serde::{Deserialize, Serialize};

/// Name and version of the JSON form.
pub const PREDICTION_SCHEMA: &str = "linkage.prediction/1";

/// A joint as recognised, with its planned motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedJoint {
    /// As recognised.
    #[serde(flatten)]
    pub state: JointState,
    /// `[t, q, qd, qdd]`; empty for a joint that stays as it is.
    pub trajectory: Vec<[f64; 4]>,
}

/// Where a part goes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedPart {
    /// Number of the part.
    pub part: usize,
    /// Its name.
    pub name: String,
    /// `[t, x, y, z, qx, qy, qz, qw]`: camera_from_part; part axes are the object's at
    /// configuration 0.
    pub poses: Vec<[f64; 8]>,
}

/// `linkage.prediction/1`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// [`PREDICTION_SCHEMA`].
    pub schema: String,
    /// The object.
    pub object: String,
    /// Score of the recognition.
    pub score: f64,
    /// Its inliers.
    pub inliers: usize,
    /// Pose of the object frame.
    pub camera_from_object: [f64; 7],
    /// As in [`linkage_skill::recognise::Recognised`].
    #[serde(default = "internals::yes", skip_serializing_if = "internals::is_yes")]
    pub base_known: bool,
    /// Its joints.
    pub joints: Vec<PlannedJoint>,
    /// Its parts that move.
    pub parts: Vec<PlannedPart>,
    /// What a gripper holds on parts that move, with the parts' axes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub handles: Vec<PlannedPart>,
}
