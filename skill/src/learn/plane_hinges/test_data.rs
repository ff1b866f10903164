//! Test data: depth pictures of a plain door.

use crate::learn::ego_motion::EgoMotion;
use crate::learn::keyframes::Keyframes;
use crate::learn::recording::Recording;
use crate::learn::tracking::TrackSet;
use crate::math::rigid::Pose;
use crate::test_data::seen;
use linkage_frames::{DepthImage, RgbdFrame};
use std::f64::consts::FRAC_PI_2;

/// Width of the door, metres.
pub const WIDTH_M: f64 = 0.6;
/// Place of the door's hinge: vertical, at this x and z in the camera frame, metres.
pub const HINGE_M: [f64; 2] = [-0.3, 2.0];

/// Turn of a door that rests, is opened, and rests again, radians.
pub fn turn(frame: usize) -> f64 {
    0.13 * frame.saturating_sub(6).min(10) as f64
}

/// A plain door in the front of a plain cupboard, open by `turn`. The cupboard's front goes from border
/// to border of the picture if it is not `pulled`; else it is 1.2 m wide and stands that far nearer to
/// the camera, before a wall.
fn door(turn: f64, pulled: Option<f64>) -> RgbdFrame {
    let shift = pulled.unwrap_or(0.0);
    let (hinge, arm) = ([HINGE_M[0], HINGE_M[1] - shift], [turn.cos(), -turn.sin()]);
    seen(0, |x, y| {
        let normal = [turn.sin(), turn.cos()];
        let z = (normal[0] * hinge[0] + normal[1] * hinge[1]) / (normal[0] * x + normal[1]);
        let along = arm[0] * (z * x - hinge[0]) + arm[1] * (z - hinge[1]);
        let is_door = z > 0.0 && (0.0..WIDTH_M).contains(&along) && (z * y).abs() < 0.5;
        let front = hinge[1];
        let is_opening = (front * x).abs() < 0.3 && (front * y).abs() < 0.5;
        let is_front = pulled.is_none() || (front * x).abs() < 0.6 && (front * y).abs() < 0.6;
        let behind = match (is_front, is_opening) {
            (true, true) => front + 0.6,
            (true, false) => front,
            (false, _) => 3.2,
        };
        if is_door { z.min(behind) } else { behind }
    })
}

/// A recording of the door in a front, with the door's turn in each frame. All frames are kept.
pub fn door_recording(frames: usize, turn: impl Fn(usize) -> f64) -> Recording {
    recording((0..frames).map(|f| door(turn(f), None)).collect())
}

/// Turn at which the camera sees the door from its edge, radians.
pub fn edge_on_rad() -> f64 {
    FRAC_PI_2 + (HINGE_M[0] / HINGE_M[1]).atan()
}

/// A recording of the door that is opened until the camera sees its edge, of which there is no depth, and is left so
/// from frame 16 on.
pub fn left_edge_on_recording(frames: usize) -> Recording {
    let of = |frame: usize| {
        let mut picture = door(edge_on_rad() / turn(16) * turn(frame), None);
        let (width, height) = (picture.depth.width(), picture.depth.height());
        let edge = picture.camera.cx + picture.camera.fx * HINGE_M[0] / HINGE_M[1];
        let is_edge = |i: usize| frame >= 16 && ((i % width) as f64 - edge).abs() < 9.0;
        let metres = picture.depth.as_metres().iter().enumerate();
        let left = metres.map(|(i, z)| if is_edge(i) { f32::NAN } else { *z }).collect();
        picture.depth = DepthImage::from_metres(width, height, left).expect("it fits");
        picture
    };
    recording((0..frames).map(of).collect())
}

/// A recording of the door of a cupboard that is pulled forwards, with the turn and the shift in each frame.
pub fn pulled_door_recording(
    frames: usize,
    turn: impl Fn(usize) -> f64,
    pulled: impl Fn(usize) -> f64,
) -> Recording {
    recording((0..frames).map(|f| door(turn(f), Some(pulled(f)))).collect())
}

fn recording(pictures: Vec<RgbdFrame>) -> Recording {
    let frames = pictures.len();
    let mut keyframes = Keyframes::new(frames);
    pictures.iter().enumerate().for_each(|(f, picture)| keyframes.offer(f, picture));
    let camera_from_base = vec![Pose::identity(); frames];
    let ego_motion = EgoMotion { camera_from_base, ..EgoMotion::default() };
    let frame_utimes = (0..frames as i64).map(|f| 100_000 * f).collect();
    let tracks = TrackSet { frame_utimes, tracks: Vec::new() };
    Recording { tracks, ego_motion, keyframes }
}
