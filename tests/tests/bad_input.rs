//! Bad input gets one clear line that names the file and what to do, exit status 2 (or 1
//! where the input allows no answer), and loses nothing.

use linkage_tests::{failure, linkage, tiny_recording};
use std::path::Path;

/// Breaks a tiny recording, learns from it, and gives status and message.
fn learn_from_broken(break_it: impl Fn(&Path)) -> (i32, String) {
    let dir = tempfile::tempdir().unwrap();
    tiny_recording(dir.path());
    break_it(dir.path());
    let source = dir.path().display().to_string();
    failure(&linkage(&["learn", &source, "--object", "thing", "--quiet"]))
}

fn rewrite(path: &Path, change: impl Fn(String) -> String) {
    std::fs::write(path, change(std::fs::read_to_string(path).unwrap())).unwrap();
}

fn assert_says(result: &(i32, String), status: i32, words: &[&str]) {
    assert_eq!(result.0, status, "{}", result.1);
    for word in words {
        assert!(result.1.contains(word), "\"{word}\" is missing in: {}", result.1);
    }
    assert!(!result.1.contains("panicked"), "{}", result.1);
}

#[test]
fn a_missing_directory() {
    let output = linkage(&["learn", "/nowhere/at/all", "--object", "x", "--quiet"]);
    assert_says(&failure(&output), 2, &["/nowhere/at/all", "no such directory"]);
}

#[test]
fn an_empty_recording() {
    let result = learn_from_broken(|d| std::fs::write(d.join("rgb.txt"), "# nothing\n").unwrap());
    assert_says(&result, 2, &["rgb.txt", "empty"]);
}

#[test]
fn a_truncated_png() {
    let result = learn_from_broken(|d| {
        let path = d.join("rgb/5.png");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    });
    assert_says(&result, 2, &["rgb/5.png", "damaged PNG"]);
}

#[test]
fn a_list_that_names_a_missing_file() {
    let result = learn_from_broken(|d| std::fs::remove_file(d.join("rgb/3.png")).unwrap());
    assert_says(&result, 2, &["rgb.txt", "line 4", "rgb/3.png", "does not exist"]);
}

#[test]
fn depth_of_another_size_than_colour() {
    let result = learn_from_broken(|d| {
        linkage_driver::image_file::write_depth(&d.join("depth/2.png"), 32, 24, &[5000; 32 * 24])
            .unwrap();
    });
    assert_says(&result, 2, &["depth/2.png", "depth is 32x24", "64x48"]);
}

#[test]
fn depth_that_is_zero_everywhere() {
    let result = learn_from_broken(|d| {
        for i in 0..12 {
            let path = d.join(format!("depth/{i}.png"));
            linkage_driver::image_file::write_depth(&path, 64, 48, &[0; 64 * 48]).unwrap();
        }
    });
    assert_says(&result, 1, &["no frame has depth"]);
}

#[test]
fn a_focal_length_of_zero() {
    let result = learn_from_broken(|d| {
        rewrite(&d.join("camera.toml"), |t| t.replace("fx = 52.5", "fx = 0"));
    });
    assert_says(&result, 2, &["camera.toml", "fx"]);
}

#[test]
fn an_unknown_key_of_the_camera() {
    let result = learn_from_broken(|d| {
        rewrite(&d.join("camera.toml"), |t| t + "focal = 3.0\n");
    });
    assert_says(&result, 2, &["camera.toml", "focal"]);
}

#[test]
fn time_running_backwards() {
    let result = learn_from_broken(|d| {
        rewrite(&d.join("rgb.txt"), |t| t.replace("14.0 rgb", "12.5 rgb"));
    });
    assert_says(&result, 2, &["rgb.txt", "line 5", "time runs backwards"]);
}

#[test]
fn nan_in_a_pose_log() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("door.log");
    std::fs::write(&log, "0 0 0\n0.1 NaN 0\n").unwrap();
    let output = linkage(&["fit", &log.display().to_string()]);
    assert_says(&failure(&output), 2, &["door.log", "line 2", "NaN"]);
}

#[test]
fn a_log_too_short_to_fit() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("short.log");
    std::fs::write(&log, "0 0 0\n0.1 0 0\n").unwrap();
    let output = linkage(&["fit", &log.display().to_string()]);
    assert_says(&failure(&output), 2, &["short.log", "2 samples"]);
}

#[test]
fn a_store_that_is_no_store() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("notes.txt");
    std::fs::write(&path, "dear diary, ".repeat(200)).unwrap();
    let output = linkage(&["store", "list", "--store", &path.display().to_string()]);
    assert_says(&failure(&output), 2, &["notes.txt", "not a Linkage store"]);
}

#[test]
fn a_store_that_is_missing() {
    let output = linkage(&["store", "list", "--store", "/nowhere/objects.linkage"]);
    assert_says(&failure(&output), 2, &["/nowhere/objects.linkage", "no such store"]);
}

#[test]
fn a_target_that_is_none() {
    let output = linkage(&["predict", "/nowhere", "--to", "ajar"]);
    assert_says(&failure(&output), 2, &["\"ajar\"", "open, closed or a number"]);
}

#[test]
fn an_unknown_profile_and_an_unknown_key() {
    let output = linkage(&["config", "dump", "--profile", "fast"]);
    assert_says(&failure(&output), 2, &["\"fast\"", "paper"]);
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mine.toml");
    std::fs::write(&file, "[track]\nmax_feature = 5\n").unwrap();
    let output = linkage(&["config", "dump", "--config", &file.display().to_string()]);
    assert_says(
        &failure(&output),
        2,
        &["mine.toml", "max_feature", "did you mean \"max_features\""],
    );
}

#[test]
fn an_unknown_scene_and_a_full_disk() {
    let output = linkage(&["simulate", "--scene", "volcano", "--out", "/tmp/x"]);
    assert_says(&failure(&output), 2, &["volcano", "fridge"]);
    let log = tempfile::NamedTempFile::new().unwrap();
    let lines: String = (0..20).map(|i| format!("{} 0 0\n", f64::from(i) * 0.01)).collect();
    std::fs::write(log.path(), lines).unwrap();
    let log = log.path().display().to_string();
    let output = linkage(&["fit", &log, "--json", "/proc/nothing/here.json", "--quiet"]);
    assert_says(&failure(&output), 2, &["/proc/nothing/here.json", "cannot be written"]);
}
