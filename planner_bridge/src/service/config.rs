//! What a service works with.

use crate::limits::Rig;
use linkage_driver::{RgbdSource, SourceError};
use linkage_skill::SkillConfig;
use std::path::PathBuf;
use std::time::Duration;

/// What a service works with.
#[derive(Debug, Clone)]
pub struct ServiceConfig {
    /// Perception.
    pub skill: SkillConfig,
    /// Motion limits, and what is refused.
    pub rig: Rig,
    /// Where learned objects are kept; made with the first of them.
    pub store: PathBuf,
    /// LCM network.
    pub url: String,
    /// Setpoints a second while a prediction is executed; none are streamed without it.
    pub stream_hz: Option<f64>,
    /// How a recording is played.
    pub playback: Playback,
}

/// How a recording is played; a live camera has its own pace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Playback {
    /// This many times as fast as it was recorded; 0: as fast as it can be read.
    pub rate: f64,
    /// Again and again, in time that goes on.
    pub repeat: bool,
}

impl Default for Playback {
    fn default() -> Self {
        Self { rate: 1.0, repeat: false }
    }
}

/// Opens the source, again after it was lost or when a recording is repeated.
pub type SourceOpener = dyn FnMut() -> Result<Box<dyn RgbdSource>, SourceError> + Send;

/// Longest wait for the network's own answer at the start.
pub const SELF_TEST: Duration = Duration::from_secs(2);
