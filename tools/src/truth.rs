//! `truth.json` beside a recording: written by the simulator, read by the benchmark.

use anyhow::Context;
use linkage_skill::object::JointKind;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Poses as `[x, y, z, qx, qy, qz, qw]`.
pub type PoseArray = [f64; 7];

/// What truly happened in a recording.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Truth {
    /// Which thing it is.
    pub object: String,
    /// Sort of thing.
    pub category: String,
    /// `rich`, `medium` or `poor`.
    pub texture: String,
    /// A person moves it.
    pub hand: bool,
    /// The camera moves.
    pub moving_camera: bool,
    /// Nobody is there; it is to be recognised.
    pub encounter: bool,
    /// It was never demonstrated.
    pub unknown: bool,
    /// Time of each frame, seconds.
    pub frames: Vec<f64>,
    /// Camera pose in each frame.
    pub world_from_camera: Vec<PoseArray>,
    /// Its parts.
    pub parts: Vec<TruePart>,
    /// Its joints that move, or could.
    pub joints: Vec<TrueJoint>,
    /// All that stands there in the first frame, except for the person.
    #[serde(default)]
    pub solids: Vec<TrueSolid>,
}

/// A solid.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrueSolid {
    /// Its form about its own centre.
    pub form: TrueForm,
    /// Half of its sides, metres; the radius, half of the height and the radius of a rod or a drum,
    /// whose height is along y.
    pub half_m: [f64; 3],
    /// Its pose in the first frame.
    pub camera_from_solid: PoseArray,
}

/// Form of a solid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrueForm {
    /// A box.
    Box,
    /// A cylinder with half a ball on either end, which is not part of its height.
    Rod,
    /// A cylinder.
    Drum,
}

/// A rigid part.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TruePart {
    /// Its name.
    pub name: String,
    /// Its value in the label pictures.
    pub label: u8,
    /// Centre in its own frame, metres.
    pub centroid: [f64; 3],
    /// Its pose in each frame.
    pub camera_from_part: Vec<PoseArray>,
}

/// A joint.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrueJoint {
    /// Its name.
    pub name: String,
    /// Its kind.
    #[serde(rename = "type")]
    pub kind: JointKind,
    /// Carrying part.
    pub parent: String,
    /// Moved part.
    pub child: String,
    /// Direction in the camera frame of the first frame.
    pub axis: [f64; 3],
    /// A point on it, likewise.
    pub origin: [f64; 3],
    /// Direction in the camera frame of the last frame.
    pub axis_last: [f64; 3],
    /// A point on it, likewise.
    pub origin_last: [f64; 3],
    /// Metres a turn.
    pub pitch: f64,
    /// Configuration in each frame.
    pub configuration: Vec<f64>,
    /// Least and greatest.
    pub range_observed: [f64; 2],
    /// False in encounters and for joints that stay still.
    #[serde(default = "yes")]
    pub moved: bool,
    /// Where the hand holds the child, camera frame of the first frame, metres.
    #[serde(default)]
    pub grasp: Option<[f64; 3]>,
}

fn yes() -> bool {
    true
}

impl Truth {
    /// Reads a recording's truth.
    pub fn read(recording: &Path) -> anyhow::Result<Self> {
        let path = recording.join("truth.json");
        let text = std::fs::read_to_string(&path)
            .with_context(|| format!("{}: no truth to score against", path.display()))?;
        serde_json::from_str(&text).with_context(|| path.display().to_string())
    }

    /// Joints that moved.
    pub fn moved(&self) -> Vec<&TrueJoint> {
        self.joints.iter().filter(|j| j.moved).collect()
    }

    /// The frame taken at a time, within half of any camera's frame.
    pub fn frame_at(&self, utime: i64) -> Option<usize> {
        const NEAR_S: f64 = 0.008;
        let seconds = utime as f64 * 1e-6;
        let after = self.frames.partition_point(|t| *t < seconds - NEAR_S);
        self.frames.get(after).is_some_and(|t| (t - seconds).abs() < NEAR_S).then_some(after)
    }

    /// A part by name.
    pub fn part(&self, name: &str) -> Option<&TruePart> {
        self.parts.iter().find(|p| p.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> Truth {
        let joint = |name: &str, moved: bool| {
            serde_json::json!({
                "name": name, "type": "revolute", "parent": "body", "child": "door",
                "axis": [0, 1, 0], "origin": [0, 0, 1], "axis_last": [0, 1, 0],
                "origin_last": [0, 0, 1], "pitch": 0, "configuration": [0, 0.1, 0.2],
                "range_observed": [0, 0.2], "moved": moved
            })
        };
        let text = serde_json::json!({
            "object": "fridge", "category": "fridge", "texture": "rich", "hand": true,
            "moving_camera": false, "encounter": false, "unknown": false,
            "frames": [0.0, 0.033, 0.067], "world_from_camera": [],
            "parts": [{ "name": "door", "label": 2, "centroid": [0, 0, 0], "camera_from_part": [] }],
            "joints": [joint("upper", true), joint("lower", false)]
        });
        serde_json::from_value(text).unwrap()
    }

    #[test]
    fn a_frame_is_found_by_its_time_and_no_other_is() {
        let truth = truth();
        assert_eq!(truth.frame_at(33_400), Some(1));
        assert_eq!(truth.frame_at(60_000), Some(2), "7 ms before it");
        assert_eq!((truth.frame_at(50_000), truth.frame_at(90_000)), (None, None));
    }

    #[test]
    fn joints_that_stay_still_did_not_move() {
        let truth = truth();
        let moved: Vec<&str> = truth.moved().iter().map(|j| j.name.as_str()).collect();
        assert_eq!(moved, ["upper"]);
        assert!(truth.part("door").is_some() && truth.part("lid").is_none());
    }

    #[test]
    fn a_recording_without_truth_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let error = format!("{:#}", Truth::read(dir.path()).unwrap_err());
        assert!(error.contains("truth.json: no truth to score against"), "{error}");
    }
}
