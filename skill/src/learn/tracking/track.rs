//! Tracks: features that were followed from frame to frame, in pixels and, where the depth image
//! has a reading, in metres in the camera frame.

use crate::math::rigid::Pose;
use nalgebra::{Point2, Point3, Vector3};

/// Observation of a feature in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Place in the image, pixels.
    pub pixel: Point2<f32>,
    /// Place in the camera frame, metres; `None` where depth has no reading or an edge.
    pub point_in_camera: Option<Point3<f64>>,
    /// Unit surface normal in the camera frame, towards the camera.
    pub normal_in_camera: Option<Vector3<f64>>,
}

/// Identity of a track: its number in order of birth. It stays when other tracks are dropped, unlike
/// the track's index in a `TrackSet`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrackId(pub usize);

/// A feature followed through consecutive frames.
#[derive(Debug, Clone)]
pub struct Track {
    /// Identity of the track.
    pub id: TrackId,
    /// Number of the first frame.
    pub first_frame: usize,
    /// One observation for each frame from `first_frame` on.
    pub observations: Vec<Observation>,
}

impl Track {
    /// The observation in a frame; `None` before the track's birth and after its end.
    pub fn at(&self, frame: usize) -> Option<&Observation> {
        self.observations.get(frame.checked_sub(self.first_frame)?)
    }

    /// Number of the frame after the last observation.
    pub fn end_frame(&self) -> usize {
        self.first_frame + self.observations.len()
    }

    /// True if the track has depth in at least `min_length` frames.
    pub fn is_long(&self, min_length: usize) -> bool {
        self.lifted().nth(min_length.saturating_sub(1)).is_some()
    }

    /// Frames in which the track has depth, with the place in the camera frame, metres.
    pub fn lifted(&self) -> impl Iterator<Item = (usize, Point3<f64>)> + '_ {
        self.observations
            .iter()
            .enumerate()
            .filter_map(|(i, o)| Some((self.first_frame + i, o.point_in_camera?)))
    }
}

/// All tracks of a recording.
#[derive(Debug, Clone, Default)]
pub struct TrackSet {
    /// Time of each frame, microseconds.
    pub frame_utimes: Vec<i64>,
    /// The tracks, in order of their birth.
    pub tracks: Vec<Track>,
}

impl TrackSet {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frame_utimes.len()
    }

    /// Pairs `[t, q]` of time, seconds, and configuration, for the configurations in some frames.
    pub fn timed(&self, frames: &[usize], configuration: &[f64]) -> Vec<[f64; 2]> {
        frames
            .iter()
            .zip(configuration)
            .map(|(&f, &q)| [self.frame_utimes[f] as f64 * 1e-6, q])
            .collect()
    }

    /// Keeps the tracks that have depth in at least `min_length` frames.
    pub fn retain_long(&mut self, min_length: usize) {
        self.tracks.retain(|t| t.is_long(min_length));
    }
}

/// Pose in each frame; `None` where it is not known.
pub type Trajectory = Vec<Option<Pose>>;

#[cfg(test)]
mod tests {
    use super::*;

    /// A track born in frame 3, of which some frames have depth.
    fn track(has_depth: &[bool]) -> Track {
        let seen = |lifted: &bool| Observation {
            pixel: Point2::new(4.0, 5.0),
            point_in_camera: lifted.then(|| Point3::new(0.0, 0.0, 1.5)),
            normal_in_camera: None,
        };
        let observations = has_depth.iter().map(seen).collect();
        Track { id: TrackId(8), first_frame: 3, observations }
    }

    #[test]
    fn a_track_is_seen_from_its_birth_to_its_end() {
        let track = track(&[true, true]);
        assert!(track.at(2).is_none() && track.at(3).is_some() && track.at(4).is_some());
        assert!(track.at(5).is_none());
        assert_eq!(track.end_frame(), 5);
    }

    #[test]
    fn only_frames_with_depth_count_for_its_length() {
        let track = track(&[true, false, true, true]);
        assert_eq!(track.lifted().map(|(frame, _)| frame).collect::<Vec<_>>(), [3, 5, 6]);
        assert!(track.is_long(3) && !track.is_long(4));
        let mut set = TrackSet { frame_utimes: vec![0; 7], tracks: vec![track.clone(), track] };
        set.retain_long(4);
        assert!(set.tracks.is_empty());
    }

    #[test]
    fn configurations_are_told_with_the_time_of_their_frame_in_seconds() {
        let set = TrackSet { frame_utimes: vec![0, 500_000, 1_000_000], tracks: Vec::new() };
        assert_eq!(set.timed(&[0, 2], &[0.1, 0.2]), [[0.0, 0.1], [1.0, 0.2]]);
    }
}
