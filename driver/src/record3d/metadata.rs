//! `metadata` of a recording of Record3D: the sizes of its pictures, the camera and the times of its frames.

use crate::folders::Intrinsics;
use linkage_frames::camera::MAX_PIXELS;
use serde::Deserialize;

/// Frames a second where nothing tells the times.
const ASSUMED_RATE_HZ: f64 = 60.0;
/// Frames a second that can be.
const RATES_HZ: std::ops::RangeInclusive<f64> = 0.1..=1000.0;
/// What the app calls the front camera.
const FRONT_CAMERA: u64 = 0;
/// Largest time, seconds: times count from the first frame.
const MAX_SECONDS: f64 = 1e6;

/// What is told of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Metadata {
    /// Columns and rows of the pictures that the intrinsics belong to.
    pub color_size: (usize, usize),
    /// Columns and rows of depth.
    pub depth_size: (usize, usize),
    /// Of colour, in pixels.
    pub intrinsics: Intrinsics,
    /// It was recorded by the front camera.
    pub is_front_camera: bool,
    /// Times of the frames, microseconds.
    times: Times,
}

/// When frames were taken.
#[derive(Debug, Clone, PartialEq)]
enum Times {
    /// By their numbers, microseconds.
    Told(Vec<i64>),
    /// Frames a second.
    Rate(f64),
    /// Nothing tells it.
    Assumed,
}

/// The JSON, as far as it is read.
#[derive(Deserialize)]
struct File {
    w: usize,
    h: usize,
    dw: Option<usize>,
    dh: Option<usize>,
    fps: Option<f64>,
    /// 3x3, column by column.
    #[serde(rename = "K")]
    k: Vec<f64>,
    /// fx, fy, cx, cy of each frame.
    #[serde(rename = "perFrameIntrinsicCoeffs")]
    of_frames: Option<Vec<Vec<f64>>>,
    /// Seconds.
    #[serde(rename = "frameTimestamps")]
    timestamps: Option<Vec<f64>>,
    #[serde(rename = "cameraType")]
    camera_type: Option<u64>,
}

/// Size of depth where it is not told, columns and rows: that of the LiDAR.
const LIDAR_SIZE: (usize, usize) = (192, 256);

/// Reads the description.
///
/// # Errors
/// What is wrong, in a line.
pub fn parse(text: &[u8]) -> Result<Metadata, String> {
    let file: File =
        serde_json::from_slice(text).map_err(|e| format!("{e}; expected w, h and K"))?;
    let color_size = (file.w, file.h);
    let depth_size = file.dw.zip(file.dh).unwrap_or(LIDAR_SIZE);
    for (what, (width, height)) in [("colour", color_size), ("depth", depth_size)] {
        let pixels = width.checked_mul(height);
        if !pixels.is_some_and(|pixels| (1..=MAX_PIXELS).contains(&pixels)) {
            return Err(format!("{what} of {width}x{height} pixels is not read"));
        }
    }
    let told = file.timestamps.filter(|seconds| !seconds.is_empty());
    let times = match told {
        Some(seconds) => Times::Told(seconds.into_iter().map(utime).collect::<Result<_, _>>()?),
        None => match file.fps {
            Some(fps) if RATES_HZ.contains(&fps) => Times::Rate(fps),
            Some(fps) => return Err(format!("fps: {fps} is no number of frames a second")),
            None => Times::Assumed,
        },
    };
    Ok(Metadata {
        color_size,
        depth_size,
        intrinsics: intrinsics(&file.k, file.of_frames.as_deref().unwrap_or_default())?,
        is_front_camera: file.camera_type == Some(FRONT_CAMERA),
        times,
    })
}

impl Metadata {
    /// When a frame was taken, microseconds; `None` where that is not told.
    pub fn utime(&self, number: u64) -> Option<i64> {
        match &self.times {
            Times::Told(utimes) => utimes.get(usize::try_from(number).ok()?).copied(),
            Times::Rate(hz) => Some(by_rate(number, *hz)),
            Times::Assumed => Some(by_rate(number, ASSUMED_RATE_HZ)),
        }
    }

    /// The rate of the frames where it is assumed, frames a second.
    pub fn assumed_rate_hz(&self) -> Option<f64> {
        (self.times == Times::Assumed).then_some(ASSUMED_RATE_HZ)
    }
}

fn by_rate(number: u64, hz: f64) -> i64 {
    (number as f64 * 1e6 / hz).round() as i64
}

fn utime(seconds: f64) -> Result<i64, String> {
    if !(0.0..=MAX_SECONDS).contains(&seconds) {
        return Err(format!(
            "frameTimestamps: {seconds} is no time in seconds since the beginning"
        ));
    }
    Ok((seconds * 1e6).round() as i64)
}

/// The intrinsics of most frames, which change a little with the focus, or those of all.
fn intrinsics(k: &[f64], of_frames: &[Vec<f64>]) -> Result<Intrinsics, String> {
    let frames: Vec<&[f64; 4]> =
        of_frames.iter().filter_map(|coefficients| coefficients.first_chunk()).collect();
    let [fx, fy, cx, cy] = match (frames.as_slice(), k) {
        ([_, ..], _) => [0, 1, 2, 3].map(|i| median(frames.iter().map(|of| of[i]).collect())),
        ([], [fx, _, _, _, fy, _, cx, cy, _]) => [*fx, *fy, *cx, *cy],
        _ => return Err(format!("K holds {} numbers; a camera's matrix has 3x3", k.len())),
    };
    Ok(Intrinsics { fx, fy, cx, cy, ..Intrinsics::default() })
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(more: &str) -> String {
        format!(r#"{{"w":720,"h":960,"K":[700,0,0,0,710,0,360,480,1]{more}}}"#)
    }

    fn read(more: &str) -> Metadata {
        parse(with(more).as_bytes()).unwrap()
    }

    #[test]
    fn the_matrix_stands_column_by_column() {
        let found = read("").intrinsics;
        assert_eq!([found.fx, found.fy, found.cx, found.cy], [700.0, 710.0, 360.0, 480.0]);
        assert_eq!(read("").depth_size, LIDAR_SIZE);
    }

    #[test]
    fn intrinsics_of_frames_count_more_and_their_median_is_taken() {
        let frames = r#","perFrameIntrinsicCoeffs":[[690,1,2,3],[900,1,2,3],[691,1,2,3]]"#;
        assert_eq!(read(frames).intrinsics.fx, 691.0);
    }

    #[test]
    fn times_are_those_of_the_frames_or_of_a_rate() {
        let told = read(r#","frameTimestamps":[0,0.016,0.033]"#);
        assert_eq!([0, 2, 3].map(|n| told.utime(n)), [Some(0), Some(33_000), None]);
        assert_eq!(read(r#","fps":30"#).utime(3), Some(100_000));
        assert_eq!(read("").utime(6), Some(100_000));
        assert_eq!(read("").assumed_rate_hz(), Some(ASSUMED_RATE_HZ));
        assert_eq!(read(r#","fps":30"#).assumed_rate_hz(), None);
    }

    #[test]
    fn what_cannot_be_is_told() {
        for (more, what) in [
            (r#","dw":0,"dh":4"#, "depth of 0x4"),
            (r#","dw":4294967296,"dh":4294967296"#, "depth of"),
            (r#","fps":0"#, "fps"),
            (r#","frameTimestamps":[1.7e9]"#, "frameTimestamps"),
            (r#","frameTimestamps":[-1]"#, "frameTimestamps"),
        ] {
            let told = parse(with(more).as_bytes()).unwrap_err();
            assert!(told.contains(what), "{more}: {told}");
        }
        assert!(parse(br#"{"w":2,"h":2,"K":[1]}"#).unwrap_err().contains("K holds 1"));
        assert!(parse(b"\xff").unwrap_err().contains("expected w, h and K"));
    }
}
