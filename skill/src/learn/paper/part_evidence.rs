//! Evidence that distinguishes a part of an object from a hand: tracks that rest at the start or at
//! the end of their life, and depth images that show nothing behind the places where the joint puts
//! the part.
//!
//! In: a candidate with its joint, in the base frame, and the recording.
//! Out: the share of the tracks that rest, and the share of the points that are seen through, 0 to
//! 1.

use super::candidate::Candidate;
use crate::learn::ego_motion::{EgoMotion, rest_length};
use crate::learn::free_space::{FreeSpaceCounts, count_free_space};
use crate::learn::recording::Recording;
use crate::math::robust::median_point;
use nalgebra::Point3;

/// Number of points of a part that are sought in each keyframe; the tracks are thinned to at least
/// this number and less than twice as many.
const MAX_POINTS: usize = 120;
/// Steps between the configurations that are tried in a keyframe in which the part has no pose.
const SCAN_STEPS: u32 = 32;
/// Share of the range of the configuration by which the tried configurations extend it at either
/// end.
const SCAN_PAD: f64 = 0.25;

/// Share of the tracks that rest for at least `frames` observations at the start or at the end of
/// their life.
pub fn resting_share(base: &EgoMotion, tracks: &[usize], frames: usize) -> f64 {
    let resting = tracks
        .iter()
        .filter(|&&id| {
            let path: Vec<_> = base.tracks[id].seen().map(|(_, p)| (p.point, p.sigma())).collect();
            rest_length(path.iter().copied()) >= frames
                || rest_length(path.iter().rev().copied()) >= frames
        })
        .count();
    resting as f64 / tracks.len().max(1) as f64
}

/// Share of a part's points, 0 to 1, that keyframes see through. Where the configuration is known,
/// the points are tested at it; in another keyframe they are tested at the configuration that fits
/// best, in the range or a little beyond.
pub fn seen_through_share(recording: &Recording, candidate: &Candidate) -> f64 {
    let (frames, configuration) = (&candidate.frames, &candidate.fit.configuration);
    let points_at_rest = points_at_rest(&recording.ego_motion, candidate);
    let low = configuration.iter().copied().fold(f64::INFINITY, f64::min);
    let high = configuration.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let pad = SCAN_PAD * (high - low);
    let scanned =
        |i: u32| low - pad + (high - low + 2.0 * pad) * f64::from(i) / f64::from(SCAN_STEPS);
    let mut all = FreeSpaceCounts::default();
    for (frame, picture) in recording.keyframes.iter() {
        let camera_from_base = recording.ego_motion.camera_from_base[frame];
        let probe = |q: f64| {
            let camera_from_part = camera_from_base * candidate.fit.geometry.motion(q);
            count_free_space(picture, &points_at_rest, &camera_from_part)
        };
        all.add(match frames.binary_search(&frame) {
            Ok(i) => probe(configuration[i]),
            Err(_) => (0..=SCAN_STEPS)
                .map(|i| probe(scanned(i)))
                .max_by_key(|found| found.margin())
                .unwrap_or_default(),
        });
    }
    all.share_through()
}

/// Tracked points of a part, carried back to configuration 0; base frame, metres.
fn points_at_rest(base: &EgoMotion, candidate: &Candidate) -> Vec<Point3<f64>> {
    let Candidate { motion, fit, frames } = candidate;
    let stride = (motion.tracks.len() / MAX_POINTS).max(1);
    let at_rest = |&id: &usize| {
        let places: Vec<Point3<f64>> = base.tracks[id]
            .seen()
            .filter_map(|(t, p)| {
                let i = frames.binary_search(&t).ok()?;
                Some(fit.geometry.motion(-fit.configuration[i]) * p.point)
            })
            .collect();
        median_point(&places)
    };
    motion.tracks.iter().step_by(stride).filter_map(at_rest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::{BaseObservation, Information, TrackInBase};
    use nalgebra::Vector3;
    use std::sync::Arc;

    /// A track of thirty frames that moves by a centimetre a frame between two of them.
    fn track(from: usize, to: usize) -> Arc<TrackInBase> {
        let precision = Information::new(&Vector3::z(), 0.001, 0.001);
        let place = |f: usize| Point3::new(0.01 * (f.clamp(from, to) - from) as f64, 0.0, 1.0);
        let points =
            (0..30).map(|f| Some(BaseObservation::new(place(f), precision, 0.001))).collect();
        Arc::new(TrackInBase { points, moves: true, ..TrackInBase::default() })
    }

    #[test]
    fn tracks_that_rest_first_or_last_are_told_from_those_that_always_move() {
        let base = EgoMotion {
            tracks: vec![track(15, 30), track(0, 15), track(0, 30)],
            ..EgoMotion::default()
        };
        assert_eq!(resting_share(&base, &[0, 1], 8), 1.0);
        assert_eq!(resting_share(&base, &[2], 8), 0.0);
    }
}
