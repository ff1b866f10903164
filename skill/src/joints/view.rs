//! The moving tracks as seen from a part: from the base, or from a part that moves itself.

use super::grown::Grown;
use crate::base::{BaseMotion, BaseTrack, path_moves, rest_length};
use crate::geometry::median_point;
use nalgebra::{Matrix3, Point3};

/// One observation.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Place in the view's frame.
    pub point: Point3<f64>,
    /// Inverse covariance there.
    pub information: Matrix3<f64>,
    /// One figure for its noise, metres.
    pub sigma: f64,
}

impl Seen {
    /// Squared Mahalanobis distance from a place.
    pub fn distance_sq(&self, place: &Point3<f64>) -> f64 {
        let e = place - self.point;
        (self.information * e).dot(&e)
    }
}

/// Tracks by frames.
#[derive(Clone)]
pub struct View {
    /// Frames of the recording.
    pub frames: usize,
    /// Numbers of the tracks in the track set.
    pub track_ids: Vec<usize>,
    seen: Vec<Option<Seen>>,
    /// First and last frame (exclusive) of each track.
    lives: Vec<(usize, usize)>,
    /// False where the part that is looked from is itself not known.
    pub usable: Vec<bool>,
}

impl View {
    /// The given tracks from the base.
    pub fn from_base(base: &BaseMotion, track_ids: Vec<usize>) -> Self {
        let frames = base.camera_from_base.len();
        let mut seen = vec![None; track_ids.len() * frames];
        let mut lives = Vec::with_capacity(track_ids.len());
        for (row, &id) in track_ids.iter().enumerate() {
            let track: &BaseTrack = &base.tracks[id];
            lives.push((track.first_frame, track.end_frame()));
            for (frame, p) in track.seen() {
                seen[row * frames + frame] =
                    Some(Seen { point: p.point, information: p.information, sigma: p.sigma });
            }
        }
        Self { frames, track_ids, seen, lives, usable: vec![true; frames] }
    }

    /// The same tracks from a part that moves in this view.
    pub fn seen_from(&self, part: &Grown) -> Self {
        let mut view = self.clone();
        for frame in 0..self.frames {
            view.usable[frame] = self.usable[frame] && part.known[frame];
            let q = part.filled[frame];
            let part_from_view = part.dof.geometry().motion(-q);
            let rotation = part_from_view.rotation.to_rotation_matrix().into_inner();
            for row in 0..self.track_ids.len() {
                if let Some(s) = &mut view.seen[row * self.frames + frame] {
                    s.point = part_from_view * s.point;
                    s.information = rotation * s.information * rotation.transpose();
                }
            }
        }
        view
    }

    /// Number of tracks.
    pub fn len(&self) -> usize {
        self.track_ids.len()
    }

    /// A track in a frame.
    pub fn at(&self, track: usize, frame: usize) -> Option<&Seen> {
        self.seen[track * self.frames + frame].as_ref()
    }

    /// A track's observations in usable frames.
    pub fn life(&self, track: usize) -> impl Iterator<Item = (usize, &Seen)> + '_ {
        let (first, end) = self.lives[track];
        (first..end).filter(|&f| self.usable[f]).filter_map(move |f| Some((f, self.at(track, f)?)))
    }

    /// True when the median-smoothed path is longer than noise explains.
    pub fn moves(&self, track: usize, least_m: f64, sigmas: f64) -> bool {
        let path: Vec<(Point3<f64>, f64)> =
            self.life(track).map(|(_, s)| (s.point, s.sigma)).collect();
        path_moves(&path, least_m, sigmas)
    }

    /// Truncated cost of a track that stays where it is, over the frames that count.
    pub fn static_cost(&self, track: usize, counts: &[bool], cut: f64) -> f64 {
        let life: Vec<&Seen> =
            self.life(track).filter(|(f, _)| counts[*f]).map(|(_, s)| s).collect();
        let places: Vec<Point3<f64>> = life.iter().map(|s| s.point).collect();
        let Some(middle) = median_point(&places) else { return 0.0 };
        life.iter().map(|s| s.distance_sq(&middle).min(cut)).sum()
    }

    /// Observations for which a track rests at the start and at the end of its life.
    pub fn rest_lengths(&self, track: usize) -> [usize; 2] {
        let path: Vec<(Point3<f64>, f64)> =
            self.life(track).map(|(_, s)| (s.point, s.sigma)).collect();
        [rest_length(path.iter().copied()), rest_length(path.iter().rev().copied())]
    }
}
