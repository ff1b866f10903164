//! `linkage fit` on logs as other programs write them: lost poses, columns in any order, headers.

use linkage_tests::{failure, linkage};
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;

/// Poses of a door that opens by 1 rad about the vertical, `t x y z qx qy qz qw`.
fn door() -> Vec<[f64; 8]> {
    (0..30)
        .map(|i| {
            let i = f64::from(i);
            let q = i / 29.0;
            let wobble = 0.001 * (i * 12.9).sin();
            let (x, y) = (0.4 + (0.5 + wobble) * q.cos(), -0.1 + (0.5 + wobble) * q.sin());
            [i / 15.0, x, y, 1.4 + wobble, 0.0, 0.0, (q / 2.0).sin(), (q / 2.0).cos()]
        })
        .collect()
}

/// Poses of a drawer that is pulled 0.35 m along x.
fn drawer() -> Vec<[f64; 8]> {
    (0..30)
        .map(|i| {
            let i = f64::from(i);
            let wobble = 0.001 * (i * 12.9).sin();
            [i / 15.0, 0.3 + 0.35 * i / 29.0, 0.1 + wobble, 1.2 - wobble, 0.0, 0.0, 0.0, 1.0]
        })
        .collect()
}

fn text(poses: &[[f64; 8]], separator: &str) -> String {
    poses.iter().fold(String::new(), |mut text, pose| {
        let fields: Vec<String> = pose.iter().map(|v| format!("{v:.5}")).collect();
        let _ = writeln!(text, "{}", fields.join(separator));
        text
    })
}

/// The only joint of the model, and what is said on standard error.
fn fitted(log: &Path, options: &[&str]) -> (Value, String) {
    let path = log.display().to_string();
    let output = linkage(&[&["fit", &path, "--json", "-"], options].concat());
    let said = failure(&output);
    assert_eq!(said.0, 0, "{}", said.1);
    let model: Value = serde_json::from_slice(&output.stdout).unwrap();
    (model["joints"][0].clone(), said.1)
}

fn assert_door(joint: &Value) {
    assert_eq!(joint["type"], "revolute", "{joint}");
    let axis = joint["axis"].as_array().unwrap();
    assert!(axis[2].as_f64().unwrap().abs() > 0.999, "{joint}");
    let range = joint["range"].as_array().unwrap();
    assert!(range[0].as_f64().unwrap().abs() < 0.02, "{joint}");
    // The first or the last of 30 poses may be lost.
    assert!((range[1].as_f64().unwrap() - 1.0).abs() < 0.045, "{joint}");
}

fn assert_drawer(joint: &Value) {
    assert_eq!(joint["type"], "prismatic", "{joint}");
    assert!(joint["axis"][0].as_f64().unwrap().abs() > 0.999, "{joint}");
    assert!((joint["range"][1].as_f64().unwrap() - 0.35).abs() < 0.015, "{joint}");
}

#[test]
fn one_lost_pose_is_an_outlier_and_no_motion() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("log.txt");
    let check = |mut poses: Vec<[f64; 8]>, lost: usize, assert_right: fn(&Value)| {
        poses[lost][1..].copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        std::fs::write(&log, text(&poses, " ")).unwrap();
        let (joint, said) = fitted(&log, &[]);
        assert_right(&joint);
        assert!(said.contains("1 of 30 samples are outliers"), "{said}");
        assert_eq!(joint["observations"], 29);
        let configuration = joint["configuration"].as_array().unwrap();
        assert!(configuration.iter().all(|c| c[0] != poses[lost][0]), "{joint}");
    };
    for lost in [0, 1, 17, 29] {
        check(door(), lost, assert_door);
        check(drawer(), lost, assert_drawer);
    }
}

#[test]
fn a_header_names_the_columns() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("header.csv");
    for header in [
        "timestamp,x,y,z,qx,qy,qz,qw",
        "#time [s],p_x [m],p_y [m],p_z [m],q_x [],q_y [],q_z [],q_w []",
        "%time,field.pose.position.x,field.pose.position.y,field.pose.position.z,\
         field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,\
         field.pose.orientation.w",
    ] {
        std::fs::write(&log, format!("{header}\r\n{}", text(&door(), ","))).unwrap();
        assert_door(&fitted(&log, &[]).0);
    }
    // The same, the scalar first and a column of words before it.
    let rows = door().iter().fold(String::new(), |mut rows, [t, x, y, z, a, b, c, w]| {
        let _ = writeln!(rows, "map;{w};{a};{b};{c};{x};{y};{z};{t}");
        rows
    });
    std::fs::write(&log, format!("\u{feff}frame;qw;qx;qy;qz;x;y;z;t\n{rows}")).unwrap();
    assert_door(&fitted(&log, &[]).0);
}

#[test]
fn columns_that_cannot_be_told_are_asked_for_and_can_be_named() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("numbered.csv");
    let numbered: String =
        text(&door(), ",").lines().enumerate().map(|(i, l)| format!("{i},{l}\n")).collect();
    std::fs::write(&log, numbered).unwrap();
    let path = log.display().to_string();
    let (status, said) = failure(&linkage(&["fit", &path]));
    assert_eq!(status, 2, "{said}");
    assert!(said.contains("numbered.csv") && said.contains("--columns"), "{said}");
    assert_door(&fitted(&log, &["--columns", "_,t,x,y,z,qx,qy,qz,qw"]).0);
    let (status, said) = failure(&linkage(&["fit", &path, "--columns", "t,x,y,height"]));
    assert_eq!(status, 2, "{said}");
    assert!(said.contains("\"height\""), "{said}");
}

#[test]
fn lines_without_a_pose_are_left_out_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("gaps.txt");
    let mut lines: Vec<String> = text(&door(), "\t").lines().map(str::to_owned).collect();
    lines[4] = "0.26667\tnan\tnan\tnan\tnan\tnan\tnan\tnan".to_owned();
    lines[9] = "0.60000\t\t\t\t\t\t\t".to_owned();
    // A comment in Latin-1.
    let bytes = [b"# T\xfcr\n".to_vec(), lines.join("\r\n").into_bytes()].concat();
    std::fs::write(&log, bytes).unwrap();
    let (joint, said) = fitted(&log, &[]);
    assert_door(&joint);
    assert_eq!(joint["observations"], 28);
    assert!(said.contains("2 lines without a pose were left out (the first: line 6"), "{said}");
}
