//! The configuration of the whole skill: one struct a stage, nested here. Files hold only
//! what differs from the profile that they extend.

use crate::appearance::AppearanceConfig;
use crate::articulate::ArticulateConfig;
use crate::base::BaseConfig;
use crate::joints::JointsConfig;
use crate::pose::PoseConfig;
use crate::recognise::RecogniseConfig;
use crate::segment::SegmentConfig;
use crate::structure::StructureConfig;
use crate::track::TrackConfig;
use serde::{Deserialize, Serialize};

/// Which way of learning is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LearningWay {
    /// The paper's: cluster tracks, then poses, then models.
    Clusters,
    /// Ours: joints with a shared configuration fitted directly to the tracks.
    Joints,
}

/// Values of the learner as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnConfig {
    /// The way.
    pub way: LearningWay,
    /// Whole frames kept for appearance and free-space tests; bounds memory.
    pub keyframes: usize,
}

impl Default for LearnConfig {
    fn default() -> Self {
        Self { way: LearningWay::Joints, keyframes: 48 }
    }
}

/// Everything that can be set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SkillConfig {
    /// Name of the profile, for provenance.
    pub profile: String,
    /// Seed of all random sampling: same input, configuration and seed, same result.
    pub seed: u64,
    /// The learner as a whole.
    pub learn: LearnConfig,
    /// Feature tracking.
    pub track: TrackConfig,
    /// Camera motion and what stays still.
    pub base: BaseConfig,
    /// Motion segmentation.
    pub segment: SegmentConfig,
    /// Pose optimisation.
    pub pose: PoseConfig,
    /// Joint models.
    pub articulate: ArticulateConfig,
    /// Which parts and joints the paper's way believes.
    pub structure: StructureConfig,
    /// Our way of learning.
    pub joints: JointsConfig,
    /// Appearance models.
    pub appearance: AppearanceConfig,
    /// Recognition.
    pub recognise: RecogniseConfig,
}

impl Default for SkillConfig {
    fn default() -> Self {
        Self {
            profile: "default".to_owned(),
            seed: 1,
            learn: Default::default(),
            track: Default::default(),
            base: Default::default(),
            segment: Default::default(),
            pose: Default::default(),
            articulate: Default::default(),
            structure: Default::default(),
            joints: Default::default(),
            appearance: Default::default(),
            recognise: Default::default(),
        }
    }
}
