//! Where in a frame do features show something that moves and is no part of the object? The person
//! who demonstrates may stand beside the object nearly all the time, sway by a few centimetres only,
//! and so look like a surface that rests; the features on the clothes tell that it does not.

use crate::learn::demonstration::Demonstration;
use crate::learn::tracking::{Track, Trajectory};
use linkage_frames::PinholeCamera;
use nalgebra::Point3;

/// A feature that leaves its place on the base by this much moves, radians: 4 pixels of a Kinect.
const MOVES_RAD: f64 = 0.0076;
/// Features this near tell of a place, metres.
const NEAR_M: f64 = 0.07;
/// Fewest features that tell that a place moves.
const MIN_FEATURES: usize = 3;

/// Which tracks belong to no part and do not rest on the base.
pub struct Strangers<'d> {
    demonstration: &'d Demonstration,
    moves: Vec<bool>,
}

impl<'d> Strangers<'d> {
    /// Looks at all tracks of a demonstration.
    pub fn new(demonstration: &'d Demonstration, camera: &PinholeCamera) -> Self {
        let tracks = demonstration.tracks.tracks.iter().zip(&demonstration.track_parts);
        let camera_from_base = &demonstration.camera_from_part[0];
        let moves =
            tracks.map(|(t, part)| part.is_none() && leaves_its_place(t, camera_from_base, camera));
        Self { demonstration, moves: moves.collect() }
    }

    /// What a frame shows, by its number in the demonstration.
    pub fn in_frame(&self, frame: usize) -> StrangersInFrame {
        let mut shown = StrangersInFrame::default();
        let tracks = self.demonstration.tracks.tracks.iter();
        let parts = &self.demonstration.track_parts;
        for ((track, part), moves) in tracks.zip(parts).zip(&self.moves) {
            let Some(place) = track.at(frame).and_then(|o| o.point_in_camera) else { continue };
            match (moves, part) {
                (true, _) => shown.moving.push(place),
                (false, Some(0)) => shown.resting.push(place),
                _ => {}
            }
        }
        shown
    }
}

/// Features of one frame, in the camera frame, metres.
#[derive(Default)]
pub struct StrangersInFrame {
    /// Those that move and belong to no part.
    pub moving: Vec<Point3<f64>>,
    /// The base's.
    pub resting: Vec<Point3<f64>>,
}

impl StrangersInFrame {
    /// Round a place the features that move are several, and at least twice as many as those that rest.
    pub fn hold(&self, place: &Point3<f64>) -> bool {
        let near = |features: &[Point3<f64>]| {
            features.iter().filter(|f| (*f - place).norm_squared() < NEAR_M * NEAR_M).count()
        };
        let moving = near(&self.moving);
        moving >= MIN_FEATURES && moving >= 2 * near(&self.resting)
    }
}

fn leaves_its_place(track: &Track, camera_from_base: &Trajectory, camera: &PinholeCamera) -> bool {
    let on_base = track
        .lifted()
        .find_map(|(f, p)| Some(camera_from_base.get(f)?.as_ref()?.inverse_transform_point(&p)));
    let Some(on_base) = on_base else { return false };
    track.observations.iter().enumerate().any(|(i, seen)| {
        let pose = camera_from_base.get(track.first_frame + i).and_then(Option::as_ref);
        let expected = pose.and_then(|pose| camera.project(&(pose * on_base)));
        expected.is_some_and(|pixel| (pixel - seen.pixel.cast()).norm() > MOVES_RAD * camera.fx)
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
    fn a_few_moving_features_tell_of_a_place_where_fewer_rest() {
        let mut shown = StrangersInFrame { moving: vec![at(0.0), at(0.02)], resting: vec![] };
        assert!(!shown.hold(&at(0.01)), "two are too few");
        shown.moving.push(at(0.03));
        assert!(shown.hold(&at(0.01)) && !shown.hold(&at(0.5)));
        shown.resting.extend([at(0.0), at(0.04)]);
        assert!(!shown.hold(&at(0.01)), "nearly as many rest");
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
        assert!(leaves_its_place(&track([0.0, 0.01, 0.02], [1.0; 3]), &still, &camera));
        assert!(!leaves_its_place(&track([0.0; 3], [1.0, 1.4, 1.0]), &still, &camera));
    }
}
