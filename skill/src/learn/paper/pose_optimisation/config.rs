//! Configuration of the pose optimisation (paper, section III-C).

use serde::{Deserialize, Serialize};

/// Values of the pose stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseConfig {
    /// Frame gaps over which relative motions are measured. The paper's, III-C: 1 and 10.
    pub gaps: Vec<usize>,
    /// RANSAC inlier distance, metres. The paper's, III-C: 1 cm.
    pub inlier_m: f64,
    /// RANSAC samples. Original code: 50.
    pub ransac_iterations: usize,
    /// Fewest tracks that give a relative motion.
    pub min_tracks: usize,
    /// Expected change of velocity between two frames: rotation, radians. Ours.
    pub velocity_sigma_rad: f64,
    /// The same for translation, metres. Ours.
    pub velocity_sigma_m: f64,
    /// Geman-McClure width of a relative motion's loss, in standard deviations; 0: squares.
    pub robust_width: f64,
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self {
            gaps: vec![1, 10],
            inlier_m: 0.01,
            ransac_iterations: 50,
            min_tracks: 4,
            velocity_sigma_rad: 0.03,
            velocity_sigma_m: 0.01,
            robust_width: 3.0,
        }
    }
}
