//! A rig's file: network and motion limits.

use crate::mechanics::Mechanics;
use linkage_driver::text_table::read_settings;
use linkage_skill::internals::merge;
use linkage_skill::object::JointKind;
use serde::{Deserialize, Serialize};
use std::net::IpAddr;
use std::path::{Path, PathBuf};

/// Greatest velocity, acceleration and jerk of a joint; metres or radians, seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionLimits {
    /// m/s or rad/s.
    pub velocity: f64,
    /// m/s² or rad/s².
    pub acceleration: f64,
    /// m/s³ or rad/s³.
    pub jerk: f64,
}

/// Where plans go and how fast they may be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// LCM network.
    pub lcm_url: String,
    /// Hinges.
    pub revolute: MotionLimits,
    /// Slides.
    pub prismatic: MotionLimits,
    /// What is refused.
    pub safety: Safety,
    /// How a motion is executed.
    pub streaming: Streaming,
    /// Who may command the service.
    pub access: Access,
    /// What drives joints and what resists them, for exports.
    #[serde(default)]
    pub mechanics: Mechanics,
}

/// Who may command the service.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Access {
    /// Addresses of the hosts that may; any where none is named.
    pub addresses: Vec<IpAddr>,
    /// File of the key that commands must be signed with; none where none is named.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key_file: Option<PathBuf>,
}

/// Beyond these no plan is made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Safety {
    /// Standard deviation of an axis' direction, radians.
    pub axis_deviation: f64,
    /// Standard deviation of a hinge's place, metres.
    pub hinge_deviation: f64,
    /// Standard deviation of a hinge's present configuration, radians.
    pub angle_deviation: f64,
    /// Standard deviation of a slide's present configuration, metres.
    pub offset_deviation: f64,
    /// Age of the newest frame that shows the object, seconds: when a plan is made, and while it is
    /// executed.
    pub frame_age: f64,
    /// Time after which a command that was sent is not begun any more, seconds.
    pub command_age: f64,
}

/// How a motion is executed as a stream of setpoints. Seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Streaming {
    /// How joints of one object move together.
    pub synchronisation: Synchronisation,
    /// Time from the planning of a motion for joints that already move to the instant at which it
    /// takes over.
    pub lead_time: f64,
    /// Longest pause between two setpoints that is caught up with; after a longer one the motion is
    /// braked from where it was.
    pub longest_gap: f64,
    /// Nothing moves without the consumer's heartbeat.
    pub heartbeat_required: bool,
    /// Age of the newest heartbeat.
    pub heartbeat_age: f64,
}

/// How joints of one object move together, each within its limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Synchronisation {
    /// Each as fast as it may.
    Independent,
    /// All arrive at once.
    Time,
    /// All arrive at once, and have covered the same share of their distances at any instant;
    /// joints that already move when they get another target only arrive at once.
    Phase,
}

impl Default for Rig {
    fn default() -> Self {
        toml::from_str(Self::DEFAULT_TEXT).expect("config/rigs/default.toml is checked by a test")
    }
}

/// A rig's file that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct RigError {
    path: String,
    reason: String,
}

impl Rig {
    /// The default rig's file, with its explanations.
    pub const DEFAULT_TEXT: &str = include_str!("../../config/rigs/default.toml");

    /// Reads a rig's file; what it leaves out is as in `config/rigs/default.toml`.
    ///
    /// # Errors
    /// [`RigError`] names the file and what is wrong.
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let error = |reason: String| RigError { path: path.display().to_string(), reason };
        let text = read_settings(path).map_err(|e| error(e.to_string()))?;
        let toml_error = |e: toml::de::Error| {
            error(e.to_string().split_whitespace().collect::<Vec<_>>().join(" "))
        };
        let mut table =
            toml::Table::try_from(Self::default()).expect("every value of a rig has a TOML form");
        merge(&mut table, text.parse().map_err(toml_error)?);
        let rig = Self::deserialize(table).map_err(toml_error)?;
        rig.check().map_err(error)?;
        Ok(rig)
    }

    fn check(&self) -> Result<(), String> {
        let of = |name, limits: &MotionLimits| {
            [
                (name, "velocity", limits.velocity),
                (name, "acceleration", limits.acceleration),
                (name, "jerk", limits.jerk),
            ]
        };
        let safety = [
            ("safety", "axis_deviation", self.safety.axis_deviation),
            ("safety", "hinge_deviation", self.safety.hinge_deviation),
            ("safety", "angle_deviation", self.safety.angle_deviation),
            ("safety", "offset_deviation", self.safety.offset_deviation),
            ("safety", "frame_age", self.safety.frame_age),
            ("streaming", "lead_time", self.streaming.lead_time),
            ("streaming", "longest_gap", self.streaming.longest_gap),
            ("streaming", "heartbeat_age", self.streaming.heartbeat_age),
            ("safety", "command_age", self.safety.command_age),
        ];
        let limits = [of("revolute", &self.revolute), of("prismatic", &self.prismatic)];
        for (name, key, value) in limits.into_iter().flatten().chain(safety) {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!("{name}.{key} is {value}: it must be finite and above 0"));
            }
        }
        self.mechanics.check()?;
        self.streaming.check(self.safety.frame_age)
    }

    /// Limits of a kind of joint.
    pub fn limits(&self, kind: JointKind) -> &MotionLimits {
        match kind {
            JointKind::Revolute | JointKind::Helical => &self.revolute,
            _ => &self.prismatic,
        }
    }
}

impl Streaming {
    /// Longest time that any of these may be, seconds: nothing may move blindly for longer.
    const LONGEST: f64 = 5.0;

    /// Refuses times with which nothing would be watched over.
    fn check(&self, frame_age: f64) -> Result<(), String> {
        let times = [
            ("safety.frame_age", frame_age, Self::LONGEST),
            ("streaming.heartbeat_age", self.heartbeat_age, Self::LONGEST),
            ("streaming.longest_gap", self.longest_gap, frame_age),
            ("streaming.lead_time", self.lead_time, frame_age),
        ];
        match times.iter().find(|(_, value, greatest)| value > greatest) {
            Some((key, value, greatest)) => {
                Err(format!("{key} is {value} s: at most {greatest} s are safe"))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_rig_is_sound() {
        assert_eq!(Rig::default().check(), Ok(()));
    }

    #[test]
    fn the_values_that_the_default_rig_shows_in_comments_can_be_set() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("rig.toml");
        let shown = |line: &'static str| line.trim_start_matches('#');
        let (_, mechanics) = Rig::DEFAULT_TEXT.split_once("# [mechanics.revolute]").unwrap();
        let set: Vec<&str> = mechanics.lines().map(shown).collect();
        std::fs::write(&file, "[mechanics.revolute]".to_owned() + &set.join("\n")).unwrap();
        let rig = Rig::read(&file).unwrap();
        assert_eq!(rig.mechanics.of("any", JointKind::Revolute).effort, Some(30.0));
        assert_eq!(rig.mechanics.of("fridge", JointKind::Revolute).friction, Some(4.0));
        assert_eq!(Rig { mechanics: Mechanics::default(), ..rig }, Rig::default());
    }

    #[test]
    fn a_limit_of_zero_is_refused_by_name() {
        let mut rig = Rig::default();
        rig.prismatic.jerk = 0.0;
        assert!(rig.check().unwrap_err().contains("prismatic.jerk is 0"));
    }

    #[test]
    fn times_with_which_nothing_would_be_watched_over_are_refused_by_name() {
        let refusal = |change: fn(&mut Rig)| {
            let mut rig = Rig::default();
            change(&mut rig);
            rig.check().unwrap_err()
        };
        assert!(refusal(|r| r.safety.frame_age = 60.0).contains("safety.frame_age is 60 s"));
        assert!(refusal(|r| r.streaming.longest_gap = 0.6).contains("streaming.longest_gap"));
        assert!(refusal(|r| r.streaming.lead_time = 0.6).contains("streaming.lead_time"));
        assert!(refusal(|r| r.streaming.lead_time = 0.0).contains("streaming.lead_time is 0"));
        assert!(refusal(|r| r.streaming.heartbeat_age = f64::NAN).contains("heartbeat_age is NaN"));
        assert!(refusal(|r| r.safety.angle_deviation = -1.0).contains("angle_deviation is -1"));
    }
}
