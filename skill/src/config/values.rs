//! What can be set: one struct a stage, nested in [`SkillConfig`]. A value that neither a profile nor
//! the ablation nor a machine's memory or speed asks for is a constant beside its algorithm.

use crate::explained_config::explained_config;
use crate::learn::config::{LearnConfig, LearnSettings, PlanesConfig};
use crate::learn::joint_search::config::JointSearchConfig;
use crate::learn::tracking::TrackConfig;
use crate::recognise::config::RecogniseConfig;

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

impl From<&SkillConfig> for LearnSettings {
    fn from(config: &SkillConfig) -> Self {
        Self {
            profile: config.profile.clone(),
            seed: config.seed,
            method: config.learn.method,
            track: config.track.clone(),
            joints: config.joints.clone(),
            planes: config.planes.clone(),
        }
    }
}
