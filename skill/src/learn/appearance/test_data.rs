//! Test data: a plain drawer, flush in a wall, that is pulled towards the camera.

use super::Demonstration;
use crate::learn::keyframes::Keyframes;
use crate::learn::stage_times::StageTimes;
use crate::learn::tracking::{Observation, Track, TrackId, TrackSet};
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointGeometry;
use crate::object::model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use crate::test_data::{board, seen};
use linkage_frames::RgbdFrame;
use nalgebra::{Point2, Point3, Vector3};

/// Number of frames of a demonstration.
pub const FRAMES: usize = 16;
/// Time between two frames, microseconds.
const FRAME_US: i64 = 100_000;

/// How far the drawer is pulled in a frame, metres: 2 cm a frame.
pub fn pulled(frame: usize) -> f64 {
    0.02 * frame as f64
}

/// The poses of the base and of the drawer, camera_from_part.
pub fn part_poses() -> Vec<Vec<Option<Pose>>> {
    let drawer = |f| Some(Pose::translation(0.0, 0.0, -pulled(f)));
    vec![vec![Some(Pose::identity()); FRAMES], (0..FRAMES).map(drawer).collect()]
}

/// A demonstration of the drawer, with tracks on places at rest, each of a part or of none.
pub fn demonstration(places: &[(Point3<f64>, Option<usize>)]) -> Demonstration {
    let track = |(id, (place, part)): (usize, &(Point3<f64>, Option<usize>))| Track {
        id: TrackId(id),
        first_frame: 0,
        observations: (0..FRAMES)
            .map(|f| {
                let pulled = if *part == Some(1) { pulled(f) } else { 0.0 };
                let here = Point3::new(place.x, place.y, place.z - pulled);
                Observation {
                    pixel: Point2::origin(),
                    point_in_camera: Some(here),
                    normal_in_camera: None,
                }
            })
            .collect(),
    };
    let frame_utimes: Vec<i64> = (0..FRAMES as i64).map(|f| FRAME_US * f).collect();
    Demonstration {
        model: ObjectModel {
            schema: MODEL_SCHEMA.into(),
            object: "drawer".into(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: Vec::new(),
            joints: Vec::new(),
            demonstrations: 1,
            profile: "default".into(),
            version: "0".into(),
        },
        camera_from_part: part_poses(),
        frame_utimes: frame_utimes.clone(),
        tracks: TrackSet { frame_utimes, tracks: places.iter().enumerate().map(track).collect() },
        track_parts: places.iter().map(|(_, part)| *part).collect(),
        plain_surface: vec![Vec::new(); 2],
        keyframes: Keyframes::new(FRAMES),
        rejections: Vec::new(),
        times: StageTimes::default(),
    }
}

/// Points on the drawer's front, some centimetres apart.
pub fn front() -> Vec<(Point3<f64>, Option<usize>)> {
    let at = |i: i32| Point3::new(0.03 * f64::from(i % 4), 0.03 * f64::from(i / 4), 1.5);
    (0..12).map(|i| (at(i), Some(1))).collect()
}

/// The image of a frame.
pub fn picture(frame: usize) -> RgbdFrame {
    seen(FRAME_US * frame as i64, board(0.2, 1.5 - pulled(frame), 1.5))
}

/// The demonstration with its slide, and its pictures as keyframes.
pub fn pulled_out() -> Demonstration {
    let mut whole = demonstration(&front());
    (0..FRAMES).for_each(|f| whole.keyframes.offer(f, &picture(f)));
    let slide = JointGeometry::slide(-Vector3::z_axis(), Point3::new(0.0, 0.0, 1.5));
    let configuration = (0..FRAMES).map(|f| [0.1 * f as f64, pulled(f)]).collect();
    let range = [0.0, pulled(FRAMES - 1)];
    whole.model.parts = vec![Part::new(0, "base", 0), Part::new(1, "part1", 12)];
    whole.model.joints = vec![Joint { configuration, range, ..Joint::of(&slide) }];
    whole
}
