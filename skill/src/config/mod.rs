//! The configuration of the whole skill: a profile, with what a file sets over it. Files hold only
//! what differs from the profile that they extend.

mod keys;
pub(crate) mod merge;
mod values;

pub use crate::learn::config::{LearnConfig, Method, PlanesConfig};
pub use crate::learn::joint_search::config::JointSearchConfig;
pub use crate::learn::tracking::{DepthLift, DescriptorKind, FlowMethod, TrackConfig};
pub use crate::recognise::config::RecogniseConfig;
use keys::{check_keys, explained, rename_earlier_keys};
use merge::merge;
use serde::Deserialize;
use std::path::Path;
pub use values::SkillConfig;

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// No profile goes by that name.
    #[error("no profile \"{name}\"; known: {}", known_profiles())]
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
            "default" => include_str!("../../../config/default.toml"),
            #[cfg(feature = "paper")]
            "paper" => include_str!("../../../config/paper.toml"),
            #[cfg(feature = "paper")]
            "katz" => include_str!("../../../config/katz.toml"),
            _ => return Err(ConfigError::Profile { name: profile.to_owned() }),
        };
        let mut table = Self::default().to_table();
        let embedded = format!("config/{profile}.toml");
        merge(&mut table, parse(&embedded, text)?);
        let mut path = embedded;
        if let Some(file) = file {
            path = file.display().to_string();
            let text = linkage_frames::text_table::read_settings(file)
                .map_err(|e| ConfigError::File { path: path.clone(), reason: e.to_string() })?;
            merge(&mut table, parse(&path, &text)?);
        }
        let refused = |reason| ConfigError::File { path, reason };
        if let Err(reason) = check_keys(&table) {
            return Err(refused(reason));
        }
        Self::deserialize(table).map_err(|e| refused(in_one_line(&e.to_string())))
    }

    /// All values as TOML, each below comment lines that explain it.
    #[must_use]
    pub fn to_explained_toml(&self) -> String {
        explained(&self.to_table())
    }
}

/// Names of the profiles that this build has.
fn known_profiles() -> &'static str {
    if cfg!(feature = "paper") { "default, paper, katz" } else { "default" }
}

fn parse(path: &str, text: &str) -> Result<toml::Table, ConfigError> {
    let mut table = text.parse::<toml::Table>().map_err(|e| ConfigError::File {
        path: path.to_owned(),
        reason: in_one_line(&e.to_string()),
    })?;
    rename_earlier_keys(&mut table);
    Ok(table)
}

fn in_one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::LearnSettings;

    #[test]
    fn the_default_profile_is_the_default() {
        assert_eq!(SkillConfig::load("default", None).unwrap(), SkillConfig::default());
    }

    #[test]
    fn a_learner_learns_with_the_default_profile_where_nothing_is_set() {
        assert_eq!(LearnSettings::from(&SkillConfig::default()), LearnSettings::default());
    }

    #[cfg(feature = "paper")]
    #[test]
    fn the_paper_profile_holds_the_papers_values() {
        let paper = SkillConfig::load("paper", None).unwrap();
        assert_eq!(paper.learn.method, Method::Paper);
        assert_eq!((paper.track.max_features, paper.track.quality), (1500, 0.04));
        assert_eq!(paper.track.descriptor, DescriptorKind::Surf);
    }

    /// What loading a file with this text says is wrong with it.
    fn refusal(text: &str) -> String {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let message = SkillConfig::load("default", Some(file.path())).unwrap_err().to_string();
        assert!(message.starts_with(&file.path().display().to_string()), "{message}");
        message
    }

    #[test]
    fn an_unknown_key_is_named_with_the_nearest_known_one() {
        let message = refusal("[track]\nmax_featurs = 3\n");
        assert!(
            message.contains("\"track.max_featurs\"; did you mean \"track.max_features\"?"),
            "{message}"
        );
        let message = refusal("sed = 3\n");
        assert!(message.contains("\"sed\"; did you mean \"seed\"?"), "{message}");
    }

    #[test]
    fn a_key_of_an_earlier_version_is_told_to_be_a_constant_now() {
        for text in ["[joints]\nmax_cost = 3.0\n", "[pose]\ngaps = [1]\n"] {
            let message = refusal(text);
            assert!(message.contains("is a constant of the program now"), "{message}");
        }
        assert!(refusal("[pose]\ngapes = [1]\n").contains("unknown key \"pose.gapes\""));
    }

    #[test]
    fn a_value_of_another_type_is_refused() {
        assert!(refusal("[track]\nmax_features = \"many\"\n").contains("invalid type"));
        assert!(refusal("track = 3\n").contains("invalid type"));
    }

    #[cfg(feature = "paper")]
    #[test]
    fn what_is_printed_is_read_as_the_same_configuration() {
        for profile in ["default", "paper", "katz"] {
            let config = SkillConfig::load(profile, None).unwrap();
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), config.to_explained_toml()).unwrap();
            assert_eq!(SkillConfig::load("default", Some(file.path())).unwrap(), config);
        }
    }

    #[test]
    fn an_unknown_profile_is_refused() {
        assert!(matches!(SkillConfig::load("best", None), Err(ConfigError::Profile { .. })));
    }
}
