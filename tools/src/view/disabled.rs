//! The view in a program that is built without the feature `view`: it cannot be opened.

use super::wanted::Wanted;
use crate::outcome::Outcome;
use anyhow::anyhow;
use linkage_driver::RgbdFrame;
use linkage_planner_bridge::service::Observations;
use linkage_skill::Demonstration;
use linkage_skill::object::{Appearance, StoredObject};
use linkage_skill::recognise::Recognition;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// There is no view: this type has no value.
pub enum View {}

impl View {
    /// An error where a view is wanted: it names the feature to build with.
    pub fn open(wanted: &Wanted) -> Outcome<Option<Self>> {
        let option = match wanted {
            Wanted { mcap: Some(_), .. } => "--mcap",
            Wanted { address: Some(_), .. } => "--view",
            Wanted { mcap: None, address: None } => return Ok(None),
        };
        Err(anyhow!(
            "{option}: this program was built without the feature \"view\"; \
             build it with: cargo build --release --bin linkage --features view"
        )
        .into())
    }

    pub fn frame(&self, _frame: &RgbdFrame) {
        match *self {}
    }

    pub fn demonstration(&self, _seen: &Demonstration, _appearance: Option<&Appearance>) {
        match *self {}
    }

    pub fn recognition(&self, _utime: i64, _found: &Recognition, _objects: &[StoredObject]) {
        match *self {}
    }

    pub fn say(&self, _utime: i64, _is_warning: bool, _text: &str) {
        match *self {}
    }

    pub fn follow(&self, _observations: &Observations, _store: &Path, _is_over: &AtomicBool) {
        match *self {}
    }

    pub fn close(self) -> Outcome {
        match self {}
    }
}
