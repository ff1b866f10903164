//! A rig's file: network and motion limits.

use linkage_skill::articulate::JointKind;
use linkage_skill::config::merge;
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
    /// Who may command the service.
    pub access: Access,
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
    /// Age of the frame that a plan starts from, seconds.
    pub frame_age: f64,
    /// Time after which a command that was sent is not begun any more, seconds.
    pub command_age: f64,
}

impl Default for Rig {
    fn default() -> Self {
        toml::from_str(include_str!("../../config/rigs/default.toml"))
            .expect("config/rigs/default.toml is checked by a test")
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
    /// Reads a rig's file; what it leaves out is as in `config/rigs/default.toml`.
    ///
    /// # Errors
    /// [`RigError`] names the file and what is wrong.
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let error = |reason: String| RigError { path: path.display().to_string(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| error(e.to_string()))?;
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
            ("safety", "frame_age", self.safety.frame_age),
            ("safety", "command_age", self.safety.command_age),
        ];
        let limits = [of("revolute", &self.revolute), of("prismatic", &self.prismatic)];
        for (name, key, value) in limits.into_iter().flatten().chain(safety) {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!("{name}.{key} is {value}: it must be finite and above 0"));
            }
        }
        Ok(())
    }

    /// Limits of a kind of joint.
    pub fn limits(&self, kind: JointKind) -> &MotionLimits {
        match kind {
            JointKind::Revolute | JointKind::Helical => &self.revolute,
            _ => &self.prismatic,
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
    fn a_limit_of_zero_is_refused_by_name() {
        let mut rig = Rig::default();
        rig.prismatic.jerk = 0.0;
        assert!(rig.check().unwrap_err().contains("prismatic.jerk is 0"));
    }
}
