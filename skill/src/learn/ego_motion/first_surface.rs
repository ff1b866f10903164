//! The surface that the first frame shows, as evidence for or against a pose of the camera. Most features may lie on a
//! person or on a door that moves, but most surface of a room is at rest.
//!
//! In: the first frame, a later one, and poses (camera_from_base), metres.
//! Out: how much of the surface the later frame shows where a pose puts it.
//! From: ours.

use crate::learn::free_space::{Probe, probe_point};
use crate::math::rigid::Pose;
use linkage_frames::RgbdFrame;
use nalgebra::Point3;

/// Distance between the places that are compared, pixels.
const STEP_PX: usize = 16;
/// Share of all places by which a pose must have more support than another one to be preferred to it. Measured: by 21
/// to 45 % where most features were on a person or a door; by up to 4 % where the features gave the better pose, which
/// they give more exactly.
const CLEARLY: f64 = 0.1;

/// Fewest places by which poses are compared: with few, single readings decide.
const MIN_PLACES: usize = 100;

/// Places of the first frame that shows enough surface, base frame, metres.
#[derive(Default)]
pub struct FirstSurface(Vec<Point3<f64>>);

impl FirstSurface {
    /// The surface of a frame that was seen at a pose.
    pub fn of(frame: &RgbdFrame, camera_from_base: &Pose) -> Self {
        let grid = |length: usize| (STEP_PX / 2..length).step_by(STEP_PX);
        let rows = grid(frame.camera.height);
        let pixels = rows.flat_map(|v| grid(frame.camera.width).map(move |u| (u, v)));
        let seen = pixels.filter_map(|(u, v)| frame.point_at(u, v));
        Self(seen.map(|in_camera| camera_from_base.inverse_transform_point(&in_camera)).collect())
    }

    /// True if there are too few places to compare poses by.
    pub fn is_little(&self) -> bool {
        self.0.len() < MIN_PLACES
    }

    /// Index of the best pose: a later pose replaces an earlier one only if its support is clearly larger.
    pub fn best_of(&self, frame: &RgbdFrame, poses: &[Pose]) -> usize {
        if self.is_little() {
            return 0;
        }
        let support: Vec<f64> = poses.iter().map(|pose| self.support(frame, pose)).collect();
        best_supported(&support, CLEARLY * self.0.len() as f64)
    }

    /// Number of places that a frame shows, less those that it sees through.
    fn support(&self, frame: &RgbdFrame, camera_from_base: &Pose) -> f64 {
        let worth = |place: &Point3<f64>| match probe_point(frame, &(camera_from_base * place)) {
            Probe::Agrees => 1.0,
            Probe::Through => -1.0,
            Probe::Unknown => 0.0,
        };
        self.0.iter().map(worth).sum()
    }
}

/// Index of the best support: a later one replaces an earlier one only if it is larger by more than `clearly`.
fn best_supported(support: &[f64], clearly: f64) -> usize {
    let better =
        |best: usize, i: usize| if support[i] > support[best] + clearly { i } else { best };
    (1..support.len()).fold(0, better)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};
    use nalgebra::Vector3;

    #[test]
    fn the_pose_from_which_the_room_looks_as_it_does_is_the_best() {
        // A board before a wall; the camera then goes 10 cm back.
        let surface = FirstSurface::of(&seen(0, board(0.3, 1.5, 2.5)), &Pose::identity());
        let later = seen(1, board(0.3, 1.6, 2.6));
        let [right, wrong] = [0.1, 0.0].map(|back| Pose::translation(0.0, 0.0, back));
        assert_eq!(surface.best_of(&later, &[wrong, right]), 1);
        assert_eq!(surface.best_of(&later, &[right, wrong]), 0);
        assert_eq!(surface.best_of(&later, &[wrong, right, right]), 1);
        let turned = Pose::new(Vector3::new(0.0, 0.0, 0.1), 0.15 * Vector3::y());
        assert_eq!(surface.best_of(&later, &[turned, right, wrong]), 1);
    }

    #[test]
    fn poses_that_depth_hardly_discriminates_stay_in_their_order() {
        let wall = |id| seen(id, |_, _| 2.0);
        let surface = FirstSurface::of(&wall(0), &Pose::identity());
        let aside = Pose::translation(0.05, 0.0, 0.0);
        assert_eq!(surface.best_of(&wall(1), &[aside, Pose::identity()]), 0);
        let back = Pose::translation(0.0, 0.0, 0.2);
        let gone = seen(1, |_, _| 2.2);
        assert_eq!(surface.best_of(&gone, &[Pose::identity(), back]), 1);
    }

    #[test]
    fn a_later_pose_needs_clearly_more_support() {
        assert_eq!(best_supported(&[800.0, 850.0, 890.0], 100.0), 0);
        assert_eq!(best_supported(&[600.0, 850.0, 900.0], 100.0), 1);
        assert_eq!(best_supported(&[600.0, 500.0, 900.0], 100.0), 2);
    }

    #[test]
    fn little_surface_decides_nothing() {
        let spot =
            |id, z| seen(id, move |x: f64, y: f64| if x.hypot(y) < 0.1 { z } else { f64::NAN });
        let surface = FirstSurface::of(&spot(0, 2.0), &Pose::identity());
        assert!(surface.is_little());
        let back = Pose::translation(0.0, 0.0, 0.2);
        assert_eq!(surface.best_of(&spot(1, 2.2), &[Pose::identity(), back]), 0);
    }
}
