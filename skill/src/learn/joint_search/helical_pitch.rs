//! Determines whether a hinge advances as it turns (a screw). Each track gives a pitch, and the
//! median is taken. The pitch is not fitted together with the axis: it would follow tracks that
//! slip along edges, which a tilted axis explains as well.
//!
//! In: a hinge and its tracks in the frame of its parent, metres and radians.
//! Out: the pitch, metres per radian, or none for a hinge.
//! From: median of regression slopes, with a significance limit that was measured.

use super::estimate::JointEstimate;
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::ransac::{RansacOptions, ransac_rigid};
use crate::math::rigid::distance_to_line;
use crate::math::robust::median;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Smallest turn from which a pitch is estimated, radians.
const MIN_TURN: f64 = 0.5;
/// Smallest advance over the range of a joint, metres; a joint that advances less is a hinge.
const MIN_ADVANCE_M: f64 = 0.01;
/// Smallest ratio of the pitch to its standard error. Measured: true hinges are within 3, screws
/// beyond 12.
const MIN_SIGNIFICANCE: f64 = 8.0;
/// Number of pairs of frames, far apart in configuration, from whose motions the axis is estimated.
const PAIRS: usize = 8;
/// Smallest number of tracks for a pitch, or for the rotation between two frames.
const MIN_TRACKS: usize = 10;
/// Smallest number of observations of a track that gives a pitch.
const MIN_OBSERVATIONS: usize = 15;
/// Smallest standard deviation of the configurations of a track that gives a pitch, radians.
const MIN_SPREAD: f64 = 0.15;
/// Largest difference between the distances from the axis of a track that gives a pitch, metres.
const MAX_DRIFT_M: f64 = 0.03;

/// True if the joint is a hinge and turned by at least `MIN_TURN`, so that a pitch can be
/// estimated.
pub fn turns_enough(joint: &JointEstimate) -> bool {
    joint.dof.hinge && joint.span() >= MIN_TURN
}

/// Axis about which a joint's tracks rotate, whatever their advance, from rigid motions between
/// frames. The axis of a fitted hinge is unsuitable, because it tilts to explain the advance.
pub fn turning_axis(
    joint: &JointEstimate,
    view: &TracksInFrame,
    tracks: &[usize],
) -> Option<Vector3<f64>> {
    let mut by_q = joint.known_frames();
    by_q.sort_by(|&a, &b| joint.q[a].total_cmp(&joint.q[b]));
    let turns: Vec<Vector3<f64>> = (0..PAIRS)
        .into_par_iter()
        .filter_map(|i| {
            let inward = i * by_q.len() / (4 * PAIRS);
            let (from, to) = (*by_q.get(inward)?, *by_q.get(by_q.len() - 1 - inward)?);
            turn_between(view, tracks, from, to)
        })
        .map(|turn| turn * turn.dot(&joint.dof.axis).signum())
        .collect();
    turns.iter().sum::<Vector3<f64>>().try_normalize(MIN_TURN)
}

/// Rotation vector (axis times angle, radians) of the rigid motion of tracks between two frames.
fn turn_between(
    view: &TracksInFrame,
    tracks: &[usize],
    from: usize,
    to: usize,
) -> Option<Vector3<f64>> {
    let pairs = view.correspondences(tracks, from, to);
    let mut rng = ChaCha8Rng::seed_from_u64(from as u64);
    let options = RansacOptions { cut: 3.0, iterations: 100, locality: None };
    let motion = ransac_rigid(&pairs, &options, None, &mut rng)?;
    (motion.inliers.len() >= MIN_TRACKS).then(|| motion.motion.rotation.scaled_axis())
}

/// Pitch of a joint, metres per radian; `None` if the joint is a hinge.
pub fn pitch_of(joint: &JointEstimate, view: &TracksInFrame, tracks: &[usize]) -> Option<f64> {
    let mut pitches: Vec<f64> =
        tracks.par_iter().filter_map(|&t| advance_of(joint, view, t)).collect();
    if pitches.len() < MIN_TRACKS {
        return None;
    }
    let pitch = median(&mut pitches)?;
    let mut off: Vec<f64> = pitches.iter().map(|p| (p - pitch).abs()).collect();
    // Standard error of the median; the standard deviation is 1.483 times the median absolute
    // deviation.
    let error = 1.253 * 1.483 * median(&mut off)? / (pitches.len() as f64).sqrt();
    let advances = (pitch * joint.span()).abs() >= MIN_ADVANCE_M;
    (advances && pitch.abs() >= MIN_SIGNIFICANCE * error).then_some(pitch)
}

/// Pitch of one track, metres per radian: slope of its place along the axis over the configuration.
/// `None` where the track is too short or does not keep its distance from the axis.
fn advance_of(joint: &JointEstimate, view: &TracksInFrame, track: usize) -> Option<f64> {
    let dof = &joint.dof;
    let (mut near, mut far) = (f64::INFINITY, 0.0_f64);
    let seen: Vec<(f64, f64)> = view
        .life(track)
        .filter(|(f, _)| joint.known[*f])
        .map(|(f, s)| {
            let radius = distance_to_line(&dof.origin, &dof.axis, &s.point);
            (near, far) = (near.min(radius), far.max(radius));
            (joint.q[f], dof.axis.dot(&(s.point - dof.origin)))
        })
        .collect();
    let n = seen.len() as f64;
    let q_mean = seen.iter().map(|s| s.0).sum::<f64>() / n;
    let spread: f64 = seen.iter().map(|s| (s.0 - q_mean).powi(2)).sum();
    let slope = seen.iter().map(|s| (s.0 - q_mean) * s.1).sum::<f64>() / spread;
    let is_enough = seen.len() >= MIN_OBSERVATIONS
        && (spread / n).sqrt() >= MIN_SPREAD
        && far - near <= MAX_DRIFT_M;
    is_enough.then_some(slope)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::Point3;

    /// The pitch of twenty points that turn by `angle` in thirty frames.
    fn found(pitch: f64, angle: f64) -> Option<f64> {
        let line = ScrewJoint {
            pitch: Some(pitch),
            ..ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5))
        };
        let q: Vec<f64> = (0..30).map(|f| angle * f64::from(f) / 29.0).collect();
        let places: Vec<Point3<f64>> = (0..20)
            .map(f64::from)
            .map(|i| Point3::new(0.1 + 0.03 * i, 0.2 * (1.3 * i).sin(), 1.5))
            .collect();
        let view = seen_moving(&line, &places, &q);
        let mut joint = JointEstimate::new(ScrewJoint { pitch: None, ..line }, &view, 0);
        joint.q = q;
        joint.known = vec![true; 30];
        joint.summarise();
        let all: Vec<usize> = (0..20).collect();
        turns_enough(&joint).then(|| pitch_of(&joint, &view, &all)).flatten()
    }

    #[test]
    fn what_advances_as_it_turns_is_told_from_a_hinge() {
        assert!((found(-0.02, 1.2).unwrap() + 0.02).abs() < 0.001);
        assert_eq!(found(0.0, 1.2), None);
    }

    #[test]
    fn a_short_turn_or_advance_shows_no_pitch() {
        assert_eq!(found(0.05, 0.4), None);
        assert_eq!(found(0.004, 1.2), None);
    }
}
