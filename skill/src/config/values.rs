//! What can be set: one struct a stage, nested in [`SkillConfig`]. A value that neither a profile nor
//! the ablation nor a machine's memory or speed asks for is a constant beside its algorithm.

use crate::explained_config::explained_config;
use crate::learn::joint_search::config::JointSearchConfig;
use crate::learn::tracking::TrackConfig;
use crate::recognise::config::RecogniseConfig;
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
        pub way: Method = Method::DirectJoints,
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

explained_config! {
    /// Everything that can be set.
    pub struct SkillConfig {
        /// Name of the profile, for provenance. Set by the profiles.
        pub profile: String = "default".to_owned(),
        /// Seed of all random sampling: same input, configuration and seed, same result. Set by
        /// `--seed`.
        pub seed: u64 = 1,
        /// The learner as a whole.
        pub learn: LearnConfig = LearnConfig::default(),
        /// Feature tracking.
        pub track: TrackConfig = TrackConfig::default(),
        /// The joint search, our way of learning.
        pub joints: JointSearchConfig = JointSearchConfig::default(),
        /// Hinges of plain surfaces, our way of learning.
        pub planes: PlanesConfig = PlanesConfig::default(),
        /// Recognition.
        pub recognise: RecogniseConfig = RecogniseConfig::default(),
    }
}

impl SkillConfig {
    pub(super) fn to_table(&self) -> toml::Table {
        toml::Table::try_from(self).expect("every value of the configuration has a TOML form")
    }
}
