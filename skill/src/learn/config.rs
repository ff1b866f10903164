//! What can be set of the learner, and what one demonstration is learned with.

use super::joint_search::SearchSettings;
use super::joint_search::config::JointSearchConfig;
use super::tracking::TrackConfig;
use crate::explained_config::explained_config;
use serde::{Deserialize, Serialize};

/// Which method learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The paper's: cluster tracks, then poses, then models.
    #[cfg(feature = "paper")]
    #[serde(rename = "clusters")]
    Paper,
    /// Ours: joints with a shared configuration fitted directly to the tracks.
    #[serde(rename = "joints")]
    DirectJoints,
    /// The paper's baseline: Katz et al. 2013.
    #[cfg(feature = "paper")]
    Katz,
}

explained_config! {
    /// Values of the learner as a whole.
    pub struct LearnConfig {
        /// Which method learns: "clusters" (the paper's), "joints" (ours) or "katz" (the paper's
        /// baseline). Set by the profiles.
        pub method: Method = Method::DirectJoints,
    }
}

explained_config! {
    /// Values of the search for plain parts, and for those that leave their places.
    pub struct PlanesConfig {
        /// Plain parts are sought beside the joints that tracks show, and joints are followed by their
        /// planes where their tracks are lost. Set by the ablation.
        pub enabled: bool = true,
        /// Parts without features and planes are sought by the places that they leave. Set by the ablation.
        pub vacated: bool = true,
    }
}

/// What one demonstration is learned with. A `&SkillConfig` becomes one where a learner is made.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LearnSettings {
    /// Name of the profile, which the model keeps as its provenance.
    pub profile: String,
    /// Seed of all random sampling.
    pub seed: u64,
    /// Method.
    pub method: Method,
    /// Feature tracking.
    pub track: TrackConfig,
    /// Joint search.
    pub joints: JointSearchConfig,
    /// Plain parts.
    pub planes: PlanesConfig,
}

impl Default for LearnSettings {
    fn default() -> Self {
        Self {
            profile: "default".to_owned(),
            seed: 1,
            method: Method::DirectJoints,
            track: TrackConfig::default(),
            joints: JointSearchConfig::default(),
            planes: PlanesConfig::default(),
        }
    }
}

impl LearnSettings {
    /// What the joint search needs of them.
    pub(super) fn search(&self) -> SearchSettings<'_> {
        SearchSettings { joints: &self.joints, seed: self.seed }
    }
}
