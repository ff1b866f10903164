//! How far each joint is, with its deviation: Foxglove's joint states for those who read these, and
//! readings of our own with what they leave out.

use super::convert::timestamp;
use super::shown::Shown;
use foxglove::messages::{JointState, JointStates};

/// Readings of one frame.
#[derive(foxglove::Encode)]
pub struct JointReadings {
    readings: Vec<JointReading>,
}

/// A joint's configuration.
#[derive(foxglove::Encode)]
pub struct JointReading {
    /// `OBJECT/JOINT`.
    joint: String,
    /// rad or m.
    unit: String,
    configuration: f64,
    /// Standard deviation; not a number where it is not known.
    deviation: f64,
    /// Range that was learned.
    least: f64,
    greatest: f64,
}

/// Joints whose configuration is known.
pub fn readings<'s>(all: impl IntoIterator<Item = &'s Shown>) -> JointReadings {
    let of = |shown: &'s Shown| {
        let joints = shown.joints.iter().zip(&shown.configurations);
        joints.filter_map(|(joint, known)| {
            let known = known.as_ref()?;
            Some(JointReading {
                joint: format!("{}/{}", shown.frame, joint.name),
                unit: joint.line.kind.unit().to_owned(),
                configuration: known.q,
                deviation: known.deviation.unwrap_or(f64::NAN),
                least: joint.range[0],
                greatest: joint.range[1],
            })
        })
    };
    JointReadings { readings: all.into_iter().flat_map(of).collect() }
}

/// The same as joint states.
pub fn states(utime: i64, readings: &JointReadings) -> JointStates {
    let state = |r: &JointReading| JointState {
        name: r.joint.clone(),
        position: Some(r.configuration),
        ..JointState::default()
    };
    JointStates {
        timestamp: Some(timestamp(utime)),
        joints: readings.readings.iter().map(state).collect(),
    }
}
