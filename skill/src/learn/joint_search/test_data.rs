//! Test data: a part of few points, seen to move with 2 mm of noise.

use super::screw_joint::ScrewJoint;
use super::tracks_in_part_frame::TracksInFrame;
use crate::learn::ego_motion::{BaseObservation, EgoMotion, Information, TrackInBase};
use nalgebra::{Point3, Vector3};
use std::sync::Arc;

/// A track for each place, seen at each configuration.
pub fn seen_moving(dof: &ScrewJoint, places: &[Point3<f64>], q: &[f64]) -> TracksInFrame {
    let paths: Vec<Vec<Point3<f64>>> =
        places.iter().map(|p| q.iter().map(|&q| dof.move_point(q, p)).collect()).collect();
    TracksInFrame::from_base(&seen_along(&paths), (0..places.len()).collect())
}

/// A track for each path, by a camera that rests.
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
