//! Finds where a frame shows a dynamic object: something that moves and is no part of the learned object. A person
//! who demonstrates may stand beside the object nearly all the time and sway by a few centimetres only. Depth alone
//! classifies such a person as static surface; the tracked features on the clothes show the motion.
//!
//! In: tracks with their parts, and the pose of the camera in each frame.
//! Out: the dynamic and the resting features of a frame, camera frame, metres.

use crate::learn::demonstration::Demonstration;
use crate::learn::tracking::{Track, Trajectory};
use linkage_frames::PinholeCamera;
use nalgebra::Point3;

/// Smallest angle between a dynamic feature's pixel and the projection of a point fixed to the base, radians: 4
/// pixels of a Kinect.
const MIN_MOTION_RAD: f64 = 0.0076;
/// Largest distance from a point to the features that decide whether it is dynamic, metres.
const NEAR_M: f64 = 0.07;
/// Fewest dynamic features near a dynamic point.
const MIN_FEATURES: usize = 3;

/// Classification of a demonstration's tracks. Dynamic tracks belong to no part and do not rest on the base.
pub struct DynamicFeatures<'d> {
    demonstration: &'d Demonstration,
    /// For each track, true if it is dynamic.
    is_dynamic: Vec<bool>,
}

impl<'d> DynamicFeatures<'d> {
    /// Classifies all tracks of a demonstration.
    pub fn new(demonstration: &'d Demonstration, camera: &PinholeCamera) -> Self {
        let tracks = demonstration.tracks.tracks.iter().zip(&demonstration.track_parts);
        let camera_from_base = &demonstration.camera_from_part[0];
        let is_dynamic = tracks
            .map(|(t, part)| part.is_none() && moves_on_the_base(t, camera_from_base, camera));
        Self { demonstration, is_dynamic: is_dynamic.collect() }
    }

    /// The features of a frame, which is given by its number in the demonstration; camera frame, metres.
    pub fn in_frame(&self, frame: usize) -> FrameFeatures {
        let mut features = FrameFeatures::default();
        let tracks = self.demonstration.tracks.tracks.iter();
        let parts = &self.demonstration.track_parts;
        for ((track, part), is_dynamic) in tracks.zip(parts).zip(&self.is_dynamic) {
            let Some(point) = track.at(frame).and_then(|o| o.point_in_camera) else { continue };
            match (is_dynamic, part) {
                (true, _) => features.dynamic.push(point),
                (false, Some(0)) => features.resting.push(point),
                _ => {}
            }
        }
        features
    }
}

/// Features of one frame, in the camera frame, metres.
#[derive(Default)]
pub struct FrameFeatures {
    /// Features that move and belong to no part.
    pub dynamic: Vec<Point3<f64>>,
    /// Features of the base.
    pub resting: Vec<Point3<f64>>,
}

impl FrameFeatures {
    /// True if several features near a point (camera frame) are dynamic, and at least twice as many as those that
    /// rest.
    pub fn are_dynamic_near(&self, point: &Point3<f64>) -> bool {
        let near = |features: &[Point3<f64>]| {
            features.iter().filter(|f| (*f - point).norm_squared() < NEAR_M * NEAR_M).count()
        };
        let dynamic = near(&self.dynamic);
        dynamic >= MIN_FEATURES && dynamic >= 2 * near(&self.resting)
    }
}

/// True if a track leaves the pixels at which its first 3-D point, fixed to the base, is projected.
fn moves_on_the_base(track: &Track, camera_from_base: &Trajectory, camera: &PinholeCamera) -> bool {
    let on_base = track
        .lifted()
        .find_map(|(f, p)| Some(camera_from_base.get(f)?.as_ref()?.inverse_transform_point(&p)));
    let Some(on_base) = on_base else { return false };
    track.observations.iter().enumerate().any(|(i, seen)| {
        let pose = camera_from_base.get(track.first_frame + i).and_then(Option::as_ref);
        let expected = pose.and_then(|pose| camera.project(&(pose * on_base)));
        expected
            .is_some_and(|pixel| (pixel - seen.pixel.cast()).norm() > MIN_MOTION_RAD * camera.fx)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::tracking::{Observation, TrackId};
    use crate::math::rigid::Pose;

    fn at(x: f64) -> Point3<f64> {
        Point3::new(x, 0.0, 1.0)
    }

    #[test]
    fn a_point_is_dynamic_where_several_features_move_and_fewer_rest() {
        let mut features = FrameFeatures { dynamic: vec![at(0.0), at(0.02)], resting: vec![] };
        assert!(!features.are_dynamic_near(&at(0.01)), "two are too few");
        features.dynamic.push(at(0.03));
        assert!(features.are_dynamic_near(&at(0.01)) && !features.are_dynamic_near(&at(0.5)));
        features.resting.extend([at(0.0), at(0.04)]);
        assert!(!features.are_dynamic_near(&at(0.01)), "nearly as many rest");
    }

    #[test]
    fn a_feature_moves_when_it_leaves_its_place_in_the_picture_and_not_for_an_error_of_depth() {
        let camera = PinholeCamera::kinect();
        let seen = |lateral: f64, depth: f64| Observation {
            pixel: camera.project(&at(lateral)).unwrap().cast(),
            point_in_camera: Some(Point3::from(at(lateral).coords * depth)),
            normal_in_camera: None,
        };
        let still: Trajectory = vec![Some(Pose::identity()); 3];
        let track = |lateral: [f64; 3], depth: [f64; 3]| Track {
            id: TrackId(0),
            first_frame: 0,
            observations: (0..3).map(|i| seen(lateral[i], depth[i])).collect(),
        };
        assert!(moves_on_the_base(&track([0.0, 0.01, 0.02], [1.0; 3]), &still, &camera));
        assert!(!moves_on_the_base(&track([0.0; 3], [1.0, 1.4, 1.0]), &still, &camera));
    }
}
