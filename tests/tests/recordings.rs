//! Recordings of other programs: each is learned to the same joint as its twin in the TUM layout.
//!
//! `tests/src/foreign_recordings.py` makes them with the libraries that their makers publish; where
//! those are missing the tests are reported as ignored.

use linkage_driver::{PinholeCamera, RgbdFrame, open};
use linkage_tests::joint::{Joint, assert_alike, learned_from, run, text};
use linkage_tests::{failure, linkage, python_with, simulated, tiny_recording};
use std::collections::BTreeMap;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, OnceLock, PoisonError};

/// What millimetres instead of fifths of them may change in a joint, degrees and metres.
const DEGREES: f64 = 0.3;
const METRES: f64 = 0.003;

fn demonstration() -> PathBuf {
    simulated("drawer", false, 1)
}

/// The joint of the recording that all others are made of.
fn expected() -> &'static Joint {
    static EXPECTED: OnceLock<Joint> = OnceLock::new();
    EXPECTED.get_or_init(|| {
        let scratch = tempfile::tempdir().unwrap();
        learned_from(text(&demonstration()), scratch.path())
    })
}

/// Makes a recording of another program from one in the TUM layout; `None` without the libraries.
fn foreign(tum: &Path, format: &str, out: &Path) -> Option<()> {
    let python = python_with(&["rosbags", "mcap_ros2", "PIL"])?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/foreign_recordings.py");
    let output = Command::new(python).arg(script).arg(tum).arg(format).arg(out).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(())
}

/// All frames of a source.
fn frames_of(source: &str) -> Vec<RgbdFrame> {
    let mut source = open(source).unwrap_or_else(|e| panic!("{source}: {e}"));
    std::iter::from_fn(|| source.next_frame().unwrap()).collect()
}

/// The frames of that recording.
fn original() -> &'static [RgbdFrame] {
    static ORIGINAL: OnceLock<Vec<RgbdFrame>> = OnceLock::new();
    ORIGINAL.get_or_init(|| frames_of(text(&demonstration())))
}

/// What frames say, in a number: times, cameras, colours, depths.
fn digest(frames: &[RgbdFrame]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for frame in frames {
        frame.utime.hash(&mut hasher);
        format!("{:?}", frame.camera).hash(&mut hasher);
        frame.color.as_rgb().hash(&mut hasher);
        frame.depth.as_metres().iter().for_each(|z| z.to_bits().hash(&mut hasher));
    }
    hasher.finish()
}

/// The joint that is learned from a source of these frames. The same frames teach the same, bit for
/// bit: they are learned from once.
fn taught_by(frames: &[RgbdFrame], source: &str, scratch: &Path) -> Joint {
    static TAUGHT: Mutex<BTreeMap<u64, Joint>> = Mutex::new(BTreeMap::new());
    let mut taught = TAUGHT.lock().unwrap_or_else(PoisonError::into_inner);
    taught.entry(digest(frames)).or_insert_with(|| learned_from(source, scratch)).clone()
}

/// A recording of a format is learned to the expected joint; `name` is that of its file or folder.
fn is_learned(format: &str, name: &str) {
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join(name);
    if foreign(&demonstration(), format, &out).is_none() {
        return;
    }
    let (original, frames) = (original(), frames_of(text(&out)));
    assert_eq!(frames.len(), original.len(), "{format}");
    for (a, b) in original.iter().zip(&frames) {
        assert!(a.color == b.color, "{format}: colour differs at {} us", a.utime);
        let (a, b) = (a.depth.to_raw(1000.0), b.depth.to_raw(1000.0));
        assert!(a.iter().zip(&b).all(|(a, b)| a.abs_diff(*b) <= 1), "{format}: depth differs");
    }
    let found = taught_by(&frames, text(&out), scratch.path());
    assert_alike(&found, expected(), DEGREES, METRES);
}

#[test]
fn an_mcap_file_of_compressed_pictures_teaches_the_same() {
    is_learned("mcap", "drawer.mcap");
}

#[test]
fn a_ros_2_bag_in_sqlite_with_bgr_and_float_depth_teaches_the_same() {
    is_learned("rosbag2-sqlite", "drawer");
}

#[test]
fn a_ros_2_bag_of_compressed_messages_teaches_the_same() {
    is_learned("rosbag2-zstd", "drawer");
}

#[test]
fn a_ros_2_bag_in_mcap_teaches_the_same() {
    is_learned("rosbag2-mcap", "drawer");
}

#[test]
fn a_ros_1_bag_of_compressed_pictures_teaches_the_same() {
    is_learned("rosbag1", "drawer.bag");
}

#[test]
fn a_bag_of_realsenses_viewer_teaches_the_same() {
    is_learned("realsense", "drawer.bag");
}

#[test]
fn open3d_teaches_the_same() {
    is_learned("open3d", "drawer");
}

#[test]
fn scannet_teaches_the_same() {
    is_learned("scannet", "drawer");
}

#[test]
fn bundlefusion_teaches_the_same() {
    is_learned("bundlefusion", "drawer");
}

#[test]
fn stray_scanner_teaches_the_same() {
    is_learned("stray-scanner", "drawer");
}

#[test]
fn record3d_teaches_the_same_but_for_the_loss_of_its_jpeg() {
    let scratch = tempfile::tempdir().unwrap();
    let file = scratch.path().join("drawer.r3d");
    if python_with(&["lzfse"]).is_none() || foreign(&demonstration(), "record3d", &file).is_none() {
        return;
    }
    let (original, frames) = (original(), frames_of(text(&file)));
    assert_eq!(frames.len(), original.len());
    for (a, b) in original.iter().zip(&frames) {
        assert_eq!(b.utime - frames[0].utime, a.utime - original[0].utime);
        let (a, b) = (a.depth.to_raw(1000.0), b.depth.to_raw(1000.0));
        assert!(a.iter().zip(&b).all(|(a, b)| a.abs_diff(*b) <= 1), "depth differs");
    }
    assert_alike(&taught_by(&frames, text(&file), scratch.path()), expected(), DEGREES, METRES);
}

#[test]
fn orb_slams_lists_teach_the_same() {
    is_learned("associations", "drawer");
}

#[test]
fn stamps_and_cameras_of_bags_are_those_that_were_recorded() {
    let scratch = tempfile::tempdir().unwrap();
    let tum = scratch.path().join("tum");
    tiny_recording(&tum);
    let original = frames_of(text(&tum));
    for (format, name) in [
        ("mcap", "a.mcap"),
        ("rosbag2-sqlite", "bag2"),
        ("rosbag1", "b.bag"),
        ("realsense", "c.bag"),
    ] {
        let out = scratch.path().join(name);
        if foreign(&tum, format, &out).is_none() {
            return;
        }
        let frames = frames_of(text(&out));
        let utimes = |frames: &[RgbdFrame]| frames.iter().map(|f| f.utime).collect::<Vec<_>>();
        assert_eq!(utimes(&frames), utimes(&original), "{format}");
        let units = frames[0].camera.depth_units_per_metre;
        let expected =
            PinholeCamera { depth_units_per_metre: units, ..(*original[0].camera).clone() };
        assert_eq!(*frames[0].camera, expected, "{format}");
    }
}

#[test]
fn topics_are_taken_by_name_and_listed_where_the_name_is_wrong() {
    let scratch = tempfile::tempdir().unwrap();
    let (tum, bag) = (scratch.path().join("tum"), scratch.path().join("a.mcap"));
    tiny_recording(&tum);
    if foreign(&tum, "mcap", &bag).is_none() {
        return;
    }
    let color = "/camera/color/image_raw/compressed";
    let depth = "/camera/aligned_depth_to_color/image_raw/compressedDepth";
    let named = format!("mcap:{}#{color},{depth}", bag.display());
    assert_eq!(frames_of(&named).len(), 12);
    let named = format!("{}#{color}", bag.display());
    assert_eq!(frames_of(&named).len(), 12);
    let wrong = format!("{}#/elsewhere,{depth}", bag.display());
    let error = open(&wrong).err().unwrap().to_string();
    assert!(error.contains("/elsewhere") && error.contains(color), "{error}");
}

#[test]
fn damaged_recordings_are_told_with_status_2_or_read_as_far_as_they_go() {
    let scratch = tempfile::tempdir().unwrap();
    let tum = scratch.path().join("tum");
    tiny_recording(&tum);
    for (format, name) in [("mcap", "a.mcap"), ("rosbag1", "b.bag"), ("realsense", "c.bag")] {
        let whole = scratch.path().join(name);
        if foreign(&tum, format, &whole).is_none() {
            return;
        }
        let bytes = fs::read(&whole).unwrap();
        for share in [0, 1, 30, 60, 99] {
            let cut = scratch.path().join(format!("cut-{share}-{name}"));
            fs::write(&cut, &bytes[..bytes.len() * share / 100]).unwrap();
            let out = scratch.path().join(format!("out-{share}-{name}"));
            let source = text(&cut);
            let recorded = linkage(&["record", "--source", source, "--out", text(&out), "--quiet"]);
            let (status, told) = failure(&recorded);
            assert!(status == 0 || status == 2 && told.contains(source), "{share} %: {told}");
            assert!(!told.contains("panicked"), "{told}");
        }
    }
}

#[test]
fn what_is_recorded_as_mcap_is_read_back_and_by_the_library_of_its_makers() {
    let scratch = tempfile::tempdir().unwrap();
    let bag = scratch.path().join("drawer.mcap");
    let source = demonstration();
    let how = ["--format", "mcap", "--quiet"];
    run(&[&["record", "--source", text(&source), "--out", text(&bag)], &how[..]].concat());
    let (original, frames) = (original(), frames_of(text(&bag)));
    assert_eq!(frames.len(), original.len());
    for (a, b) in original.iter().zip(&frames) {
        assert_eq!(a.utime, b.utime);
        assert_eq!(
            PinholeCamera { depth_units_per_metre: 5000.0, ..(*a.camera).clone() },
            *b.camera
        );
        assert!(a.depth.to_raw(5000.0) == b.depth.to_raw(5000.0), "depth differs");
    }
    assert_alike(&learned_from(text(&bag), scratch.path()), expected(), 0.5, 0.004);
    let Some(python) = python_with(&["mcap_ros2", "rosbags"]) else { return };
    let output = Command::new(python).args(["-c", READER]).arg(&bag).output().unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let camera = &original[0].camera;
    let expected = format!("{} {} {} {:.3}", original.len(), camera.width, "32FC1", camera.fx);
    assert_eq!(told.trim(), expected);
}

/// Reads all with mcap-ros2-support: pictures, columns, encoding of depth, focal length.
const READER: &str = r#"
import sys
from mcap_ros2.reader import read_ros2_messages
count, last = 0, {}
for message in read_ros2_messages(sys.argv[1]):
    count += message.channel.topic.endswith("compressed")
    last[message.channel.topic] = message.ros_msg
depth = last["/camera/aligned_depth_to_color/image_raw"]
info = last["/camera/color/camera_info"]
assert len(depth.data) == depth.step * depth.height
print(count, depth.width, depth.encoding, f"{info.k[0]:.3f}")
"#;

#[test]
fn trajectories_of_parts_are_read_by_evo() {
    let scratch = tempfile::tempdir().unwrap();
    let dir = scratch.path().join("poses");
    let source = demonstration();
    run(&[
        "learn",
        text(&source),
        "--object",
        "drawer",
        "--tum",
        text(&dir),
        "--no-store",
        "--quiet",
    ]);
    let lines = |name: &str| -> Vec<Vec<f64>> {
        let text = fs::read_to_string(dir.join(name)).unwrap();
        let rows = text.lines().filter(|line| !line.starts_with('#'));
        rows.map(|row| row.split(' ').map(|x| x.parse().unwrap()).collect()).collect()
    };
    let (base, part) = (lines("base.txt"), lines("part1.txt"));
    assert!(base.iter().chain(&part).all(|row| row.len() == 8));
    assert!(base.len() > 20 && part.len() > 20, "{} and {} poses", base.len(), part.len());
    // The drawer moves as far as its joint says.
    let from_first = |row: &Vec<f64>| (1..4).map(|k| (row[k] - part[0][k]).powi(2)).sum::<f64>();
    let farthest = part.iter().map(from_first).fold(0.0, f64::max).sqrt();
    let range = expected().range;
    assert!((farthest - (range[1] - range[0])).abs() < 0.01, "{farthest} m of {range:?}");
    let Some(python) = python_with(&["evo"]) else { return };
    let files = [dir.join("base.txt"), dir.join("part1.txt")];
    let output = Command::new(python.with_file_name("evo_traj"))
        .arg("tum")
        .args(&files)
        .env("HOME", scratch.path())
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{told}{}", String::from_utf8_lossy(&output.stderr));
    assert!(told.contains("part1") && told.contains(&format!("{} poses", part.len())), "{told}");
}
