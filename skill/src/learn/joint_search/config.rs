//! What can be set of our way of learning.

use serde::{Deserialize, Serialize};

/// Values of this way of learning. All ours, measured on rendered recordings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointsConfig {
    /// Squared Mahalanobis distance from which an observation counts no more.
    pub cut: f64,
    /// Hypotheses grown in one round and frame of reference.
    pub max_hypotheses: usize,
    /// Share of the strongest hypothesis's rank below which one is not grown.
    pub min_rank_share: f64,
    /// Rounds of accepting a joint and searching what it leaves.
    pub rounds: usize,
    /// Refinement steps every few frames of growth.
    pub growth_steps: usize,
    /// Refinement steps when growth has ended.
    pub finish_steps: usize,
    /// Gain that each frame's configuration must earn.
    pub frame_penalty: f64,
    /// Frames for which a track rests that counts as an object's.
    pub rest_frames: usize,
    /// Cost an observation up to which a joint is believed: hands cost 2.5-3.9, real joints
    /// 0.9-2.9.
    pub max_cost: f64,
    /// Least gain of a joint.
    pub min_gain: f64,
    /// Share of a joint's points that may be seen through.
    pub max_through: f64,
    /// Share of them that may be missing while the configuration is unknown.
    pub max_hidden: f64,
    /// Factor on covariances. With the next two it was measured, so that 95 % ellipsoids hold
    /// 95 % of true axes.
    pub covariance_inflation: f64,
    /// What many tracks do not average out, in an axis's direction, radians,
    pub systematic_rad: f64,
    /// and in its place, metres: errors that all readings of a depth camera share.
    pub systematic_m: f64,
    /// Observations of a track that tell as much as one independent one, in telling types.
    pub correlated_observations: f64,
    /// Share of its tracks' observations that a joint may leave without a configuration.
    pub max_unruly: f64,
    /// Joints are also sought in the frames of parts that move.
    pub chains: bool,
    /// Hinges that advance as they turn are told from those that do not.
    pub screws: bool,
    /// Stretches of one joint are merged.
    pub merge: bool,
    /// Tracks that the depth pictures contradict one by one are taken out of a joint.
    pub dismiss_strangers: bool,
}

impl Default for JointsConfig {
    fn default() -> Self {
        Self {
            cut: 16.0,
            max_hypotheses: 12,
            min_rank_share: 0.02,
            rounds: 4,
            growth_steps: 2,
            finish_steps: 5,
            frame_penalty: 1.5,
            rest_frames: 8,
            max_cost: 2.2,
            min_gain: 300.0,
            max_through: 0.22,
            max_hidden: 0.6,
            covariance_inflation: 4.0,
            systematic_rad: 0.0025,
            systematic_m: 0.002,
            correlated_observations: 10.0,
            max_unruly: 0.3,
            chains: true,
            screws: true,
            merge: true,
            dismiss_strangers: true,
        }
    }
}
