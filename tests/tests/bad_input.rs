//! Bad input gets one clear line that names the file and what to do, exit status 2 (or 1
//! where the input allows no answer), and loses nothing.

use linkage_driver::{ColorImage, PinholeCamera, image_file};
use linkage_tests::{failure, linkage, shared_data, tiny_recording};
use std::fmt::Write as _;
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
        image_file::write_depth(&d.join("depth/2.png"), 32, 24, &[5000; 32 * 24]).unwrap();
    });
    assert_says(&result, 2, &["depth/2.png", "depth is 32x24", "64x48"]);
}

/// A PNG of a few bytes that claims this many pixels.
fn claiming_png(width: u32, height: u32) -> Vec<u8> {
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    png.extend(width.to_be_bytes());
    png.extend(height.to_be_bytes());
    png.extend([8, 2, 0, 0, 0]);
    // The checksum of the header, bit by bit.
    let checksum = png[12..].iter().fold(u32::MAX, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |c, _| (c >> 1) ^ (0xedb8_8320 & (c & 1).wrapping_neg()))
    });
    png.extend((!checksum).to_be_bytes());
    png.extend(b"\0\0\0\x09IDAT\x78\x9c\x63\0\0\0\x01\0\x01\0\0\0\0");
    png
}

#[test]
fn a_picture_that_claims_more_pixels_than_the_camera_has() {
    for (width, height) in [(100_000, 100_000), (8000, 6000), (0, 48), (48, 64)] {
        let result = learn_from_broken(|d| {
            std::fs::write(d.join("rgb/3.png"), claiming_png(width, height)).unwrap();
        });
        let told = if width == 0 { "damaged PNG".to_owned() } else { format!("{width}x{height}") };
        assert_says(&result, 2, &["rgb/3.png", &told]);
    }
}

#[test]
fn a_picture_that_is_a_folder_or_a_pipe() {
    for make in ["mkdir", "mkfifo"] {
        let result = learn_from_broken(|d| {
            let path = d.join("rgb/3.png");
            std::fs::remove_file(&path).unwrap();
            assert!(std::process::Command::new(make).arg(&path).status().unwrap().success());
        });
        assert_says(&result, 2, &["rgb.txt", "line 4", "rgb/3.png", "no regular file"]);
    }
}

#[test]
fn a_camera_of_more_pixels_than_any_has() {
    for (width, height) in [("1000000", "1000000"), ("8000", "6000"), ("0", "48")] {
        let result = learn_from_broken(|d| {
            rewrite(&d.join("camera.toml"), |t| {
                let t = t.replace("width = 64", &format!("width = {width}"));
                t.replace("height = 48", &format!("height = {height}"))
            });
        });
        let told = if width == "0" { "above 0" } else { "shrink the pictures" };
        assert_says(&result, 2, &["camera.toml", "width", told]);
    }
}

#[test]
fn a_camera_that_cannot_be() {
    for (line, instead, told) in [
        ("fx = 52.5", "fx = 0.8", "fx"),
        ("fy = 52.5", "fy = 52500.0", "fy"),
        ("cx = 31.5", "cx = 0.5", "cx"),
        ("cy = 23.5", "cy = -23.5", "cy"),
        ("depth_units_per_metre = 5000.0", "depth_units_per_metre = 0.001", "1000 for millimetres"),
        ("depth_units_per_metre = 5000.0", "depth_units_per_metre = nan", "depth_units_per_metre"),
        ("fx = 52.5", "fx = 52.5\ndistortion = [0.1, 0.2, 0.3]", "3 values"),
        ("fx = 52.5", "fx = 52.5\ndistortion = [-9.0, 0.0, 0.0, 0.0, 0.0]", "cannot be undone"),
    ] {
        let result = learn_from_broken(|d| {
            rewrite(&d.join("camera.toml"), |t| t.replace(line, instead));
        });
        assert_says(&result, 2, &["camera.toml", told]);
    }
}

#[test]
fn eight_values_of_distortion_are_the_rational_model() {
    let Some(case) = shared_data("cases/07-eight-distortion-values") else { return };
    let camera = PinholeCamera::read(&case.join("camera.toml")).unwrap();
    assert_eq!(camera.distortion[4..], [1.5, 0.33, -2.4, 1.43]);
    let plain = PinholeCamera { distortion: [0.0; 8], ..camera.clone() };
    let first_five = PinholeCamera {
        distortion: std::array::from_fn(|i| if i < 5 { camera.distortion[i] } else { 0.0 }),
        ..camera.clone()
    };
    // The whole model bends a corner a little, its first five values alone very much.
    let corner = plain.back_project(0.0, 0.0, 1.0);
    let moved = |by: &PinholeCamera| {
        (by.project(&corner).unwrap() - plain.project(&corner).unwrap()).norm()
    };
    assert!(moved(&camera) < 15.0, "{}", moved(&camera));
    assert!(moved(&first_five) > 30.0, "{}", moved(&first_five));
}

#[test]
fn lists_of_any_program_are_read_alike() {
    let latin_1 = |text: &str| text.chars().map(|c| c as u8).collect::<Vec<u8>>();
    let write = |change: &dyn Fn(String) -> Vec<u8>| {
        let dir = tempfile::tempdir().unwrap();
        tiny_recording(dir.path());
        for name in ["rgb.txt", "depth.txt", "camera.toml"] {
            let path = dir.path().join(name);
            std::fs::write(&path, change(std::fs::read_to_string(&path).unwrap())).unwrap();
        }
        let mut source = linkage_driver::open(&dir.path().display().to_string()).unwrap();
        std::iter::from_fn(|| source.next_frame().unwrap()).count()
    };
    assert_eq!(write(&|t| format!("\u{feff}{t}").into_bytes()), 12, "a byte order mark");
    assert_eq!(write(&|t| t.replace('\n', "\r\n").into_bytes()), 12, "lines of Windows");
    assert_eq!(write(&|t| latin_1(&format!("# caf\u{e9}, 20 \u{b0}C\n{t}"))), 12, "Latin-1");
    let utf_16 = |t: String| {
        let units = format!("\u{feff}{t}").encode_utf16().collect::<Vec<u16>>();
        units.into_iter().flat_map(u16::to_le_bytes).collect()
    };
    assert_eq!(write(&utf_16), 12, "UTF-16");
    for comment in ["% t name", "; t name", "// t name", "timestamp filename"] {
        let dir = tempfile::tempdir().unwrap();
        tiny_recording(dir.path());
        for name in ["rgb.txt", "depth.txt"] {
            rewrite(&dir.path().join(name), |t| {
                format!(
                    "{comment}\n{}",
                    t.replace(".0 ", if name == "rgb.txt" { ".0, " } else { ".0;" })
                )
            });
        }
        let mut source = linkage_driver::open(&dir.path().display().to_string()).unwrap();
        assert_eq!(std::iter::from_fn(|| source.next_frame().unwrap()).count(), 12, "{comment}");
    }
}

#[test]
fn stamps_that_are_no_seconds() {
    for (factor, told) in [(1e3, "apart"), (1e9, "apart")] {
        let result = learn_from_broken(|d| {
            for name in ["rgb", "depth"] {
                let line = |i: u32| format!("{} {name}/{i}.png\n", f64::from(i) * 0.033 * factor);
                let list: String = (0..12).map(line).collect();
                std::fs::write(d.join(format!("{name}.txt")), list).unwrap();
            }
        });
        assert_says(&result, 2, &["rgb.txt", told, "write them in seconds"]);
    }
    let result = learn_from_broken(|d| {
        rewrite(&d.join("rgb.txt"), |t| t.replace("14.0 rgb", "1305031102175304000 rgb"));
    });
    assert_says(&result, 2, &["rgb.txt", "line 5", "nanoseconds"]);
}

/// A recording as large as a Kinect's, of a wall at this many raw units, without `camera.toml`.
fn wall_of_raw_depth(dir: &Path, raw: u16) {
    for folder in ["rgb", "depth"] {
        std::fs::create_dir_all(dir.join(folder)).unwrap();
    }
    let (mut rgb, mut depth) = (String::new(), String::new());
    for i in 0..3 {
        let color = ColorImage::new(640, 480, vec![90; 640 * 480 * 3]).unwrap();
        image_file::write_color(&dir.join(format!("rgb/{i}.png")), &color).unwrap();
        image_file::write_depth(&dir.join(format!("depth/{i}.png")), 640, 480, &[raw; 640 * 480])
            .unwrap();
        let _ = writeln!(rgb, "{i}.0 rgb/{i}.png");
        let _ = writeln!(depth, "{i}.0 depth/{i}.png");
    }
    std::fs::write(dir.join("rgb.txt"), rgb).unwrap();
    std::fs::write(dir.join("depth.txt"), depth).unwrap();
}

#[test]
fn millimetres_at_units_that_are_assumed() {
    let dir = tempfile::tempdir().unwrap();
    wall_of_raw_depth(dir.path(), 950);
    let source = dir.path().display().to_string();
    let result = failure(&linkage(&["learn", &source, "--object", "thing", "--quiet"]));
    let words = ["camera.toml", "0.19 m", "5000 units", "at 1000 units", "depth_units_per_metre"];
    assert_says(&result, 2, &words);
    // What is assumed is told with its numbers.
    assert_says(&result, 2, &["640x480", "fx 525", "cx 319.5", "5000 depth units"]);
}

#[test]
fn an_odd_scale_that_is_given_is_told() {
    let result = learn_from_broken(|d| {
        for i in 0..12 {
            let path = d.join(format!("depth/{i}.png"));
            image_file::write_depth(&path, 64, 48, &[950; 64 * 48]).unwrap();
        }
    });
    let words = ["0.19 m", "5000 units", "at 1000 units", "is depth_units_per_metre right?"];
    assert_says(&result, 1, &words);
}

#[test]
fn depth_that_is_zero_everywhere() {
    let result = learn_from_broken(|d| {
        for i in 0..12 {
            let path = d.join(format!("depth/{i}.png"));
            image_file::write_depth(&path, 64, 48, &[0; 64 * 48]).unwrap();
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
    let refused = |text: &str| {
        std::fs::write(&file, text).unwrap();
        failure(&linkage(&["config", "dump", "--config", &file.display().to_string()]))
    };
    let unknown = refused("[track]\nmax_feature = 5\n");
    assert_says(&unknown, 2, &["mine.toml", "did you mean \"track.max_features\""]);
    let former = refused("[joints]\nmax_cost = 3.0\n");
    assert_says(&former, 2, &["mine.toml", "\"joints.max_cost\" is a constant"]);
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
