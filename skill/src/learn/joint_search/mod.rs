//! The default method: joints of one degree of freedom are fitted directly to the tracks, with one
//! configuration q(t) for all of them. A rigid motion in a short window of time is a hypothesis; a
//! joint is grown from it over the recording and gathers its tracks. Poses, tree and covariance
//! follow from the joints.
//!
//! In: a [`Recording`]: tracks in the base frame, metres, and keyframes with depth.
//! Out: joints in the object frame, which is the base frame at the first frame; metres, radians.
//! From: ours. The paper clusters tracks first (III-B), then estimates poses (III-C) and models
//! (III-D). Here a joint is accepted only if it explains its tracks and the depth images of the
//! keyframes do not contradict it: a hand moves with what it holds, but is there for part of the
//! recording only.

mod adoption;
mod association;
mod bundle_adjustment;
mod candidates;
pub(crate) mod config;
mod configuration_vote;
mod correlation;
mod decision;
mod estimate;
mod evidence;
mod former_place;
mod free_space_check;
mod growth;
mod helical_pitch;
mod merge_segments;
mod motion_hypotheses;
mod propagation;
mod refinement;
mod reparent;
mod reuse;
mod screw_joint;
mod search_state;
mod selection;
mod siblings;
#[cfg(test)]
pub(crate) mod test_data;
mod to_model;
mod track_scores;
mod tracks_in_part_frame;
mod type_selection;
mod verification;
mod warm_start;
mod weighed_evidence;
mod window_fit;

use super::learned_joint::LearnedJoints;
use super::recording::Recording;
use crate::object::model::Joint;
pub use config::SearchSettings;
use estimate::JointEstimate;
use search_state::SearchState;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tracks_in_part_frame::TracksInFrame;
pub use warm_start::WarmStart;

/// Largest number of rounds; each adopts one joint and searches the tracks that no joint explains.
const ROUNDS: usize = 4;

/// Finds the joints of a complete demonstration, starting from the result of an `earlier` search
/// over its first frames. If no joint is found so, the search is repeated without the earlier
/// joints.
pub fn learn(
    recording: &Recording,
    earlier: &WarmStart,
    settings: &SearchSettings,
) -> LearnedJoints {
    let moving = Arc::new(TracksInFrame::moving(&recording.ego_motion));
    let from_nothing: WarmStart;
    let mut search = SearchState::new(recording, *settings, &moving, earlier, None);
    find_joints(&mut search);
    if search.joints.is_empty() && earlier.frames > 0 {
        from_nothing = search.to_warm_start().without_joints();
        search = SearchState::new(recording, *settings, &moving, &from_nothing, None);
        find_joints(&mut search);
    }
    refinement::refine_joints(&mut search);
    let joints = to_model::learned_joints(&search);
    LearnedJoints { joints, rejections: search.rejections, ..LearnedJoints::default() }
}

/// Searches the frames recorded so far, so that the search after the last frame is shorter. Returns
/// the warm start of the next search and, if `reports_joints`, the joints. A search that is
/// `cancelled` stops early and returns an empty warm start.
pub fn search_ahead(
    recording: &Recording,
    earlier: &WarmStart,
    settings: &SearchSettings,
    cancelled: &AtomicBool,
    reports_joints: bool,
) -> (WarmStart, Option<Vec<Joint>>) {
    let moving = Arc::new(TracksInFrame::moving(&recording.ego_motion));
    let mut search = SearchState::new(recording, *settings, &moving, earlier, Some(cancelled));
    find_joints(&mut search);
    if search.is_cancelled() {
        return (WarmStart::default(), None);
    }
    let joints = || to_model::learned_joints(&search).into_iter().map(|l| l.joint).collect();
    (search.to_warm_start(), reports_joints.then(joints))
}

/// Adopts the best candidate of each round until none is accepted, then attaches joints of the base
/// to the moving parts that carry them.
fn find_joints(search: &mut SearchState) {
    let mut unexplained: Vec<usize> = (0..search.base_view.len()).collect();
    // Candidates of one round need not be grown again in the next.
    let mut candidates = reuse::reuse_joints(search, &mut unexplained);
    for round in 0..ROUNDS {
        if search.is_cancelled() {
            return;
        }
        candidates = candidates::grow_candidates(search, candidates, &unexplained, round);
        let mut best = selection::best_of(search, &candidates);
        if best.is_none() && search.is_rescan_due() {
            candidates = candidates::rescan(search, candidates, &unexplained, round);
            best = selection::best_of(search, &candidates);
        }
        let Some(best) = best else { break };
        let best = adoption::with_its_segments(search, best, &candidates, &unexplained);
        candidates = adoption::adopt(search, best, candidates, &mut unexplained);
    }
    if search.is_the_end() {
        candidates = find_siblings(search, candidates, &mut unexplained);
        search.rejections = selection::rejections(search, &candidates);
    }
    if search.config().chains && !search.is_cancelled() {
        reparent::reparent(search);
    }
}

/// Adopts the best sibling of an adopted joint until none is accepted. Returns the candidates that remain, with the
/// siblings that are not accepted.
fn find_siblings(
    search: &mut SearchState,
    mut candidates: Vec<JointEstimate>,
    unexplained: &mut Vec<usize>,
) -> Vec<JointEstimate> {
    for round in 0..ROUNDS {
        let siblings = siblings::grow_siblings(search, unexplained, round);
        let Some(best) = selection::best_of(search, &siblings) else {
            candidates.extend(siblings);
            break;
        };
        candidates = adoption::adopt(search, best, candidates, unexplained);
    }
    candidates
}

#[cfg(test)]
mod tests {
    use super::test_data::{FRAMES, drawer_recording as recording, front};
    use super::*;
    use crate::learn::joint_search::config::JointSearchConfig;
    use crate::object::joint_geometry::JointKind;

    fn learned(recording: &Recording, earlier: &WarmStart) -> LearnedJoints {
        let joints = JointSearchConfig::default();
        let settings = SearchSettings { joints: &joints, seed: 1 };
        learn(recording, earlier, &settings)
    }

    #[test]
    fn a_drawer_that_pictures_show_is_the_only_joint() {
        let LearnedJoints { joints, .. } = learned(&recording(front), &WarmStart::default());
        assert_eq!(joints.len(), 1);
        let joint = &joints[0].joint;
        assert_eq!((joint.kind, joint.parent, joint.child), (JointKind::Prismatic, 0, 1));
        assert!(joint.axis[2].abs() > 0.999, "{:?}", joint.axis);
        assert!((joint.range[1] - joint.range[0] - 0.3).abs() < 0.01, "{:?}", joint.range);
        assert_eq!(joints[0].tracks.len(), 60);
    }

    #[test]
    fn what_pictures_see_through_is_rejected_and_the_reason_is_told() {
        let LearnedJoints { joints, rejections, .. } =
            learned(&recording(|_| 2.4), &WarmStart::default());
        assert!(joints.is_empty());
        let said: Vec<String> = rejections.iter().map(ToString::to_string).collect();
        assert!(said.iter().any(|s| s.contains("it was seen through at")), "{said:?}");
    }

    #[test]
    fn a_search_ahead_tells_its_joints_unless_it_was_cancelled() {
        let joints = JointSearchConfig::default();
        let settings = SearchSettings { joints: &joints, seed: 1 };
        let go_on = AtomicBool::new(false);
        let through = recording(|_| 2.4);
        let nothing = WarmStart::default();
        let (earlier, told) = search_ahead(&through, &nothing, &settings, &go_on, true);
        assert_eq!((earlier.frames, told), (FRAMES, Some(Vec::new())));
        let stopped = AtomicBool::new(true);
        let (ended, told) = search_ahead(&through, &nothing, &settings, &stopped, true);
        assert_eq!((ended.frames, told), (0, None));
    }
}
