//! Our codec against lcm-gen's C: what we encode, C decodes and encodes again to the same
//! bytes, and the fingerprints in front are equal.

use linkage_lcm::messages::{articulation, drake, kinect, linkage, openni};
use linkage_lcm::{Message, decode, encode};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

/// Generates, compiles and keeps a C program that decodes a type from standard input and
/// writes it back.
fn c_round_trip(dir: &Path, c_type: &str) -> std::path::PathBuf {
    let program = dir.join(c_type);
    let source = dir.join(format!("{c_type}_main.c"));
    std::fs::write(
        &source,
        format!(
            "#include <stdio.h>\n#include <stdlib.h>\n#include \"{c_type}.h\"\n\
             int main(void) {{ static char in[1<<20]; int n = fread(in, 1, sizeof in, stdin);\n\
             {c_type} m; if ({c_type}_decode(in, 0, n, &m) != n) return 3;\n\
             int size = {c_type}_encoded_size(&m); char *out = malloc(size);\n\
             if ({c_type}_encode(out, 0, size, &m) != size) return 4;\n\
             fwrite(out, 1, size, stdout); return 0; }}\n"
        ),
    )
    .unwrap();
    let mut sources: Vec<_> = std::fs::read_dir(dir)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| {
            p.extension().is_some_and(|e| e == "c") && !p.to_string_lossy().ends_with("_main.c")
        })
        .collect();
    sources.push(source);
    let status = Command::new("cc")
        .args(["-w", "-I"])
        .arg(dir)
        .args(&sources)
        .arg("-llcm")
        .arg("-o")
        .arg(&program)
        .status()
        .expect("a C compiler, which tools/setup installs");
    assert!(status.success());
    program
}

fn generated() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let types = Path::new(env!("CARGO_MANIFEST_DIR")).join("types");
    let files: Vec<_> = std::fs::read_dir(types).unwrap().map(|e| e.unwrap().path()).collect();
    let status = Command::new("lcm-gen")
        .args(["--c", "--c-cpath"])
        .arg(dir.path())
        .arg("--c-hpath")
        .arg(dir.path())
        .args(&files)
        .stdout(Stdio::null())
        .status()
        .expect("lcm-gen, which tools/setup installs");
    assert!(status.success());
    dir
}

fn check<M: Message + PartialEq + std::fmt::Debug>(dir: &Path, message: &M) {
    let program = c_round_trip(dir, &M::NAME.replace('.', "_"));
    let ours = encode(message).unwrap();
    let mut child =
        Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(&ours).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}: C refused our bytes", M::NAME);
    assert_eq!(output.stdout, ours, "{}: C encodes it differently", M::NAME);
    assert_eq!(&decode::<M>(&output.stdout).unwrap(), message);
}

fn check_what_is_known_and_seen(dir: &Path) {
    let joint = linkage::Joint {
        name: "joint1".into(),
        kind: "revolute".into(),
        parent: 0,
        child: 1,
        axis: [0.0, -1.0, 0.0],
        origin: [0.4, 0.0, 1.1],
        range: [0.0, 1.5],
        configuration_known: true,
        configuration: 0.3,
        ..Default::default()
    };
    let recognised = linkage::Match {
        object: "fridge".into(),
        score: 0.9,
        inliers: 57,
        camera_from_object: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        base_known: true,
        joints: vec![joint.clone()],
        reasons: vec!["hidden".into()],
    };
    check(
        dir,
        &linkage::Model {
            utime: 1,
            schema: 1,
            object: "fridge".into(),
            demonstrations: 2,
            part_names: vec!["base".into(), "part1".into()],
            joints: vec![joint],
        },
    );
    check(dir, &linkage::Recognition { utime: 2, schema: 1, matches: vec![recognised.clone()] });
    let path = linkage::PartPath {
        part: "part1".into(),
        time_from_start_us: vec![0],
        poses: vec![linkage::Pose { position: [1.0, 2.0, 3.0], quaternion: [0.0, 0.0, 0.0, 1.0] }],
    };
    check(
        dir,
        &linkage::Prediction {
            utime: 3,
            made_utime: 4,
            schema: 1,
            recognition: recognised,
            trajectories: vec![linkage::JointTrajectory {
                joint: "joint1".into(),
                kind: "revolute".into(),
                time_from_start_us: vec![0, 10],
                position: vec![0.1, 0.2],
                velocity: vec![0.0, 0.0],
                acceleration: vec![0.5, -0.5],
            }],
            paths: vec![path.clone()],
            handles: vec![path],
        },
    );
}

fn check_what_a_service_hears_and_tells(dir: &Path) {
    check(
        dir,
        &linkage::Status {
            utime: 4,
            schema: 1,
            state: "idle".into(),
            frame_rate: 29.9,
            frames: 100,
            dropped_frames: 1,
            tracks: 900,
            object: "fridge".into(),
            joint_kind: vec!["revolute".into()],
            joint_certainty: vec![0.99],
            command_utime: 3,
            command_accepted: true,
            command_done: false,
            command_answer: "demonstrating".into(),
            refused: 2,
            last_error: String::new(),
            session: 11,
        },
    );
    check(
        dir,
        &linkage::Command {
            utime: 5,
            schema: 1,
            action: linkage::Command::PREDICT,
            object: String::new(),
            joint: "joint1".into(),
            target: "open".into(),
            outside_range: false,
            has_grasp: true,
            grasp: [0.1, 0.2, 1.3],
            session: 4,
            expiry_utime: 9,
            signature: vec![7; 32],
        },
    );
    check(
        dir,
        &linkage::Setpoint {
            utime: 6,
            schema: 2,
            sequence: 77,
            last: true,
            object: "fridge".into(),
            joint_name: vec!["joint1".into()],
            position: vec![0.1],
            velocity: vec![-0.2],
            acceleration: vec![0.3],
            reason: "no new frame".into(),
        },
    );
    check(dir, &linkage::Heartbeat { utime: 7, schema: 1, source: "arm".into() });
}

fn check_the_original_systems(dir: &Path) {
    let pose = articulation::PoseMsg {
        utime: 6,
        id: 1,
        pos: [1.0, 2.0, 3.0],
        orientation: [1.0, 0.0, 0.0, 0.0],
    };
    let track = articulation::TrackMsg {
        id: 1,
        pose: vec![pose.clone()],
        pose_flags: vec![1],
        channels: vec![articulation::Channelfloat32Msg { name: "q0".into(), values: vec![0.5] }],
        ..Default::default()
    };
    let parameter =
        articulation::ModelParamMsg { name: "rot_axis.x".into(), value: 0.25, r#type: 1 };
    check(
        dir,
        &articulation::ArticulatedObjectMsg {
            parts: vec![track.clone()],
            params: vec![parameter.clone()],
            models: vec![articulation::ModelMsg {
                id: 1,
                name: "rotational".into(),
                params: vec![parameter],
                track,
            }],
            markers: vec![pose],
        },
    );
}

fn check_frames(dir: &Path) {
    check(
        dir,
        &kinect::FrameMsg {
            timestamp: 8,
            image: kinect::ImageMsg {
                timestamp: 8,
                width: 2,
                height: 1,
                image_data: vec![1; 6],
                image_data_format: 0,
            },
            depth: kinect::DepthMsg {
                timestamp: 8,
                width: 2,
                height: 1,
                depth_data: vec![9, 8, 7, 6],
                depth_data_format: kinect::DepthMsg::DEPTH_MM,
                compression: 0,
                uncompressed_size: 4,
            },
            raw_accel: [1, -2, 3],
            raw_tilt: -4,
            accel: [0.0, 9.8, 0.1],
            tilt_radians: 0.2,
            led_status: 1,
            tilt_status: 0,
        },
    );
    check(
        dir,
        &openni::FrameMsg {
            timestamp: 9,
            image: openni::ImageMsg {
                timestamp: 10,
                width: 2,
                height: 1,
                pixel_offset: [3, -4],
                image_data: vec![1, 2, 3, 4, 5, 6],
                image_data_format: openni::ImageMsg::VIDEO_RGB,
            },
            depth: openni::DepthMsg {
                timestamp: 11,
                width: 2,
                height: 1,
                pixel_offset: [-5, 6],
                depth_data: vec![9, 8, 7, 6],
                compression: openni::DepthMsg::COMPRESSION_NONE,
                uncompressed_size: 4,
                viewpoint: openni::DepthMsg::VIEWPOINT_RGB,
                focal_length: 575.8,
            },
            disparity: openni::DisparityMsg {
                timestamp: 12,
                width: 1,
                height: 1,
                pixel_offset: [7, 8],
                disparity_data: vec![1, 2],
            },
        },
    );
}

fn check_plans(dir: &Path) {
    check(
        dir,
        &drake::LcmtRobotPlan {
            utime: 9,
            plan: vec![drake::LcmtRobotState {
                utime: 0,
                joint_name: vec!["fridge/joint1".into()],
                joint_position: vec![0.25],
            }],
        },
    );
}

#[test]
fn c_and_rust_give_the_same_bytes_for_every_message() {
    let dir = generated();
    check_what_is_known_and_seen(dir.path());
    check_what_a_service_hears_and_tells(dir.path());
    check_the_original_systems(dir.path());
    check_frames(dir.path());
    check_plans(dir.path());
}
