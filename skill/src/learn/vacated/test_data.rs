//! Test data: depth pictures of a plain bar that turns before a wall, across the line of sight.

use crate::learn::ego_motion::EgoMotion;
use crate::learn::keyframes::Keyframes;
use crate::learn::recording::Recording;
use crate::learn::tracking::TrackSet;
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointGeometry;
use crate::test_data::seen;
use nalgebra::{Point3, Vector3};

/// Pivot of the bar, camera frame, metres.
pub const PIVOT_M: [f64; 3] = [-0.1, 0.05, 1.2];
/// Length of the bar to one side of the pivot, metres.
const LENGTH_M: f64 = 0.3;
/// Width of the bar, metres.
const WIDTH_M: f64 = 0.06;
/// Distance of the wall behind the bar, metres.
const WALL_M: f64 = 1.6;
/// Distance of a drawer's cabinet, metres.
const CABINET_M: f64 = 1.2;
/// Time between two frames, microseconds.
const FRAME_US: i64 = 100_000;
/// Number of frames of a recording.
pub const FRAMES: usize = 24;

/// Turn of a bar that rests, is turned, and rests again, radians.
pub fn turn(frame: usize) -> f64 {
    0.12 * frame.saturating_sub(7).min(10) as f64
}

/// The line that the bar turns about.
pub fn hinge() -> JointGeometry {
    JointGeometry::hinge(Vector3::z_axis(), Point3::from(PIVOT_M))
}

/// A recording of the bar and of a block elsewhere, with the bar's turn and the middle of the block in each frame.
pub fn recording(
    turn: impl Fn(usize) -> f64,
    block: impl Fn(usize) -> Option<[f64; 2]>,
) -> Recording {
    recorded(|frame| {
        let (turn, block) = (turn(frame), block(frame));
        move |x, y| {
            let at = |z: f64| [z * x, z * y];
            let is_block = block.is_some_and(|[bx, by]| {
                let [px, py] = at(1.1);
                (px - bx).abs() < 0.05 && (py - by).abs() < 0.05
            });
            match (is_block, is_on_bar(at(PIVOT_M[2]), turn)) {
                (true, _) => 1.1,
                (_, true) => PIVOT_M[2],
                _ => WALL_M,
            }
        }
    })
}

/// A recording of a square plate of 12 cm that slides across the line of sight, by its way in each frame, metres.
pub fn slider(way: impl Fn(usize) -> f64) -> Recording {
    recorded(|frame| {
        let middle = way(frame) - 0.15;
        move |x, y| {
            let is_plate = (1.2 * x - middle).abs() < 0.06 && (1.2 * y).abs() < 0.06;
            if is_plate { 1.2 } else { WALL_M }
        }
    })
}

/// A recording of two square plates of 12 cm beside each other that slide upwards across the line of sight, by the
/// way of each in each frame, metres.
pub fn two_sliders(ways: impl Fn(usize) -> [f64; 2]) -> Recording {
    recorded(|frame| {
        let ways = ways(frame);
        move |x, y| {
            let is_plate = |(middle, way): (f64, f64)| {
                (1.2 * x - middle).abs() < 0.06 && (1.2 * y + way).abs() < 0.06
            };
            if [-0.065, 0.065].into_iter().zip(ways).any(is_plate) { 1.2 } else { WALL_M }
        }
    })
}

/// A recording of a front of 40 by 16 cm, 30 cm below the camera, that comes forwards out of a cabinet, by its
/// way in each frame, metres, with a hand that comes to it first. The cabinet reaches `beside` metres beyond the
/// front to all sides; above the front its opening is seen.
pub fn drawer(way: impl Fn(usize) -> f64, beside: f64) -> Recording {
    recorded(|frame| {
        let front = CABINET_M - way(frame);
        let hand_x = 0.35 - 0.07 * frame.min(5) as f64;
        move |x, y| {
            let hand = front - 0.06;
            if (hand * x - hand_x).abs() < 0.03 && (hand * y - 0.3).abs() < 0.03 {
                return hand;
            }
            let within =
                |z: f64, more: f64| (z * x).abs() < 0.2 + more && (z * y - 0.3).abs() < 0.08 + more;
            match (within(front, 0.0), within(CABINET_M, 0.0), within(CABINET_M, beside)) {
                (true, ..) => front,
                (_, true, _) => CABINET_M + 0.35,
                (_, _, true) => CABINET_M + 0.01,
                _ => CABINET_M + 0.4,
            }
        }
    })
}

/// Height of a tray's bottom in the camera frame, metres: below the camera.
pub const TRAY_BOTTOM_M: f64 = 0.22;

/// A recording of a front of 40 by 16 cm, 30 cm below the camera, that comes forwards out of a cabinet by its way in
/// each frame, metres. Behind it comes a tray's bottom, level with the front's upper edge.
pub fn tray(way: impl Fn(usize) -> f64) -> Recording {
    recorded(|frame| {
        let front = CABINET_M - way(frame);
        move |x, y| {
            let on_bottom = TRAY_BOTTOM_M / y;
            let is_front = (front * x).abs() < 0.2 && (front * y - 0.3).abs() < 0.08;
            let is_bottom = (front..CABINET_M).contains(&on_bottom) && (on_bottom * x).abs() < 0.2;
            match (is_front, is_bottom) {
                (true, _) => front,
                (_, true) => on_bottom,
                _ => CABINET_M + 0.01,
            }
        }
    })
}

/// Thickness of a flap, metres: between two of those that are tried.
pub const FLAP_M: f64 = 0.03;

/// A recording of a flap of 30 by 25 cm that stands upright, facing the camera, and turns down towards it, by its turn
/// in each frame, radians: beyond a quarter it shows its other face, [`FLAP_M`] behind the first.
pub fn flap(turn: impl Fn(usize) -> f64) -> Recording {
    let foot = Vector3::new(0.0, 0.05, 1.3);
    recorded(|frame| {
        let (sin, cos) = turn(frame).sin_cos();
        let (up, normal) = (Vector3::new(0.0, -cos, -sin), Vector3::new(0.0, sin, -cos));
        move |x, y| {
            let ray = Vector3::new(x, y, 1.0);
            let face = |behind: f64| {
                let z = (normal.dot(&foot) - behind) / normal.dot(&ray);
                let from_foot = z * ray - foot;
                let is_on_it =
                    from_foot.x.abs() < 0.15 && (0.0..0.25).contains(&up.dot(&from_foot));
                if z > 0.0 && is_on_it { z } else { WALL_M }
            };
            face(0.0).min(face(FLAP_M)).min(WALL_M)
        }
    })
}

/// A recording by the depth along each ray, in each frame.
fn recorded<D: Fn(f64, f64) -> f64>(depth: impl Fn(usize) -> D) -> Recording {
    let mut keyframes = Keyframes::new(FRAMES);
    for frame in 0..FRAMES {
        keyframes.offer(frame, &seen(FRAME_US * frame as i64, depth(frame)));
    }
    let camera_from_base = vec![Pose::identity(); FRAMES];
    let ego_motion = EgoMotion { camera_from_base, ..EgoMotion::default() };
    let frame_utimes = (0..FRAMES as i64).map(|frame| FRAME_US * frame).collect();
    let tracks = TrackSet { frame_utimes, tracks: Vec::new() };
    Recording { tracks, ego_motion, keyframes }
}

/// A recording of the bar alone, with its turn in each frame.
pub fn lever(turn: impl Fn(usize) -> f64) -> Recording {
    recording(turn, |_| None)
}

/// A recording of the bar alone, by its turn and by how many metres it comes nearer to the camera in each frame.
pub fn swaying(turn: impl Fn(usize) -> f64, nearer: impl Fn(usize) -> f64) -> Recording {
    recorded(|frame| {
        let (turn, z) = (turn(frame), PIVOT_M[2] - nearer(frame));
        move |x, y| if is_on_bar([z * x, z * y], turn) { z } else { WALL_M }
    })
}

/// A recording of the bar beside a post that reaches to its pivot, and of a block elsewhere: by the bar's turn, by how
/// many metres the post comes nearer to the camera, and by the middle of the block in each frame.
pub fn bar_on_post(
    turn: impl Fn(usize) -> f64,
    nearer: impl Fn(usize) -> f64,
    block: impl Fn(usize) -> Option<[f64; 2]>,
) -> Recording {
    recorded(|frame| {
        let (turn, block, post) = (turn(frame), block(frame), PIVOT_M[2] - nearer(frame));
        move |x, y| {
            let right = post * x - PIVOT_M[0];
            let is_post = (-0.2..-0.5 * WIDTH_M).contains(&right) && (post * y).abs() < 0.2;
            let is_block = block
                .is_some_and(|[bx, by]| (1.1 * x - bx).abs() < 0.05 && (1.1 * y - by).abs() < 0.05);
            match (is_block, is_on_bar([PIVOT_M[2] * x, PIVOT_M[2] * y], turn), is_post) {
                (true, ..) => 1.1,
                (_, true, _) => PIVOT_M[2],
                (_, _, true) => post,
                _ => WALL_M,
            }
        }
    })
}

/// True if a place across the line of sight is on the bar at this turn.
fn is_on_bar([x, y]: [f64; 2], turn: f64) -> bool {
    let [dx, dy] = [x - PIVOT_M[0], y - PIVOT_M[1]];
    let along = turn.cos() * dx + turn.sin() * dy;
    let across = turn.cos() * dy - turn.sin() * dx;
    (-0.5 * WIDTH_M..LENGTH_M).contains(&along) && across.abs() < 0.5 * WIDTH_M
}
