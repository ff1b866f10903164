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

/// Places of the first frame, base frame, metres.
#[derive(Default)]
pub struct FirstSurface(Vec<Point3<f64>>);

impl FirstSurface {
    /// The surface of a frame, whose camera frame is the base frame.
    pub fn of(frame: &RgbdFrame) -> Self {
        let grid = |length: usize| (STEP_PX / 2..length).step_by(STEP_PX);
        let rows = grid(frame.camera.height);
        let pixels = rows.flat_map(|v| grid(frame.camera.width).map(move |u| (u, v)));
        Self(pixels.filter_map(|(u, v)| frame.point_at(u, v)).collect())
    }

    /// Index of the first pose than which no later one has clearly more support.
    pub fn best_of(&self, frame: &RgbdFrame, poses: &[Pose]) -> usize {
        let support: Vec<f64> = poses.iter().map(|pose| self.support(frame, pose)).collect();
        let clearly = CLEARLY * self.0.len() as f64;
        (1..poses.len())
            .fold(0, |best, i| if support[i] > support[best] + clearly { i } else { best })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};
    use nalgebra::Vector3;

    #[test]
    fn the_pose_from_which_the_room_looks_as_it_does_is_the_best() {
        // A board before a wall; the camera then goes 10 cm back.
        let surface = FirstSurface::of(&seen(0, board(0.3, 1.5, 2.5)));
        let later = seen(1, board(0.3, 1.6, 2.6));
        let [right, wrong] = [0.1, 0.0].map(|back| Pose::translation(0.0, 0.0, back));
        assert_eq!(surface.best_of(&later, &[wrong, right]), 1);
        assert_eq!(surface.best_of(&later, &[right, wrong]), 0);
        assert_eq!(surface.best_of(&later, &[wrong, right, right]), 1);
        let turned = Pose::new(Vector3::new(0.0, 0.0, 0.1), 0.15 * Vector3::y());
        assert_eq!(surface.best_of(&later, &[turned, right, wrong]), 1);
    }

    #[test]
    fn poses_that_depth_cannot_discriminate_stay_in_their_order() {
        let wall = |id| seen(id, |_, _| 2.0);
        let surface = FirstSurface::of(&wall(0));
        let aside = Pose::translation(0.05, 0.0, 0.0);
        assert_eq!(surface.best_of(&wall(1), &[aside, Pose::identity()]), 0);
        assert_eq!(FirstSurface::default().best_of(&wall(1), &[aside]), 0);
    }
}
