//! Configuration of the joint search.

use crate::learn::ego_motion::EgoMotionConfig;
use serde::{Deserialize, Serialize};

/// What a search is configured with.
#[derive(Debug, Clone, Copy)]
pub struct SearchSettings<'c> {
    /// The search itself.
    pub joints: &'c JointSearchConfig,
    /// Which tracks move as seen from the static background or from a part.
    pub ego_motion: &'c EgoMotionConfig,
    /// Seed of all random sampling.
    pub seed: u64,
}

/// Values of the joint search. All ours, measured on rendered recordings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointSearchConfig {
    /// Squared Mahalanobis distance from which an observation is an outlier.
    pub cut: f64,
    /// Most hypotheses that are grown in one round, for each part in whose frame joints are sought.
    pub max_hypotheses: usize,
    /// Least rank of a hypothesis that is grown, as a share of the strongest hypothesis's rank.
    pub min_rank_share: f64,
    /// Most rounds of choosing a joint and searching the tracks that it does not explain.
    pub rounds: usize,
    /// Bundle adjustment steps every few frames while a joint is propagated.
    pub growth_steps: usize,
    /// Bundle adjustment steps when a joint has been propagated to all frames.
    pub finish_steps: usize,
    /// Gain that each frame's configuration costs, so that a joint must explain more than its own
    /// parameters.
    pub frame_penalty: f64,
    /// Frames for which a track rests at the start or the end of its life if it is an object's.
    pub rest_frames: usize,
    /// Largest cost of an observation, as a mean over a joint's tracks. Measured: hands cost 2.5 to
    /// 3.9, real joints 0.9 to 2.9.
    pub max_cost: f64,
    /// Least gain of a joint: how much better it explains its tracks than standing still does.
    pub min_gain: f64,
    /// Largest share of a joint's points that depth pictures may see through.
    pub max_through: f64,
    /// Largest share of its points that may be missing in frames of unknown configuration.
    pub max_hidden: f64,
    /// Factor on covariances. It was measured together with `systematic_rad` and `systematic_m`, so
    /// that 95 % ellipsoids hold 95 % of the true axes.
    pub covariance_inflation: f64,
    /// Error of an axis's direction that all readings of a depth camera share, so that many tracks
    /// do not average it out, radians.
    pub systematic_rad: f64,
    /// The same error of an axis's place, metres.
    pub systematic_m: f64,
    /// Observations of a track that count as one independent observation when the type of a joint
    /// is selected.
    pub correlated_observations: f64,
    /// Largest share of its tracks' observations in frames of unknown configuration.
    pub max_unruly: f64,
    /// Joints are also sought in the frames of parts that move.
    pub chains: bool,
    /// Hinges that advance as they turn (screws) are told from those that do not.
    pub screws: bool,
    /// Segments of time in which one joint was seen are merged.
    pub merge: bool,
    /// Outlier tracks, which the depth pictures contradict one by one, are taken out of a joint.
    pub dismiss_strangers: bool,
}

impl Default for JointSearchConfig {
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
