//! Recordings of real sensors under `$LINKAGE_DATA/real`, learned by the program: what is right must stay right.

use linkage_tests::{failure, linkage, shared_data};
use serde_json::Value;

/// The joints that are learned from a recording, and what is said on standard error; `None` where it is missing.
fn learned(recording: &str) -> Option<(Vec<Value>, String)> {
    let source = shared_data(&format!("real/{recording}"))?.display().to_string();
    let scratch = tempfile::tempdir().unwrap();
    let model = scratch.path().join("model.json").display().to_string();
    let output = linkage(&["learn", &source, "--object", "thing", "--no-store", "--json", &model]);
    let (status, said) = failure(&output);
    assert!(status == 0 || said.contains("nothing articulated moves"), "{status}: {said}");
    let joints = std::fs::read(model).map_or_else(
        |_| Vec::new(),
        |text| {
            let model: Value = serde_json::from_slice(&text).unwrap();
            model["joints"].as_array().unwrap().clone()
        },
    );
    Some((joints, said))
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// Asserts that one hinge is learned, which turns by at least so many radians about the direction of a line.
fn assert_hinge(recording: &str, turn: f64, direction: [f64; 3], degrees: f64) {
    let Some((joints, said)) = learned(recording) else { return };
    let [joint] = &joints[..] else { panic!("{recording}: {} joints: {said}", joints.len()) };
    assert_eq!(joint["type"], "revolute", "{joint}");
    let range = numbers(&joint["range"]);
    assert!(range[1] - range[0] > turn, "{joint}");
    let cosine: f64 = numbers(&joint["axis"]).iter().zip(direction).map(|(a, b)| a * b).sum();
    assert!(cosine.abs() > degrees.to_radians().cos(), "{joint}");
}

#[test]
fn a_cardboard_laptop_that_two_hands_close_is_a_hinge() {
    assert_hinge("sm_close_laptop_1", 1.4, [1.0, 0.0, 0.0], 6.0);
}

#[test]
fn a_tube_that_is_folded_in_the_air_is_a_hinge_though_neither_half_rests() {
    assert_hinge("pipe_hinge", 1.9, [0.0, 0.0, 1.0], 15.0);
}

#[test]
fn a_paper_roll_that_is_pushed_into_its_box_slides() {
    let Some((joints, said)) = learned("sm_insert_roll_1") else { return };
    assert_eq!(joints.len(), 1, "{said}");
    assert_eq!(joints[0]["type"], "prismatic", "{}", joints[0]);
    let way = numbers(&joints[0]["range"]);
    assert!((0.08..0.3).contains(&(way[1] - way[0])), "{}", joints[0]);
    assert!(numbers(&joints[0]["axis"])[0].abs() > 0.98, "{}", joints[0]);
}

#[test]
fn a_kitchen_that_a_camera_in_the_hand_sees_has_no_joint() {
    let Some((joints, said)) = learned("kitchen7_c") else { return };
    assert!(joints.is_empty() && said.contains("nothing articulated moves"), "{joints:?} {said}");
}
