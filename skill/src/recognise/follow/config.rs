//! Configuration of the following stage.

use serde::{Deserialize, Serialize};

/// Values of the following stage. All ours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FollowConfig {
    /// Steps of the alignment a frame.
    pub steps: usize,
    /// Share of the last step of a configuration that is expected again.
    pub persistence: f64,
    /// Score below which a frame does not show the object.
    pub min_score: f64,
    /// Frames in a row without the object after which it is lost.
    pub patience: usize,
}

impl Default for FollowConfig {
    fn default() -> Self {
        Self { steps: 8, persistence: 0.8, min_score: 0.2, patience: 15 }
    }
}
