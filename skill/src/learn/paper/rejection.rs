//! Decides which candidates are no part of an object, and for what reason.
//!
//! In: a candidate with the joint that was fitted to it in the base frame, and the accepted
//! candidates.
//! Out: the reason of the rejection; `None` for a part.

use super::candidate::{Candidate, correlation};
use super::part_evidence::{resting_share, seen_through_share};
use crate::learn::learned_joint::span_of;
use crate::learn::recording::Recording;
use crate::math::robust::extent;
use crate::object::joint_geometry::JointKind;

/// Smallest number of frames in which a joint is observed.
pub const MIN_FRAMES: usize = 15;
/// Smallest motion of a slide, metres.
const MIN_SLIDE_M: f64 = 0.06;
/// Smallest motion of a hinge, radians.
const MIN_TURN_RAD: f64 = 0.15;
/// Largest root mean square distance from the joint's model of a part that hardly moves, metres.
const MAX_POSITION_RMSE_M: f64 = 0.0025;
/// Share of the part's travel by which the largest root mean square distance grows; small, because
/// hands roughly follow many models.
const MAX_RMSE_SHARE: f64 = 0.01;
/// Largest share of the samples that the joint does not explain (outliers).
const MAX_OUTLIER_RATIO: f64 = 0.35;
/// Smallest number of observations for which a track of a part rests at the start or at the end of
/// its life.
const REST_FRAMES: usize = 8;
/// Smallest share of a part's tracks that rest: parts of objects rest, hands do not.
const MIN_REST_SHARE: f64 = 0.12;
/// Largest share of a part's points that are seen through: where the model has a surface, the
/// camera saw something behind it.
const MAX_SEEN_THROUGH: f64 = 0.28;
/// Largest squared correlation with the configuration of an accepted joint; above it, the motion is
/// a consequence of that joint's.
const MAX_CORRELATION: f64 = 0.85;

/// Reason why a moving thing is no part of an object; `None` if it is a part.
pub(super) fn rejection_reason(
    recording: &Recording,
    candidate: &Candidate,
    accepted: &[Candidate],
) -> Option<String> {
    let fit = &candidate.fit;
    let span = span_of(&fit.configuration);
    let least = match fit.geometry.kind {
        JointKind::Fixed => return Some("it does not move".to_owned()),
        JointKind::Prismatic => MIN_SLIDE_M,
        _ => MIN_TURN_RAD,
    };
    if span < least {
        return Some(format!("it moves by {span:.3} only"));
    }
    if candidate.frames.len() < MIN_FRAMES {
        return Some(format!("it is seen in {} frames only", candidate.frames.len()));
    }
    let way =
        extent(candidate.motion.base_from_part.iter().flatten().map(|p| p.translation.vector));
    if fit.position_rmse > MAX_POSITION_RMSE_M + MAX_RMSE_SHARE * way {
        return Some(format!("it departs from any joint by {:.3} m", fit.position_rmse));
    }
    if fit.outlier_ratio > MAX_OUTLIER_RATIO {
        return Some(format!("no joint explains {:.0} % of it", 100.0 * fit.outlier_ratio));
    }
    let rest = resting_share(&recording.ego_motion, &candidate.motion.tracks, REST_FRAMES);
    if rest < MIN_REST_SHARE {
        return Some(format!("only {:.0} % of it ever rests", 100.0 * rest));
    }
    let through = seen_through_share(recording, candidate);
    if through > MAX_SEEN_THROUGH {
        return Some(format!("{:.0} % of it is seen through", 100.0 * through));
    }
    if accepted.iter().any(|b| correlation(candidate, b) > MAX_CORRELATION) {
        return Some("it moves as a part does that more tracks vouch for".to_owned());
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::candidate::fit_to_base;
    use super::super::pose_optimisation::PartMotion;
    use super::*;
    use crate::learn::ego_motion::{BaseObservation, EgoMotion, Information, TrackInBase};
    use crate::learn::keyframes::Keyframes;
    use crate::learn::tracking::TrackSet;
    use crate::math::rigid::Pose;
    use nalgebra::{Point3, Vector3};
    use std::sync::Arc;

    const FRAMES: usize = 60;

    /// Why a part that slides by `way` metres between two rests, or without any, is refused.
    fn reason_for(way: f64, rests: bool, accepted: bool) -> Option<String> {
        let z = |f: usize| {
            let moved = if rests { f.clamp(20, 40) - 20 } else { f / 3 };
            1.5 - way * moved as f64 / 20.0
        };
        let information = Information::new(&Vector3::z(), 0.001, 0.001);
        let seen = |f| Some(BaseObservation::new(Point3::new(0.0, 0.0, z(f)), information, 0.001));
        let points = (0..FRAMES).map(seen).collect();
        let track = Arc::new(TrackInBase { points, moves: true, ..TrackInBase::default() });
        let recording = Recording {
            tracks: TrackSet { frame_utimes: (0..FRAMES as i64).collect(), tracks: Vec::new() },
            ego_motion: EgoMotion {
                camera_from_base: vec![Pose::identity(); FRAMES],
                tracks: vec![track],
                static_count: 0,
            },
            keyframes: Keyframes::new(2),
        };
        let pose = |f| Some(Pose::translation(0.0, 0.0, z(f)));
        let motion =
            PartMotion { base_from_part: (0..FRAMES).map(pose).collect(), tracks: vec![0] };
        let candidate = fit_to_base(motion).unwrap();
        let others = if accepted { vec![candidate.clone()] } else { Vec::new() };
        rejection_reason(&recording, &candidate, &others)
    }

    #[test]
    fn a_drawer_that_is_pulled_and_rests_is_believed() {
        assert_eq!(reason_for(0.3, true, false), None);
    }

    #[test]
    fn what_hardly_moves_is_refused() {
        let reason = reason_for(0.04, true, false).unwrap();
        assert!(reason.contains("moves by") || reason.contains("does not move"), "{reason}");
    }

    #[test]
    fn what_never_rests_is_a_hand() {
        assert_eq!(reason_for(0.3, false, false).unwrap(), "only 0 % of it ever rests");
    }

    #[test]
    fn what_moves_as_an_accepted_part_does_is_a_consequence_of_it() {
        assert!(reason_for(0.3, true, true).unwrap().starts_with("it moves as a part does"));
    }
}
