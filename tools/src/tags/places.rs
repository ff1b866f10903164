//! `tags.toml`: which tag sits on which part.

use anyhow::Context;
use linkage_driver::text_table::read_settings;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A tag of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TagPlace {
    /// Its number in the family.
    pub id: u32,
    /// Side of its black border, metres.
    pub size_m: f64,
    /// The part that it sits on.
    pub part: String,
}

/// `tags.toml`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TagPlaces {
    /// All tags.
    pub tag: Vec<TagPlace>,
}

/// Its name.
pub const FILE: &str = "tags.toml";

impl TagPlaces {
    /// Reads a recording's.
    ///
    /// # Errors
    /// Names the file, and what belongs into it where there is none.
    pub fn read(recording: &Path) -> anyhow::Result<Self> {
        let path = recording.join(FILE);
        let text = read_settings(&path).with_context(|| {
            format!(
                "{}: say there where the tags are, one [[tag]] each with id, size_m and part",
                path.display()
            )
        })?;
        Self::parse(&text).with_context(|| path.display().to_string())
    }

    /// Reads the text of such a file.
    ///
    /// # Errors
    /// Says what is wrong.
    pub fn parse(text: &str) -> anyhow::Result<Self> {
        let places: Self = toml::from_str(text)?;
        for TagPlace { id, size_m, .. } in &places.tag {
            let is_length = size_m.is_finite() && *size_m > 0.0;
            anyhow::ensure!(is_length, "tag {id} has size_m = {size_m}; give metres above 0");
        }
        Ok(places)
    }
}
