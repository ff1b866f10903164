//! The moving tracks in the frame of a part: of the base, or of a part that moves itself. Tracks
//! are numbered by their row in this view.
//!
//! In: tracks in the base frame and the motion of the part. Out: tracks in the frame of the part;
//! metres.

use crate::learn::ego_motion::{BaseObservation, EgoMotion, TrackInBase, path_moves, rest_length};
use crate::math::ransac::Correspondence;
use crate::math::robust::median_point;
use nalgebra::{IsometryMatrix3, Point3};
use rayon::prelude::*;
use std::sync::Arc;

/// Frames of one track (`end` is the frame after the last) and the index of its first observation
/// in `seen`.
#[derive(Clone, Copy)]
struct Life {
    first: usize,
    end: usize,
    /// Index in `seen` of the observation in frame `first`.
    start: usize,
}

/// Observations of tracks by frame, in the frame of one part.
pub struct TracksInFrame {
    /// Number of frames of the recording.
    pub frames: usize,
    /// By row: index of the track in the track set.
    pub track_numbers: Arc<Vec<usize>>,
    /// Observations of all tracks, one track after the other; `None` where a frame has none.
    seen: Vec<Option<BaseObservation>>,
    /// Frame of each observation in `seen`.
    frame_of: Arc<Vec<u32>>,
    lives: Arc<Vec<Life>>,
    /// By frame: false where the pose of the part is unknown.
    pub usable: Vec<bool>,
}

impl TracksInFrame {
    /// The given tracks, in the base frame.
    pub fn from_base(base: &EgoMotion, track_numbers: Vec<usize>) -> Self {
        let frames = base.camera_from_base.len();
        let mut lives = Vec::with_capacity(track_numbers.len());
        let mut start = 0;
        for &number in &track_numbers {
            let track: &TrackInBase = &base.tracks[number];
            let (first, end) = (track.first_frame, track.end_frame());
            lives.push(Life { first, end, start });
            start += end - first;
        }
        let mut seen = Vec::with_capacity(start);
        for &number in &track_numbers {
            seen.extend_from_slice(&base.tracks[number].points);
        }
        let frame_of = lives.iter().flat_map(|l| l.first as u32..l.end as u32).collect();
        let (frame_of, lives) = (Arc::new(frame_of), Arc::new(lives));
        let track_numbers = Arc::new(track_numbers);
        Self { frames, track_numbers, seen, frame_of, lives, usable: vec![true; frames] }
    }

    /// The tracks that move in the base frame, in that frame.
    pub fn moving(base: &EgoMotion) -> Self {
        let moving = (0..base.tracks.len()).filter(|&t| base.tracks[t].moves).collect();
        Self::from_base(base, moving)
    }

    /// Transforms the tracks into the frame of a part that moves in this view, by `part_from_view`
    /// of each frame. Only frames in which the part's pose is `known` are usable.
    pub fn carried(&self, part_from_view: &[IsometryMatrix3<f64>], known: &[bool]) -> Self {
        let both = self.usable.iter().zip(known).map(|(usable, known)| usable & known);
        let from_part = |(seen, frame): (&Option<BaseObservation>, &u32)| {
            seen.map(|s| s.moved(&part_from_view[*frame as usize]))
        };
        Self {
            frames: self.frames,
            track_numbers: Arc::clone(&self.track_numbers),
            seen: self.seen.par_iter().zip(self.frame_of.par_iter()).map(from_part).collect(),
            frame_of: Arc::clone(&self.frame_of),
            lives: Arc::clone(&self.lives),
            usable: both.collect(),
        }
    }

    /// Number of tracks.
    pub fn len(&self) -> usize {
        self.track_numbers.len()
    }

    /// The observation of a track in a frame.
    pub fn at(&self, track: usize, frame: usize) -> Option<&BaseObservation> {
        let life = self.lives[track];
        let alive = life.first <= frame && frame < life.end;
        if alive { self.seen[life.start + frame - life.first].as_ref() } else { None }
    }

    /// Places of tracks in two frames, for those that are seen in both.
    pub fn correspondences(&self, tracks: &[usize], from: usize, to: usize) -> Vec<Correspondence> {
        let both = |&t: &usize| {
            let (a, b) = (self.at(t, from)?, self.at(t, to)?);
            Some(Correspondence { from: a.point, to: b.point, sigma: b.sigma(), weight: 1.0 })
        };
        tracks.iter().filter_map(both).collect()
    }

    /// Observations of a track in usable frames, with their frames.
    pub fn life(&self, track: usize) -> impl Iterator<Item = (usize, &BaseObservation)> + '_ {
        let life = self.lives[track];
        let seen = &self.seen[life.start..life.start + life.end - life.first];
        seen.iter()
            .enumerate()
            .filter_map(move |(i, s)| Some((life.first + i, s.as_ref()?)))
            .filter(|(f, _)| self.usable[*f])
    }

    /// True if the median-smoothed path of a track extends by more than `least_m` metres and by
    /// more than `sigmas` standard deviations of its noise.
    pub fn moves(&self, track: usize, least_m: f64, sigmas: f64) -> bool {
        let path: Vec<(Point3<f64>, f64)> =
            self.life(track).map(|(_, s)| (s.point, s.sigma())).collect();
        path_moves(&path, least_m, sigmas)
    }

    /// True if, after `frame`, the track was seen twice in a row away from the place where it was
    /// last seen up to `frame`.
    pub fn moved_since(&self, track: usize, frame: usize) -> bool {
        let Some((_, before)) = self.life(track).take_while(|(f, _)| *f <= frame).last() else {
            return false;
        };
        let mut away = 0;
        self.life(track).filter(|(f, _)| *f > frame).any(|(_, s)| {
            away = if s.is_away_from(&before.point) { away + 1 } else { 0 };
            away > 1
        })
    }

    /// Truncated cost of a track if it stood still at its median place, over the frames marked in
    /// `counts`.
    pub fn static_cost(&self, track: usize, counts: &[bool], cut: f64) -> f64 {
        let life: Vec<&BaseObservation> =
            self.life(track).filter(|(f, _)| counts[*f]).map(|(_, s)| s).collect();
        let places: Vec<Point3<f64>> = life.iter().map(|s| s.point).collect();
        let Some(middle) = median_point(&places) else { return 0.0 };
        life.iter().map(|s| s.distance_sq(&middle).min(cut)).sum()
    }

    /// Number of observations at the start and at the end of a track during which it does not move.
    pub fn rest_lengths(&self, track: usize) -> [usize; 2] {
        let path: Vec<(Point3<f64>, f64)> =
            self.life(track).map(|(_, s)| (s.point, s.sigma())).collect();
        [rest_length(path.iter().copied()), rest_length(path.iter().rev().copied())]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::seen_along;

    #[test]
    fn a_track_that_moved_once_and_came_back_has_not_moved() {
        let path = |away: &[usize]| -> Vec<Point3<f64>> {
            (0..20)
                .map(|f| Point3::new(if away.contains(&f) { 0.1 } else { 0.0 }, 0.0, 1.0))
                .collect()
        };
        let view = TracksInFrame::moving(&seen_along(&[path(&[12]), path(&[12, 13])]));
        assert!(!view.moved_since(0, 9));
        assert!(view.moved_since(1, 9));
        assert!(!view.moved_since(1, 15));
    }
}
