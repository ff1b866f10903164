//! Exports in the simulators that read them: each loads without a warning, its parts keep apart, it
//! rests where it is put, and it falls only as its joints allow.
//!
//! The simulators are Python packages: MuJoCo and USD by tools/setup, PyBullet and Drake where they
//! are at hand.

use linkage_tests::{failure, linkage, python_with, shared_data, simulated};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Deepest overlap of two parts, millimetres.
const OVERLAP_MM: f64 = 5.0;
/// Movement of a joint at rest, radians or metres.
const REST: f64 = 1e-4;
/// How far a joint that falls may press into its limit: simulators' limits are soft. Radians or metres.
const SOFT_LIMIT: f64 = 0.06;

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Learns an object and says in which store it is.
fn learned(recording: &Path, object: &str, dir: &Path) -> PathBuf {
    let store = dir.join("objects.linkage");
    let (recording, at) = (text(recording), text(&store));
    let output = linkage(&["learn", &recording, "--object", object, "--store", &at, "--quiet"]);
    assert!(output.status.success(), "{}", failure(&output).1);
    store
}

/// Exports an object; with meshes where they are wanted.
fn exported(store: &Path, object: &str, format: &str, has_meshes: bool) -> PathBuf {
    let ending = if format == "usd" { "usda" } else { format };
    let out = store.with_file_name(format!("{object}.{ending}"));
    let (at, file) = (text(store), text(&out));
    let mut arguments = vec!["export", object, "--store", &at, "--format", format, "--out", &file];
    if has_meshes {
        arguments.push("--mesh");
    }
    let output = linkage(&arguments);
    assert!(output.status.success(), "{}", failure(&output).1);
    out
}

/// What a simulator says of a file.
fn checked(python: &Path, simulator: &str, file: &Path) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/check_export.py");
    let output = Command::new(python)
        .args([&script, Path::new(simulator), file])
        .output()
        .expect("the Python of the tests starts");
    assert!(output.status.success(), "{simulator}, {}: {}", file.display(), failure(&output).1);
    let said = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(said.lines().last().unwrap_or_default()).expect("it prints JSON")
}

/// Loads all formats of an object in a simulator; tells how far joints fell in all.
fn accepts(
    simulator: &str,
    package: &str,
    formats: &[&str],
    object: &str,
    recording: &Path,
) -> f64 {
    let Some(python) = python_with(&[package]) else { return f64::INFINITY };
    let dir = tempfile::tempdir().unwrap();
    let store = learned(recording, object, dir.path());
    let mut fallen = 0.0;
    for format in formats {
        for has_meshes in [false, true] {
            let said = checked(&python, simulator, &exported(&store, object, format, has_meshes));
            let number = |key: &str| said[key].as_f64().expect("a number");
            let of = format!("{object}.{format} in {simulator}: {said}");
            assert!(said["warnings"].as_array().expect("a list").is_empty(), "{of}");
            assert!(said["joints"].as_u64().expect("a number") >= 1, "{of}");
            assert!(number("overlap_mm") < OVERLAP_MM, "{of}");
            assert!(number("moved") < REST, "{of}");
            assert!(number("off_joint") < SOFT_LIMIT, "{of}");
            let fell = said["fell"].as_array().into_iter().flatten();
            fallen += fell.filter_map(Value::as_f64).sum::<f64>();
        }
    }
    fallen
}

#[test]
fn a_drawer_rests_and_falls_in_mujoco() {
    let fallen =
        accepts("mujoco", "mujoco", &["mjcf", "urdf"], "drawer", &simulated("drawer", false, 1));
    assert!(fallen > 0.1, "the drawer is stuck");
}

#[test]
fn a_drawer_is_sound_usd() {
    accepts("usd", "pxr", &["usd"], "drawer", &simulated("drawer", false, 1));
}

#[test]
fn a_drawer_rests_and_falls_in_pybullet() {
    let fallen =
        accepts("pybullet", "pybullet", &["urdf"], "drawer", &simulated("drawer", false, 1));
    assert!(fallen > 0.1, "the drawer is stuck");
}

#[test]
fn a_drawer_rests_and_falls_in_drake() {
    let package = "pydrake.multibody.plant";
    let fallen =
        accepts("drake", package, &["urdf", "sdf"], "drawer", &simulated("drawer", false, 1));
    assert!(fallen > 0.1, "the drawer is stuck");
}

#[test]
fn a_cabinet_of_which_one_door_was_hardly_seen_rests_and_falls_in_mujoco() {
    let Some(recording) = shared_data("demos/hingecab_demo1") else { return };
    let fallen = accepts("mujoco", "mujoco", &["mjcf", "urdf"], "cabinet", &recording);
    assert!(fallen > 0.1, "the doors are stuck");
}

#[test]
fn meshes_need_a_file_and_lie_beside_it() {
    let dir = tempfile::tempdir().unwrap();
    let store = learned(&simulated("drawer", false, 1), "drawer", dir.path());
    let output =
        linkage(&["export", "drawer", "--store", &text(&store), "--format", "urdf", "--mesh"]);
    assert_eq!(failure(&output).0, 2, "{}", failure(&output).1);
    let urdf = std::fs::read_to_string(exported(&store, "drawer", "urdf", true)).unwrap();
    assert!(urdf.contains("<mesh filename=\"drawer_meshes/part1.obj\"/>"), "{urdf}");
    let front = std::fs::read_to_string(dir.path().join("drawer_meshes/part1.obj")).unwrap();
    let coloured = front.lines().filter(|l| l.starts_with("v ") && l.split(' ').count() == 7);
    assert!(coloured.count() > 20);
    let faces = front.lines().filter(|l| l.starts_with("f ")).count();
    assert!((20..=4000).contains(&faces), "{faces} faces");
}
