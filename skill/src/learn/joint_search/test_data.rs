//! Test data: a part of few points, seen to move with 2 mm of noise; a drawer that is opened.

use super::config::{JointSearchConfig, SearchSettings};
use super::estimate::JointEstimate;
use super::screw_joint::ScrewJoint;
use super::search_state::SearchState;
use super::tracks_in_part_frame::TracksInFrame;
use super::warm_start::WarmStart;
use crate::learn::ego_motion::{BaseObservation, EgoMotion, Information, TrackInBase};
use crate::learn::keyframes::Keyframes;
use crate::learn::recording::Recording;
use crate::learn::tracking::{Track, TrackId, TrackSet};
use crate::test_data::{board, seen};
use nalgebra::{Point3, Vector3};
use std::sync::Arc;

/// View of one track for each place, seen at each configuration.
pub fn seen_moving(dof: &ScrewJoint, places: &[Point3<f64>], q: &[f64]) -> TracksInFrame {
    let paths: Vec<Vec<Point3<f64>>> =
        places.iter().map(|p| q.iter().map(|&q| dof.move_point(q, p)).collect()).collect();
    TracksInFrame::from_base(&seen_along(&paths), (0..places.len()).collect())
}

/// One track for each path, seen by a camera that rests.
pub fn seen_along(paths: &[Vec<Point3<f64>>]) -> EgoMotion {
    let mut state = 1_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        0.004 * (f64::from(state >> 8) / f64::from(1 << 24) - 0.5)
    };
    let mut seen = |place: &Point3<f64>| {
        let precision = Information::new(&Vector3::z(), 0.002, 0.002);
        BaseObservation::new(place + Vector3::from_fn(|_, _| noise()), precision, 0.002)
    };
    let tracks = paths
        .iter()
        .map(|path| {
            let points = path.iter().map(|place| Some(seen(place))).collect();
            Arc::new(TrackInBase { moves: true, points, ..TrackInBase::default() })
        })
        .collect();
    let camera_from_base = vec![Default::default(); paths.first().map_or(0, Vec::len)];
    EgoMotion { camera_from_base, tracks, static_count: 0 }
}

/// Number of frames of the drawer's recording.
pub const FRAMES: usize = 60;
/// Number of tracks on the drawer's front.
pub const ON_FRONT: usize = 60;

/// Depth of a drawer's front, metres: it rests, comes nearer by 30 cm in 30 frames, and rests.
pub fn front(f: usize) -> f64 {
    1.5 - 0.01 * (f.clamp(15, 45) - 15) as f64
}

/// Recording of the tracks on the front, with depth images of a board at depth `board_at` before a
/// wall.
pub fn drawer_recording(board_at: impl Fn(usize) -> f64) -> Recording {
    recording_of(front_paths(), board_at)
}

/// Paths of the places on the front.
pub fn front_paths() -> Vec<Vec<Point3<f64>>> {
    let path = |i: usize| -> Vec<Point3<f64>> {
        let (x, y) = (0.03 * (i % 10) as f64 - 0.135, 0.03 * (i / 10) as f64 - 0.075);
        (0..FRAMES).map(|f| Point3::new(x, y, front(f))).collect()
    };
    (0..ON_FRONT).map(path).collect()
}

/// Recording of one track for each path, with depth images of a board at depth `board_at` before a
/// wall.
pub fn recording_of(paths: Vec<Vec<Point3<f64>>>, board_at: impl Fn(usize) -> f64) -> Recording {
    let mut keyframes = Keyframes::new(FRAMES);
    for f in (0..FRAMES).step_by(3) {
        keyframes.offer(f, &seen(f as i64, board(0.2, board_at(f), 2.5)));
    }
    let track = |id| Track { id: TrackId(id), first_frame: 0, observations: Vec::new() };
    let tracks = (0..paths.len()).map(track).collect();
    let tracks = TrackSet { frame_utimes: (0..FRAMES as i64).collect(), tracks };
    Recording { tracks, ego_motion: seen_along(&paths), keyframes }
}

/// Calls `look` with a search after the last frame that has found nothing yet.
pub fn with_search<T>(
    recording: &Recording,
    config: &JointSearchConfig,
    earlier: &WarmStart,
    look: impl FnOnce(&mut SearchState) -> T,
) -> T {
    let settings = SearchSettings { joints: config, seed: 1 };
    let moving = Arc::new(TracksInFrame::moving(&recording.ego_motion));
    look(&mut SearchState::new(recording, settings, &moving, earlier, None))
}

/// The drawer as a joint that the tracks of its front follow, known in some frames.
pub fn drawer(view: &TracksInFrame, known: impl Fn(usize) -> bool) -> JointEstimate {
    let mut joint = JointEstimate::new(ScrewJoint::slide(-Vector3::z(), Point3::origin()), view, 0);
    joint.q = (0..FRAMES).map(|f| 1.5 - front(f)).collect();
    joint.known = (0..FRAMES).map(known).collect();
    joint.points = (0..view.len())
        .map(|t| view.at(t, 0).map_or_else(Point3::origin, |seen| seen.point))
        .collect();
    joint.members = (0..ON_FRONT).collect();
    (joint.gain, joint.cost) = (5000.0, 1.0);
    joint.summarise();
    joint
}
