//! The configuration of the whole skill: one struct a stage, nested here. Files hold only
//! what differs from the profile that they extend.

use crate::articulation::ArticulateConfig;
use crate::learn::ego_motion::EgoMotionConfig;
use crate::learn::joint_search::config::JointSearchConfig;
use crate::learn::katz::config::KatzConfig;
use crate::learn::paper::config::PaperConfig;
use crate::learn::paper::pose_optimisation::PoseConfig;
use crate::learn::paper::segmentation::SegmentConfig;
use crate::learn::plane_hinges::config::PlanesConfig;
use crate::learn::tracking::TrackConfig;
use crate::object::appearance::AppearanceConfig;
use crate::recognise::{FollowConfig, RecogniseConfig};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Which method learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The paper's: cluster tracks, then poses, then models.
    #[serde(rename = "clusters")]
    Paper,
    /// Ours: joints with a shared configuration fitted directly to the tracks.
    #[serde(rename = "joints")]
    DirectJoints,
    /// The paper's baseline: Katz et al. 2013.
    Katz,
}

/// Values of the learner as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnConfig {
    /// Which method learns.
    pub way: Method,
    /// Whole frames kept for appearance and free-space tests; bounds memory.
    pub keyframes: usize,
    /// Frames between searches for joints while frames arrive, and so how old a live guess may
    /// be; 0: only at the end.
    pub search_every: usize,
}

impl Default for LearnConfig {
    fn default() -> Self {
        Self { way: Method::DirectJoints, keyframes: 48, search_every: 15 }
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
    pub base: EgoMotionConfig,
    /// Motion segmentation.
    pub segment: SegmentConfig,
    /// Pose optimisation.
    pub pose: PoseConfig,
    /// Joint models.
    pub articulate: ArticulateConfig,
    /// Which parts and joints the paper's way believes.
    pub structure: PaperConfig,
    /// Our way of learning.
    pub joints: JointSearchConfig,
    /// Hinges of plain surfaces.
    pub planes: PlanesConfig,
    /// The baseline's.
    pub katz: KatzConfig,
    /// Appearance models.
    pub appearance: AppearanceConfig,
    /// Recognition.
    pub recognise: RecogniseConfig,
    /// Following what was recognised.
    pub follow: FollowConfig,
}

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// No profile goes by that name.
    #[error("no profile \"{name}\"; known: default, paper, katz")]
    Profile {
        /// As asked.
        name: String,
    },
    /// The file cannot be read, is no TOML, or holds what is not known.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: String,
        /// What is wrong.
        reason: String,
    },
}

impl SkillConfig {
    /// A profile, with what a file sets over it.
    ///
    /// # Errors
    /// [`ConfigError`]; an unknown key is named with the nearest known one.
    pub fn load(profile: &str, file: Option<&Path>) -> Result<Self, ConfigError> {
        let text = match profile {
            "default" => include_str!("../../config/default.toml"),
            "paper" => include_str!("../../config/paper.toml"),
            "katz" => include_str!("../../config/katz.toml"),
            _ => return Err(ConfigError::Profile { name: profile.to_owned() }),
        };
        let mut table = toml::Table::try_from(Self::default())
            .expect("every value of the configuration has a TOML form");
        let embedded = format!("config/{profile}.toml");
        merge(&mut table, parse(&embedded, text)?);
        let mut path = embedded;
        if let Some(file) = file {
            path = file.display().to_string();
            let text = std::fs::read_to_string(file)
                .map_err(|e| ConfigError::File { path: path.clone(), reason: e.to_string() })?;
            merge(&mut table, parse(&path, &text)?);
        }
        Self::deserialize(table)
            .map_err(|e| ConfigError::File { path, reason: with_nearest_key(&e.to_string()) })
    }
}

fn parse(path: &str, text: &str) -> Result<toml::Table, ConfigError> {
    text.parse::<toml::Table>().map_err(|e| ConfigError::File {
        path: path.to_owned(),
        reason: e.to_string().split_whitespace().collect::<Vec<_>>().join(" "),
    })
}

/// Sets what `over` sets, table by table.
pub fn merge(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(over)) => merge(inner, over),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// Serde names the unknown key and all known ones, each in backquotes: the nearest is
/// what was meant.
fn with_nearest_key(message: &str) -> String {
    let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut names = line.split('`').skip(1).step_by(2);
    match (line.starts_with("unknown field"), names.next()) {
        (true, Some(unknown)) => {
            match names.min_by_key(|known| strsim::levenshtein(unknown, known)) {
                Some(nearest) => format!("unknown key \"{unknown}\"; did you mean \"{nearest}\"?"),
                None => line,
            }
        }
        _ => line,
    }
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
            planes: Default::default(),
            katz: Default::default(),
            appearance: Default::default(),
            recognise: Default::default(),
            follow: Default::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_profile_is_the_default() {
        assert_eq!(SkillConfig::load("default", None).unwrap(), SkillConfig::default());
    }

    #[test]
    fn the_paper_profile_holds_the_papers_values() {
        let paper = SkillConfig::load("paper", None).unwrap();
        assert_eq!(paper.learn.way, Method::Paper);
        assert_eq!((paper.track.max_features, paper.track.quality), (1500, 0.04));
        assert_eq!(paper.pose.gaps, [1, 10]);
    }

    #[test]
    fn an_unknown_key_is_named_with_the_nearest_known_one() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "[track]\nmax_featurs = 3\n").unwrap();
        let message = SkillConfig::load("default", Some(file.path())).unwrap_err().to_string();
        assert!(message.contains("\"max_featurs\"; did you mean \"max_features\"?"), "{message}");
    }

    #[test]
    fn an_unknown_profile_is_refused() {
        assert!(matches!(SkillConfig::load("best", None), Err(ConfigError::Profile { .. })));
    }
}
