//! Articulation learning (paper, section III-D, after Sturm et al. 2011): which joint
//! explains how one part moves relative to another, and which tree of joints explains all.
//!
//! [`fit_models`] fits rigid, prismatic and revolute joints with an outlier component and
//! ranks them by BIC; [`spanning_tree`] keeps the links of least BIC.

mod circle;
mod columns;
mod consensus;
mod fit;
mod lost_poses;
mod pose_log;
mod spanning_tree;
mod table;

pub use columns::{Columns, KNOWN_NAMES, TimeColumn};
pub use fit::{FitError, FittedJoint, fit_models, type_probabilities};

pub use pose_log::{LostLine, PoseLog, PoseLogError, parse_pose_log, read_pose_log};
pub use spanning_tree::{Link, spanning_tree};

use crate::math::rigid::Pose;
use nalgebra::{Point3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// Values of the articulation stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArticulateConfig {
    /// Standard deviation of an observed position about an ideal joint, metres: marker noise
    /// together with the play and bend of real hinges and slides. Ours.
    pub position_sigma_m: f64,
    /// Standard deviation of an observed orientation, radians.
    pub orientation_sigma_rad: f64,
    /// Median distance between a hinge and what it carries, metres: hinges that nobody
    /// builds are unlikely. Ours: in real logs 0.25-0.68 m.
    pub hinge_radius_m: f64,
    /// Standard deviation of its logarithm; larger radii are penalised, smaller ones not.
    pub hinge_radius_log_sigma: f64,
    /// EM iterations that separate outliers.
    pub iterations: usize,
}

impl Default for ArticulateConfig {
    fn default() -> Self {
        Self {
            position_sigma_m: 0.008,
            orientation_sigma_rad: 0.08,
            hinge_radius_m: 0.45,
            hinge_radius_log_sigma: 0.5,
            iterations: 12,
        }
    }
}

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
