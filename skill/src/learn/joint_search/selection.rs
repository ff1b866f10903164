//! Selects the best candidate: the accepted one of largest gain that is not a mere consequence of
//! another joint.
//!
//! In: verified candidates in the frames of their parents.
//! Out: the candidate to adopt, or each rejected candidate with its reason.

use super::association::FRAME_PENALTY;
use super::bundle_adjustment::OUTLIER_CUT;
use super::correlation::{share_following, share_going_along};
use super::decision::{MAX_COST, Rejection, decide, min_gain};
use super::estimate::JointEstimate;
use super::merge_segments;
use super::search_state::SearchState;
use crate::learn::learned_joint::RejectedCandidate;
use crate::math::robust::overlap;

/// Largest share of a candidate's configuration that may be a function of an adopted joint's.
const MAX_FOLLOWING: f64 = 0.95;
/// Largest share of an adopted slide's motion during which a slide with noisy tracks may move the same way. A person
/// who pushed two shelves along their rails moved during all of it; drawers take turns.
const MAX_GOING_ALONG: f64 = 0.5;
/// Share of an adopted joint's gain below which the gain of a candidate is small beside it.
const LITTLE_GAIN: f64 = 0.05;
/// Share of the known frames of a joint on a part; a joint of the base that is known in more than
/// these, and has the same tracks, is preferred.
const BASE_SUFFICES: f64 = 0.8;

/// Accepted candidate of largest gain.
pub fn best_of(search: &SearchState, candidates: &[JointEstimate]) -> Option<JointEstimate> {
    best_among(search, &accepted(search, candidates))
}

/// The joint of largest gain. A joint of the base is preferred to one of a part that explains the
/// same tracks.
pub fn best_among(search: &SearchState, accepted: &[&JointEstimate]) -> Option<JointEstimate> {
    accepted
        .iter()
        .filter_map(|j| Some((gain_among(search, j, accepted).ok()?, *j)))
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, j)| j.clone())
}

/// Candidates that cannot be chosen, each with its reason.
pub fn rejections(search: &SearchState, candidates: &[JointEstimate]) -> Vec<RejectedCandidate> {
    let accepted = accepted(search, candidates);
    let reason = |j: &JointEstimate| -> Option<Rejection> {
        let decided = decide(j, &j.evidence, search.config());
        decided.and_then(|()| gain_among(search, j, &accepted).map(drop)).err()
    };
    candidates
        .iter()
        .filter_map(|joint| {
            let rejection = RejectedCandidate {
                kind: joint.dof.geometry().kind,
                tracks: joint.members.len(),
                frames: joint.known_frames().len(),
                reason: reason(joint)?.to_string(),
                needs_more: false,
            };
            tracing::debug!(%rejection, "rejected");
            Some(rejection)
        })
        .collect()
}

fn accepted<'c>(search: &SearchState, candidates: &'c [JointEstimate]) -> Vec<&'c JointEstimate> {
    let is_accepted = |j: &&JointEstimate| decide(j, &j.evidence, search.config()).is_ok();
    candidates.iter().filter(is_accepted).collect()
}

/// Gain of an accepted candidate over rest in the base frame, or the reason why it cannot be
/// chosen.
fn gain_among(
    search: &SearchState,
    joint: &JointEstimate,
    accepted: &[&JointEstimate],
) -> Result<f64, Rejection> {
    if is_explained_with_another_parent(joint, accepted) {
        return Err(Rejection::ExplainedWithAnotherParent);
    }
    if let Some(rejection) = dependence(search, joint) {
        return Err(rejection);
    }
    let gain = gain_over_base(search, joint);
    let needed = min_gain(joint, &joint.evidence);
    if gain > needed { Ok(gain) } else { Err(Rejection::LowGain { gain, needed }) }
}

/// True if an accepted candidate explains the same tracks and is preferred, where one is a joint of
/// the base and the other of a part. A joint of the base that is lost for long is carried by a part
/// that moved then.
fn is_explained_with_another_parent(joint: &JointEstimate, accepted: &[&JointEstimate]) -> bool {
    let known = |j: &JointEstimate| j.known_frames().len() as f64;
    let same_tracks = |a: &JointEstimate, b: &JointEstimate| {
        overlap(&a.members, &b.members) > 0.35 || overlap(&b.members, &a.members) > 0.6
    };
    accepted.iter().filter(|o| o.parent.is_some() != joint.parent.is_some()).any(|o| {
        let enough = if joint.parent.is_some() { BASE_SUFFICES } else { 1.0 / BASE_SUFFICES };
        same_tracks(joint, o) && known(o) > enough * known(joint)
    })
}

/// Reason to reject a candidate that depends on an adopted joint, if it does: its configuration
/// follows the joint's, and depth images do not show it everywhere (a hand that holds the part) or
/// its gain is small; or it is a slide with noisy tracks that moves along while the joint's part slides (a person who
/// pulls it); or its gain is small and it turns about the joint's line (corners between a
/// part's rim and the background); or depth images show it on the joint's part wherever that goes.
fn dependence(search: &SearchState, joint: &JointEstimate) -> Option<Rejection> {
    let is_found = joint.evidence.is_found_everywhere();
    search.joints.iter().enumerate().find_map(|(i, o)| {
        let is_little = joint.gain < LITTLE_GAIN * o.gain;
        if !is_found || is_little {
            let (share, allowed) = (share_following(joint, o), MAX_FOLLOWING);
            if share > allowed {
                return Some(Rejection::FollowsAcceptedJoint { share, allowed });
            }
        }
        if joint.cost > MAX_COST.max(o.cost) {
            let (share, allowed) = (share_going_along(joint, o), MAX_GOING_ALONG);
            if share > allowed {
                return Some(Rejection::GoesAlong { share, allowed });
            }
        }
        let is_on_line = || {
            joint.dof.hinge
                && joint.parent == o.parent
                && merge_segments::shares_line(o, joint, 1.0)
        };
        if is_little && is_on_line() {
            return Some(Rejection::OnLineOfAcceptedJoint);
        }
        let is_on_part = joint.gain < o.gain && search.free_space().is_on(joint, i, &search.joints);
        is_on_part.then_some(Rejection::OnPartOfAcceptedJoint)
    })
}

/// Gain of a joint over rest in the base frame, so that joints of different parents can be
/// compared. For a joint on a part it is reduced to 0.9 of this gain.
fn gain_over_base(search: &SearchState, joint: &JointEstimate) -> f64 {
    if joint.parent.is_none() {
        return joint.gain;
    }
    let view = search.view_from(joint.parent);
    let motions = joint.motions();
    let saved: f64 = joint
        .members
        .iter()
        .map(|&t| {
            search.base_view.static_cost(t, &joint.known, OUTLIER_CUT)
                - joint.cost_of(&motions, &view, t, OUTLIER_CUT).sum
        })
        .sum();
    let known = joint.known_frames().len();
    0.9 * (saved / 5.0 - FRAME_PENALTY * (known + 5) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::{Point3, Vector3};

    /// A joint of ten tracks that is known in `known` of a hundred frames.
    fn joint(parent: Option<usize>, known: usize) -> JointEstimate {
        let slide = ScrewJoint::slide(Vector3::x(), Point3::origin());
        let view = seen_moving(&slide, &[Point3::new(0.0, 0.0, 1.0); 10], &[0.0; 100]);
        let mut joint = JointEstimate::new(slide, &view, 0);
        joint.known = (0..100).map(|f| f < known).collect();
        joint.members = (0..10).collect();
        joint.parent = parent;
        joint
    }

    #[test]
    fn the_base_is_preferred_as_parent_unless_the_joint_is_lost_there_for_long() {
        let (of_base, of_part) = (joint(None, 90), joint(Some(0), 95));
        let both = [&of_base, &of_part];
        assert!(!is_explained_with_another_parent(&of_base, &both));
        assert!(is_explained_with_another_parent(&of_part, &both));
        let lost_on_base = joint(None, 50);
        let both = [&lost_on_base, &of_part];
        assert!(is_explained_with_another_parent(&lost_on_base, &both));
        assert!(!is_explained_with_another_parent(&of_part, &both));
    }
}
