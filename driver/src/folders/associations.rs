//! Lists of pairs as ORB-SLAM wants them: `timestamp rgb/1.png timestamp depth/1.png`.

use crate::error::SourceError;
use crate::tum::{FramePair, RecordingIndex, TumRecording, read_camera, stamp_utime};
use linkage_frames::camera::PinholeCamera;
use linkage_frames::text_table;
use std::path::Path;
use std::sync::Arc;

/// Opens the folder of a list.
///
/// # Errors
/// [`SourceError::Recording`] names the line that is wrong.
pub fn open_associations(
    list: &Path,
    given: Option<&PinholeCamera>,
) -> Result<TumRecording, SourceError> {
    let broken =
        |reason: String| SourceError::Recording { path: list.display().to_string(), reason };
    let dir = list.parent().unwrap_or(Path::new("."));
    let text = text_table::read(list).map_err(|e| broken(e.to_string()))?;
    let pairs = parse_associations(&text, dir).map_err(broken)?;
    let described = match given {
        Some(camera) => Some(camera.clone()),
        None => read_camera(dir)?,
    };
    let largest_pair_gap_us = pairs.iter().map(|p| p.gap_us).max().unwrap_or(0);
    let index = RecordingIndex {
        is_camera_assumed: described.is_none(),
        camera: Arc::new(described.unwrap_or_else(PinholeCamera::kinect)),
        pairs,
        unpaired: 0,
        largest_pair_gap_us,
    };
    Ok(TumRecording::of_index(dir, index))
}

/// Reads a list's text; pairs come in the order of time. A first row of column names is passed over.
///
/// # Errors
/// What is wrong in which line, and what to do.
pub fn parse_associations(text: &str, dir: &Path) -> Result<Vec<FramePair>, String> {
    let mut pairs: Vec<FramePair> = Vec::new();
    for (i, row) in text_table::rows(text).enumerate() {
        if i == 0 && row.is_header() {
            continue;
        }
        let at = |reason: String| format!("line {}: {reason}", row.number);
        let fields = row.fields();
        let [first_time, first, second_time, second] = fields[..] else {
            return Err(at("expected \"timestamp rgb/1.png timestamp depth/1.png\"".to_owned()));
        };
        let times = [stamp_utime(first_time).map_err(at)?, stamp_utime(second_time).map_err(at)?];
        // Some lists name depth first.
        let is_depth_first = first.contains("depth") && !second.contains("depth");
        let [(utime, color), (depth_utime, depth)] = if is_depth_first {
            [(times[1], second), (times[0], first)]
        } else {
            [(times[0], first), (times[1], second)]
        };
        if pairs.last().is_some_and(|before| utime <= before.utime) {
            return Err(at(format!("time runs backwards at {first_time}; sort the list")));
        }
        let gap_us = (depth_utime - utime).abs();
        pairs.push(FramePair { utime, color: dir.join(color), depth: dir.join(depth), gap_us });
    }
    if pairs.is_empty() {
        return Err("lists no pair: the recording is empty".to_owned());
    }
    Ok(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_and_depth_are_told_apart_in_either_order() {
        let dir = Path::new("desk");
        for text in
            ["# a comment\n1.5 rgb/a.png 1.51 depth/b.png\n", "1.51 depth/b.png 1.5 rgb/a.png\n"]
        {
            let pairs = parse_associations(text, dir).unwrap();
            assert_eq!(pairs[0].color, dir.join("rgb/a.png"), "{text}");
            assert_eq!(pairs[0].depth, dir.join("depth/b.png"), "{text}");
            assert_eq!((pairs[0].utime, pairs[0].gap_us), (1_500_000, 10_000));
        }
    }

    #[test]
    fn a_list_of_any_program_is_read() {
        let dir = Path::new("desk");
        for text in [
            "t_rgb rgb t_depth depth\n1.5 rgb/a.png 1.51 depth/b.png\n",
            "1.5,rgb/a.png,1.51,depth/b.png,\n",
            "1.5 rgb/a.png 1.51 depth/b.png # c\n",
            "1,5;rgb/a.png;1,51;depth/b.png\n",
            "1,5 rgb/a.png 1,51 depth/b.png\n",
        ] {
            let pairs = parse_associations(text, dir).unwrap_or_else(|e| panic!("{text:?}: {e}"));
            let (utime, gap_us) = (1_500_000, 10_000);
            let [color, depth] = ["rgb/a.png", "depth/b.png"].map(|name| dir.join(name));
            assert_eq!(pairs, [FramePair { utime, color, depth, gap_us }], "{text:?}");
        }
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (text, told) in [
            ("", "empty"),
            ("1.5 rgb/a.png\n", "line 1"),
            ("1 rgb/a.png 1 depth/a.png\nx rgb/b.png 2 depth/b.png\n", "line 2: \"x\" is no time"),
            ("2 rgb/a.png 2 depth/a.png\n1 rgb/b.png 1 depth/b.png\n", "line 2: time runs"),
        ] {
            let error = parse_associations(text, Path::new("")).unwrap_err();
            assert!(error.contains(told), "{error}");
        }
    }
}
