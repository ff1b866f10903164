//! Makes a learned joint of a surface that was followed along a joint without tracks.
//!
//! In: the joint, points of the surface, and the configuration in each frame that shows it; base
//! frame, metres, radians.
//! Out: a [`LearnedJoint`] of which the base is the parent.

use super::learned_joint::{LearnedJoint, orient, range_of};
use super::recording::Recording;
use super::tracking::Trajectory;
use crate::object::joint_geometry::JointGeometry;
use crate::object::model::{Joint, covariance_rows};
use nalgebra::{Matrix6, Point3};

/// A surface and the joint that moves it, in the base frame.
pub struct FollowedSurface<'s> {
    /// Type and line of the joint.
    pub geometry: JointGeometry,
    /// Covariance of the joint's (axis, origin).
    pub covariance: Matrix6<f64>,
    /// Points of the surface at configuration 0.
    pub points: &'s [Point3<f64>],
    /// Frames that show the surface, each with the configuration of the joint.
    pub configuration: Vec<(usize, f64)>,
    /// Distance of the readings from the surface as the joint places it, metres: root mean square
    /// for a plain part, median for a vacated surface.
    pub rmse: f64,
}

impl FollowedSurface<'_> {
    /// The surface as a joint of the base; the configuration is known in the frames that show the
    /// surface.
    pub fn into_learned(self, recording: &Recording) -> LearnedJoint {
        let mut geometry = self.geometry;
        let (frames, mut configuration): (Vec<usize>, Vec<f64>) =
            self.configuration.into_iter().unzip();
        // The part's coordinates are those of the first frame that shows it.
        let first = geometry.motion(configuration.first().copied().unwrap_or_default());
        let plain_surface = self.points.iter().map(|p| first * p).collect();
        orient(&mut geometry, &mut configuration);
        let is_reversed = geometry.axis.dot(&self.geometry.axis) < 0.0;
        let mut base_from_part: Trajectory =
            vec![None; recording.ego_motion.camera_from_base.len()];
        for (&frame, &q) in frames.iter().zip(&configuration) {
            base_from_part[frame] = Some(geometry.motion(q));
        }
        let mut joint = Joint {
            range: range_of(&configuration),
            covariance: covariance_rows(&self.covariance),
            observations: frames.len(),
            position_rmse: self.rmse,
            configuration: recording.tracks.timed(&frames, &configuration),
            type_probabilities: [(geometry.kind, 1.0)].into(),
            ..Joint::of(&self.geometry)
        };
        if is_reversed {
            joint.turn_round();
        }
        LearnedJoint { joint, base_from_part, tracks: Vec::new(), plain_surface }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::EgoMotion;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::tracking::TrackSet;
    use crate::math::rigid::Pose;
    use nalgebra::Vector3;

    #[test]
    fn a_joint_that_counts_down_is_turned_round_with_its_covariance() {
        let mut covariance = Matrix6::from_diagonal_element(0.01);
        covariance[(0, 4)] = 0.003;
        covariance[(4, 0)] = 0.003;
        let surface = FollowedSurface {
            geometry: JointGeometry::hinge(Vector3::z_axis(), Point3::origin()),
            covariance,
            points: &[Point3::new(1.0, 0.0, 0.0)],
            configuration: vec![(0, 0.2), (1, 0.2), (2, -0.5)],
            rmse: 0.001,
        };
        let camera_from_base = vec![Pose::identity(); 3];
        let recording = Recording {
            tracks: TrackSet { frame_utimes: vec![0, 1, 2], tracks: Vec::new() },
            ego_motion: EgoMotion { camera_from_base, ..EgoMotion::default() },
            keyframes: Keyframes::new(2),
        };
        let learned = surface.into_learned(&recording);
        assert_eq!(learned.joint.axis, [-0.0, -0.0, -1.0]);
        assert!((learned.joint.range[1] - 0.7).abs() < 1e-12);
        let told = learned.joint.known_covariance().unwrap();
        assert_eq!((told[(0, 4)], told[(4, 0)], told[(0, 0)]), (-0.003, -0.003, 0.01));
        // The surface is where it was in the first frame.
        let place = learned.base_from_part[0].unwrap() * learned.plain_surface[0];
        assert!((place - Point3::new(0.2_f64.cos(), 0.2_f64.sin(), 0.0)).norm() < 1e-12);
    }
}
