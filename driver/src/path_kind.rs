//! What a recording's path is: one look at it decides which reader opens it.

use crate::error::SourceError;
use crate::rosbag2::METADATA_FILE;
use std::path::{Path, PathBuf};

/// The kinds of recordings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PathKind {
    /// A folder in the layout of the TUM RGB-D benchmark: `rgb.txt`, `depth.txt`.
    Tum,
    /// The same with one list of pairs, as ORB-SLAM wants it.
    Associations(PathBuf),
    /// An MCAP file.
    Mcap,
    /// A bag of ROS 1.
    Rosbag1,
    /// A folder that ROS 2 recorded.
    Rosbag2,
    /// A database that ROS 2 recorded.
    Sqlite,
    /// `color/`, `depth/`, and the intrinsics in a JSON file.
    Open3d(PathBuf),
    /// `color/`, `depth/`, `intrinsic/intrinsic_color.txt`.
    ScanNet,
    /// `frame-000000.color.png`, `frame-000000.depth.png`.
    BundleFusion,
    /// `rgb/`, `depth/`, `camera_matrix.csv`.
    StrayScanner,
    /// A `.r3d` file, or what it unpacks to: `metadata`, `rgbd/`.
    Record3d,
}

/// What a folder may hold, for messages.
const LOOKED_FOR: &str = "rgb.txt and depth.txt (TUM), associations.txt (ORB-SLAM), metadata.yaml \
    (ROS 2), color/ and depth/ with intrinsic.json (Open3D) or with intrinsic/intrinsic_color.txt \
    (ScanNet), frame-000000.color.png with frame-000000.depth.png (BundleFusion), camera_matrix.csv \
    (Stray Scanner), metadata and rgbd/ (Record3D)";
/// Names of Open3D's intrinsics.
const JSON_NAMES: [&str; 4] =
    ["intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera_intrinsics.json"];
/// Names of lists of pairs.
const LIST_NAMES: [&str; 5] =
    ["associations.txt", "association.txt", "associate.txt", "associated.txt", "rgbd_assoc.txt"];

/// Looks at a path.
///
/// # Errors
/// [`SourceError::Recording`] lists what was looked for, or tells how to convert what is not read.
pub fn kind_of_path(path: &Path) -> Result<PathKind, SourceError> {
    let refused =
        |reason: String| SourceError::Recording { path: path.display().to_string(), reason };
    if path.is_dir() {
        return kind_of_folder(path).map_err(refused);
    }
    if !path.exists() {
        return Err(refused(format!(
            "no such directory or file; a recording is a directory with {LOOKED_FOR}, or an .mcap, .bag, .db3 or .r3d file"
        )));
    }
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let folder = path.with_extension("");
    let (file, folder) = (path.display(), folder.display());
    match ending.as_deref() {
        Some("mcap") => Ok(PathKind::Mcap),
        Some("bag") => Ok(PathKind::Rosbag1),
        Some("db3") => Ok(PathKind::Sqlite),
        Some("oni") => Err(refused(format!("give it as oni:{file}"))),
        Some("log" | "lcm") => Err(refused(format!("give a log of LCM events as lcmlog:{file}"))),
        Some("mkv") => Err(refused(format!(
            "a recording of Azure Kinect is not read; convert it with Open3D's examples/python/reconstruction_system/sensors/azure_kinect_mkv_reader.py --input {file} --output {folder}, and give {folder}"
        ))),
        Some("r3d") => Ok(PathKind::Record3d),
        Some("mp4" | "avi" | "mov") => Err(refused(
            "a video has no depth; give the folder that holds its depth pictures".to_owned(),
        )),
        _ => Err(refused(format!(
            "is no directory, and its name ends in none of .mcap, .bag, .db3, .r3d; a recording is one of these or a directory with {LOOKED_FOR}"
        ))),
    }
}

fn kind_of_folder(dir: &Path) -> Result<PathKind, String> {
    let is_file = |name: &str| dir.join(name).is_file();
    let is_dir = |name: &str| dir.join(name).is_dir();
    if is_file(METADATA_FILE) {
        return Ok(PathKind::Rosbag2);
    }
    if is_file("rgb.txt") && is_file("depth.txt") {
        return Ok(PathKind::Tum);
    }
    if let Some(list) = LIST_NAMES.into_iter().find(|name| is_file(name)) {
        return Ok(PathKind::Associations(dir.join(list)));
    }
    if is_file("camera_matrix.csv") && is_dir("depth") {
        if is_dir("rgb") {
            return Ok(PathKind::StrayScanner);
        }
        return Err(format!(
            "its colour is a video, which is not read; unpack it with: mkdir {0}/rgb && ffmpeg -i {0}/rgb.mp4 -start_number 0 -vf scale=640:-2 -qscale:v 2 {0}/rgb/%06d.jpg",
            dir.display()
        ));
    }
    if is_dir("depth") && (is_dir("color") || is_dir("rgb") || is_dir("image")) {
        if is_file("intrinsic/intrinsic_color.txt") || is_file("intrinsic/intrinsic_depth.txt") {
            return Ok(PathKind::ScanNet);
        }
        if let Some(json) = JSON_NAMES.into_iter().find(|name| is_file(name)) {
            return Ok(PathKind::Open3d(dir.join(json)));
        }
    }
    if has_frames(dir) {
        return Ok(PathKind::BundleFusion);
    }
    // The reader of the TUM layout names the file that is missing from it.
    if is_file("rgb.txt") || is_file("depth.txt") {
        return Ok(PathKind::Tum);
    }
    if is_file("metadata") && is_dir("rgbd") {
        return Ok(PathKind::Record3d);
    }
    Err(format!("holds no recording that is known; looked for were {LOOKED_FOR}"))
}

/// A folder with `frame-000000.depth.png`, whichever its first number is.
fn has_frames(dir: &Path) -> bool {
    let names = std::fs::read_dir(dir).into_iter().flatten().flatten();
    names
        .filter_map(|entry| entry.file_name().into_string().ok())
        .any(|name| name.starts_with("frame-") && name.ends_with(".depth.png"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder that holds these files and folders.
    fn folder(entries: &[&str]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for entry in entries {
            let path = dir.path().join(entry);
            if entry.ends_with('/') {
                std::fs::create_dir_all(path).unwrap();
            } else {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, "").unwrap();
            }
        }
        dir
    }

    #[test]
    fn each_layout_is_known_by_its_files() {
        for (entries, expected) in [
            (&["rgb.txt", "depth.txt", "associations.txt"][..], PathKind::Tum),
            (&["metadata.yaml", "a.db3"], PathKind::Rosbag2),
            (&["color/", "depth/", "intrinsic/intrinsic_color.txt"], PathKind::ScanNet),
            (&["frame-000007.depth.png", "frame-000007.color.jpg"], PathKind::BundleFusion),
            (&["rgb/", "depth/", "camera_matrix.csv"], PathKind::StrayScanner),
            (&["metadata", "rgbd/"], PathKind::Record3d),
        ] {
            let dir = folder(entries);
            assert_eq!(kind_of_path(dir.path()).unwrap(), expected, "{entries:?}");
        }
        let dir = folder(&["color/", "depth/", "camera_intrinsic.json"]);
        let json = dir.path().join("camera_intrinsic.json");
        assert_eq!(kind_of_path(dir.path()).unwrap(), PathKind::Open3d(json));
        let dir = folder(&["rgb/", "associations.txt"]);
        let list = dir.path().join("associations.txt");
        assert_eq!(kind_of_path(dir.path()).unwrap(), PathKind::Associations(list));
        let dir = folder(&["a.mcap", "b.BAG", "c.db3", "d.r3d"]);
        let kind = |name: &str| kind_of_path(&dir.path().join(name)).unwrap();
        assert_eq!(kind("a.mcap"), PathKind::Mcap);
        assert_eq!(kind("b.BAG"), PathKind::Rosbag1);
        assert_eq!(kind("c.db3"), PathKind::Sqlite);
        assert_eq!(kind("d.r3d"), PathKind::Record3d);
    }

    #[test]
    fn what_is_not_read_is_told_with_what_to_do() {
        let dir = folder(&["a.mkv", "c.txt", "empty/", "stray/camera_matrix.csv", "stray/depth/"]);
        for (name, told) in [
            ("a.mkv", "azure_kinect_mkv_reader.py --input"),
            ("c.txt", "ends in none of"),
            ("empty", "looked for were rgb.txt and depth.txt"),
            ("missing", "no such directory"),
            ("stray", "ffmpeg -i"),
        ] {
            let error = kind_of_path(&dir.path().join(name)).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains(name), "{error}");
        }
    }
}
