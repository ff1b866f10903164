//! The keys of the configuration: what each means, and which were keys in earlier versions.
//!
//! In: a configuration as a table. Out: its text with an explanation above each value, or what is wrong
//! with one of its keys. Explanations are the doc comments of the structs.

use super::values::SkillConfig;
use crate::explained_config::Explanation;
use crate::learn::config::{LearnConfig, PlanesConfig};
use crate::learn::joint_search::config::JointSearchConfig;
use crate::learn::tracking::TrackConfig;
use crate::recognise::config::RecogniseConfig;
use std::fmt::Write as _;
use toml::{Table, Value};

/// The sections of the configuration with their keys, in the order in which they are printed.
const SECTIONS: [(&str, &[Explanation]); 5] = [
    ("learn", LearnConfig::EXPLANATIONS),
    ("track", TrackConfig::EXPLANATIONS),
    ("joints", JointSearchConfig::EXPLANATIONS),
    ("planes", PlanesConfig::EXPLANATIONS),
    ("recognise", RecogniseConfig::EXPLANATIONS),
];

/// Keys of earlier versions by section. Each is a constant now, beside the algorithm that uses it.
const FORMER: [(&str, &str); 13] = [
    ("learn", "keyframes search_every"),
    ("track", "spacing_px max_descriptor_distance min_length"),
    ("base", "ransac_iterations max_points min_extent_m min_extent_sigmas"),
    (
        "segment",
        "distance_sigma_m normal_sigma_rad min_common_frames min_motion_m min_common_motion_m \
         min_moving_frames epsilon min_neighbours min_cluster max_tracks",
    ),
    (
        "pose",
        "gaps inlier_m ransac_iterations min_tracks velocity_sigma_rad velocity_sigma_m \
         robust_width",
    ),
    (
        "articulate",
        "position_sigma_m orientation_sigma_rad hinge_radius_m hinge_radius_log_sigma iterations",
    ),
    (
        "structure",
        "min_frames min_slide_m min_turn_rad max_position_rmse_m max_rmse_share max_outlier_ratio \
         rest_frames min_rest_share max_seen_through max_coupling merge_angle_rad merge_distance_m",
    ),
    (
        "joints",
        "cut min_rank_share rounds growth_steps finish_steps frame_penalty max_cost min_gain \
         covariance_inflation systematic_rad systematic_m correlated_observations",
    ),
    ("planes", "meagre_gain min_keyframes min_turn_rad max_rmse_m max_through min_tells"),
    (
        "katz",
        "max_distance_change_m min_common_frames min_features min_motion_m max_slide_residual_m \
         max_hinge_residual_m",
    ),
    (
        "appearance",
        "keyframes max_features_per_part max_surfels_per_part max_edges_per_part feature_margin_m \
         surface_margin_m base_reach_m edge_margin_m",
    ),
    ("recognise", "max_matches min_inliers max_of_a_make"),
    ("follow", "steps persistence min_score patience"),
];

/// Keys that had another name in earlier versions: section, the name then, the name now.
const RENAMED: [(&str, &str, &str); 7] = [
    ("learn", "way", "method"),
    ("joints", "max_hidden", "max_unobserved"),
    ("joints", "max_unruly", "max_uncovered"),
    ("joints", "dismiss_strangers", "remove_outliers"),
    ("recognise", "compare_looks", "compare_colour"),
    ("recognise", "check_ends", "check_edges"),
    ("recognise", "check_rivals", "check_ambiguity"),
];

/// Gives the values of keys with an earlier name their name of today. If a file has both, that of today holds.
pub fn rename_earlier_keys(table: &mut Table) {
    for (section, was, is) in RENAMED {
        let Some(Value::Table(values)) = table.get_mut(section) else { continue };
        if let Some(value) = values.remove(was) {
            values.entry(is).or_insert(value);
        }
    }
}

/// Text of a configuration: each value below comment lines that explain it.
pub fn explained(table: &Table) -> String {
    let mut text = String::new();
    let plain = SkillConfig::EXPLANATIONS.iter().filter(|(key, _)| section(key).is_none());
    plain.for_each(|explanation| add_value(&mut text, table, explanation));
    for (name, keys) in SECTIONS {
        if let Some(Value::Table(values)) = table.get(name) {
            let _ = writeln!(text, "\n[{name}]");
            keys.iter().for_each(|explanation| add_value(&mut text, values, explanation));
        }
    }
    text
}

/// Adds a value with its explanation.
fn add_value(text: &mut String, table: &Table, (key, explanation): &Explanation) {
    let Some(value) = table.get(*key) else { return };
    for line in explanation.lines() {
        let _ = writeln!(text, "#{line}");
    }
    let _ = writeln!(text, "{key} = {value}");
}

/// Checks that all keys of a configuration are known. The error names the first that is not.
pub fn check_keys(table: &Table) -> Result<(), String> {
    for (key, value) in table {
        let Value::Table(values) = value else {
            known("", key, SkillConfig::EXPLANATIONS)?;
            continue;
        };
        match section(key) {
            Some(keys) => values.keys().try_for_each(|inner| known(key, inner, keys))?,
            None => match values.keys().next() {
                Some(inner) if former(key).is_some() => known(key, inner, &[])?,
                _ => known("", key, SkillConfig::EXPLANATIONS)?,
            },
        }
    }
    Ok(())
}

/// Checks that a section has a key.
fn known(section: &str, key: &str, keys: &[Explanation]) -> Result<(), String> {
    if keys.iter().any(|(known, _)| *known == key) {
        return Ok(());
    }
    let full =
        |key: &str| if section.is_empty() { key.to_owned() } else { format!("{section}.{key}") };
    let unknown = full(key);
    if former(section).is_some_and(|mut keys| keys.any(|former| former == key)) {
        return Err(format!("key \"{unknown}\" is a constant of the program now; take it out"));
    }
    let nearest = keys.iter().map(|(known, _)| known).min_by_key(|k| strsim::levenshtein(key, k));
    let hint = nearest.map_or_else(String::new, |k| format!("; did you mean \"{}\"?", full(k)));
    Err(format!("unknown key \"{unknown}\"{hint}"))
}

/// The keys of a section that is known.
fn section(name: &str) -> Option<&'static [Explanation]> {
    SECTIONS.iter().find(|(section, _)| *section == name).map(|(_, keys)| *keys)
}

/// The keys that a section had in earlier versions.
fn former(section: &str) -> Option<impl Iterator<Item = &'static str>> {
    let (_, keys) = FORMER.iter().find(|(name, _)| *name == section)?;
    Some(keys.split_whitespace())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_file_of_an_earlier_version_sets_what_it_set_then() {
        let mut table: Table =
            "[joints]\nmax_hidden = 0.5\n[recognise]\ncheck_ends = false\ncheck_edges = true\n"
                .parse()
                .unwrap();
        rename_earlier_keys(&mut table);
        let today = "[joints]\nmax_unobserved = 0.5\n[recognise]\ncheck_edges = true\n";
        assert_eq!(table, today.parse().unwrap());
        let keys = |section| SECTIONS.iter().find(|(name, _)| *name == section).unwrap().1;
        for (section, was, is) in RENAMED {
            let has = |name| keys(section).iter().any(|(key, _)| *key == name);
            assert!(has(is) && !has(was), "{section}.{is}");
        }
    }

    /// Paths of all values of the default configuration.
    fn paths_of_values() -> BTreeSet<String> {
        let table = SkillConfig::default().to_table();
        let inner = |(key, value): (&String, &Value)| match value {
            Value::Table(values) if section(key).is_some() => {
                values.keys().map(|inner| format!("{key}.{inner}")).collect()
            }
            _ => vec![key.clone()],
        };
        table.iter().flat_map(inner).collect()
    }

    #[test]
    fn every_value_has_an_explanation_and_every_explanation_a_value() {
        let plain = SkillConfig::EXPLANATIONS.iter().map(|(key, _)| (*key).to_owned());
        let plain = plain.filter(|key| section(key).is_none());
        let in_sections = SECTIONS.iter().flat_map(|(section, keys)| {
            keys.iter().map(move |(key, _)| format!("{section}.{key}"))
        });
        let explained: BTreeSet<String> = plain.chain(in_sections).collect();
        assert_eq!(explained, paths_of_values());
        assert!(explained.len() <= 40, "{} values can be set", explained.len());
    }

    #[test]
    fn every_explanation_tells_who_sets_the_value() {
        let of_values = SkillConfig::EXPLANATIONS.iter().filter(|(key, _)| section(key).is_none());
        for (key, explanation) in of_values.chain(SECTIONS.iter().flat_map(|(_, keys)| *keys)) {
            let told = explanation.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(told.contains("Set by ") || told.contains("Set where "), "{key}: {told}");
        }
    }

    #[test]
    fn no_key_is_both_known_and_a_constant() {
        for (name, keys) in FORMER {
            for key in keys.split_whitespace() {
                assert!(
                    known(name, key, section(name).unwrap_or_default()).is_err(),
                    "{name}.{key}"
                );
            }
        }
    }

    #[test]
    fn the_explanation_stands_above_its_value() {
        let text = explained(&SkillConfig::default().to_table());
        let lines: Vec<&str> = text.lines().collect();
        let value = lines.iter().position(|line| *line == "max_hypotheses = 12").unwrap();
        assert!(
            lines[value - 2].starts_with("# Most hypotheses of motion"),
            "{}",
            lines[value - 2]
        );
    }
}
