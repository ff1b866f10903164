//! AprilTags on the parts: a second opinion on poses, and nothing is learned from them.

use linkage_skill::articulation::{PoseSample, fit_models};
use linkage_skill::internals::line_angle;
use linkage_skill::object::JointKind;
use linkage_skill::{Pose, pose_from_array};
use linkage_tests::{failure, linkage, tiny_recording};
use nalgebra::Vector3;
use serde_json::Value;
use std::path::Path;

/// Poses of one part by its tag, from `t,part,x,y,z,qx,qy,qz,qw`.
fn poses_of(csv: &str, part: &str) -> Vec<(f64, Pose)> {
    csv.lines()
        .skip(1)
        .map(|line| line.split(',').collect::<Vec<_>>())
        .filter(|fields| fields[1] == part)
        .map(|fields| {
            let number = |k: usize| fields[k].parse::<f64>().unwrap();
            let pose = pose_from_array(&std::array::from_fn(|k| number(k + 2))).unwrap();
            (number(0), pose)
        })
        .collect()
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_iterator(value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()))
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_drawer_with_tags_is_learned_without_them_and_both_agree() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    let rendered = linkage(&[
        "simulate",
        "--scene",
        "drawer",
        "--tags",
        "--seed",
        "1",
        "--out",
        &at("film"),
        "--quiet",
    ]);
    assert!(rendered.status.success(), "{}", failure(&rendered).1);
    let output = linkage(&[
        "learn",
        &at("film"),
        "--object",
        "drawer",
        "--tags",
        "--tag-poses",
        &at("tags.csv"),
        "--no-store",
        "--json",
        &at("model.json"),
        "--quiet",
    ]);
    assert!(output.status.success(), "{}", failure(&output).1);
    let csv = std::fs::read_to_string(dir.path().join("tags.csv")).unwrap();
    let drawer = poses_of(&csv, "upper");
    assert!(drawer.len() > 60, "the drawer's tag was seen in {} frames", drawer.len());
    let samples: Vec<PoseSample> =
        drawer.iter().map(|(t, pose)| PoseSample::from_pose(*t, pose)).collect();
    let by_tag = &fit_models(&samples).unwrap()[0];
    assert_eq!(by_tag.geometry.kind, JointKind::Prismatic);
    let model = json(&dir.path().join("model.json"));
    let truth = json(&dir.path().join("film/truth.json"));
    let true_axis = vector(&truth["joints"][0]["axis"]);
    let degrees = |axis: &Vector3<f64>| line_angle(axis, &true_axis).to_degrees();
    assert!(degrees(&by_tag.geometry.axis) < 1.0);
    assert!(degrees(&vector(&model["joints"][0]["axis"])) < 1.0);
}

#[test]
fn a_recording_that_does_not_say_where_its_tags_are() {
    let dir = tempfile::tempdir().unwrap();
    tiny_recording(dir.path());
    let source = dir.path().display().to_string();
    let (status, message) =
        failure(&linkage(&["learn", &source, "--object", "x", "--tags", "--quiet"]));
    assert_eq!(status, 2, "{message}");
    assert!(message.contains("tags.toml") && message.contains("size_m"), "{message}");
}

#[test]
fn a_tag_without_a_size() {
    let dir = tempfile::tempdir().unwrap();
    tiny_recording(dir.path());
    std::fs::write(
        dir.path().join("tags.toml"),
        "[[tag]]\nid = 3\nsize_m = 0.0\npart = \"door\"\n",
    )
    .unwrap();
    let source = dir.path().display().to_string();
    let (status, message) =
        failure(&linkage(&["learn", &source, "--object", "x", "--tags", "--quiet"]));
    assert_eq!(status, 2, "{message}");
    assert!(message.contains("tags.toml") && message.contains("tag 3"), "{message}");
}
