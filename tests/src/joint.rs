//! The joint that is learned from a recording of a drawer, to compare recordings by.

use crate::linkage;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Runs the program, which must succeed.
pub fn run(arguments: &[&str]) {
    let output = linkage(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("paths of tests are UTF-8")
}

/// The one joint that is learned from a source.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Direction, in the frame of the first picture.
    pub axis: [f64; 3],
    /// How far it was moved, metres.
    pub range: [f64; 2],
}

/// Learns the drawer of a source.
pub fn learned_from(source: &str, scratch: &Path) -> Joint {
    let json = scratch.join("model.json");
    run(&["learn", source, "--object", "drawer", "--no-store", "--json", text(&json), "--quiet"]);
    let written = fs::read(&json).expect("the program has written its model");
    let model: Value = serde_json::from_slice(&written).expect("the model is JSON");
    let joints = model["joints"].as_array().expect("a model has joints");
    assert_eq!(joints.len(), 1, "{source}");
    assert_eq!(joints[0]["type"], "prismatic", "{source}");
    let numbers = |key: &str| -> Vec<f64> {
        let values = joints[0][key].as_array().expect("a list of numbers");
        values.iter().map(|x| x.as_f64().expect("a number")).collect()
    };
    let (axis, range) = (numbers("axis"), numbers("range"));
    Joint { axis: [axis[0], axis[1], axis[2]], range: [range[0], range[1]] }
}

/// Both joints agree, to the precision of a format: degrees, and metres of range.
pub fn assert_alike(found: &Joint, wanted: &Joint, degrees: f64, metres: f64) {
    let cosine: f64 = (0..3).map(|k| found.axis[k] * wanted.axis[k]).sum();
    let angle = cosine.clamp(-1.0, 1.0).acos().to_degrees();
    assert!(angle < degrees, "axes differ by {angle}°");
    for (a, b) in found.range.iter().zip(&wanted.range) {
        assert!((a - b).abs() < metres, "ranges {:?} and {:?}", found.range, wanted.range);
    }
}
