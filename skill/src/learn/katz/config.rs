//! Configuration of the baseline.

use serde::{Deserialize, Serialize};

/// Values of the baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KatzConfig {
    /// Features of one body keep their distance within this, metres, over their common life.
    pub max_distance_change_m: f64,
    /// Fewest frames that two features must share.
    pub min_common_frames: usize,
    /// Smaller bodies are dropped.
    pub min_features: usize,
    /// Least way of a body's features, metres: what stays is background.
    pub min_motion_m: f64,
    /// Residual of a slide, root mean square over features, from which a hinge is fitted,
    /// metres.
    pub max_slide_residual_m: f64,
    /// Residual of a hinge from which two bodies are not connected, metres.
    pub max_hinge_residual_m: f64,
}

impl Default for KatzConfig {
    fn default() -> Self {
        Self {
            max_distance_change_m: 0.025,
            min_common_frames: 10,
            min_features: 10,
            min_motion_m: 0.05,
            max_slide_residual_m: 0.01,
            max_hinge_residual_m: 0.02,
        }
    }
}
