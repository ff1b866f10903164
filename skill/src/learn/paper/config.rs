//! Configuration of the paper's method.

use super::pose_optimisation::PoseConfig;
use super::segmentation::SegmentConfig;
use crate::articulation::ArticulateConfig;
use serde::{Deserialize, Serialize};

/// What each stage of the paper's method is configured with.
#[derive(Debug, Clone, Copy)]
pub struct PaperSettings<'c> {
    /// Motion segmentation, III-B.
    pub segment: &'c SegmentConfig,
    /// Pose optimisation, III-C.
    pub pose: &'c PoseConfig,
    /// Joint models, III-D.
    pub articulate: &'c ArticulateConfig,
    /// Which parts and joints are believed.
    pub structure: &'c PaperConfig,
    /// Seed of all random sampling.
    pub seed: u64,
}

/// Which parts and joints are believed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperConfig {
    /// Fewest frames in which a joint is observed.
    pub min_frames: usize,
    /// Least motion of a slide, metres.
    pub min_slide_m: f64,
    /// Least motion of a hinge, radians.
    pub min_turn_rad: f64,
    /// Largest root mean square distance to the joint's model, metres, of a part that hardly moves.
    pub max_position_rmse_m: f64,
    /// Share of the way that the part makes that this distance may grow by. Hands roughly follow
    /// many models.
    pub max_rmse_share: f64,
    /// Largest share of samples that the joint does not explain.
    pub max_outlier_ratio: f64,
    /// Frames for which a track of an object's part rests at the start or end of its life.
    pub rest_frames: usize,
    /// Least share of a part's tracks that rest: object parts rest, hands do not.
    pub min_rest_share: f64,
    /// Largest share of a part's points seen *through*: where the model says that there is
    /// a surface, the camera saw something behind it.
    pub max_seen_through: f64,
    /// Squared correlation with a better joint's configuration from which a joint is taken for
    /// a consequence of it.
    pub max_coupling: f64,
    /// Largest angle between the axes of two segments of one joint, radians.
    pub merge_angle_rad: f64,
    /// Largest distance between the lines of two segments of one joint, metres.
    pub merge_distance_m: f64,
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self {
            min_frames: 15,
            min_slide_m: 0.06,
            min_turn_rad: 0.15,
            max_position_rmse_m: 0.0025,
            max_rmse_share: 0.01,
            max_outlier_ratio: 0.35,
            rest_frames: 8,
            min_rest_share: 0.12,
            max_seen_through: 0.28,
            max_coupling: 0.85,
            merge_angle_rad: 0.26,
            merge_distance_m: 0.06,
        }
    }
}
