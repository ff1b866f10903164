//! Reuse of joints that a search over fewer frames found. They are carried on to the present frame;
//! those of certain type that still fit are adopted. The others compete with newly grown
//! candidates, and so do joints that are lost while the part of an adopted joint moves.
//!
//! In: the joints of the earlier search. Out: adopted joints in the search, and the others as
//! candidates; all in the frames of their parents.

use super::adoption::{add_joint, is_apart};
use super::decision::{accepts, is_segment};
use super::estimate::JointEstimate;
use super::growth::regrow;
use super::reparent::is_lost_beside;
use super::search_state::{MIN_MOVING, SearchState};
use super::selection::best_among;
use super::tracks_in_part_frame::TracksInFrame;
use super::verification::verify;
use rayon::prelude::*;

/// Adopts the joints of the earlier search that are certain, in the base frame and in the frames of
/// the parts of adopted joints. Returns the others as candidates.
pub fn reuse_joints(search: &mut SearchState, unexplained: &mut Vec<usize>) -> Vec<JointEstimate> {
    let mut doubtful: Vec<JointEstimate> = Vec::new();
    let mut parents = vec![None];
    let mut visited = 0;
    while let Some(&parent) = parents.get(visited) {
        visited += 1;
        let Some(carried) = carried_on(search, parent, unexplained) else { continue };
        if search.is_cancelled() {
            return Vec::new();
        }
        let (mut certain, mut others): (Vec<JointEstimate>, Vec<JointEstimate>) =
            (Vec::new(), Vec::new());
        for (joint, was_certain) in carried {
            let is_certain = was_certain && goes_on(search, &joint);
            if is_certain { &mut certain } else { &mut others }.push(joint);
        }
        while let Some(best) = best_among(search, &certain.iter().collect::<Vec<_>>()) {
            let explained = search.explained_tracks(&best, unexplained);
            unexplained.retain(|t| !explained.contains(t));
            certain.retain(|j| j.dof != best.dof && is_apart(j, &explained));
            others.retain(|j| is_apart(j, &explained));
            doubtful.retain(|j| is_apart(j, &explained));
            let adopted = add_joint(search, best, unexplained);
            let (lost, found): (Vec<JointEstimate>, Vec<JointEstimate>) =
                certain.into_iter().partition(|j| is_lost_beside(search, j, adopted));
            certain = found;
            others.extend(lost);
            if !parents.contains(&Some(adopted)) {
                parents.push(Some(adopted));
            }
        }
        if !others.iter().all(|j| accepts(j, search.config())) {
            search.invalidated.push(parent);
        }
        doubtful.append(&mut others);
        doubtful.append(&mut certain);
    }
    doubtful
}

/// Joints of the earlier search in the frame of a part, carried on to the present, each with true
/// if its type was certain. `None` where the earlier search did not know the part or too few tracks
/// move.
fn carried_on(
    search: &SearchState,
    parent: Option<usize>,
    unexplained: &[usize],
) -> Option<Vec<(JointEstimate, bool)>> {
    let previous_id = search.previous_id(parent)?;
    let view = search.view_from(parent);
    let moving = search.moving_tracks(parent, &view, unexplained);
    if moving.len() < MIN_MOVING {
        return None;
    }
    let mut joints = search.earlier.joints_of(previous_id, &view, &search.recording.tracks);
    joints.par_iter_mut().filter(|_| !search.is_cancelled()).for_each(|(joint, was_certain)| {
        joint.parent = parent;
        *joint = regrown(search, &view, joint.clone(), *was_certain, &moving);
    });
    Some(joints)
}

fn regrown(
    search: &SearchState,
    view: &TracksInFrame,
    joint: JointEstimate,
    was_certain: bool,
    moving: &[usize],
) -> JointEstimate {
    let joint = regrow(view, joint, was_certain, moving, search.config());
    verify(search, view, joint, moving, "reused")
}

/// True if a joint of the earlier search is known in nearly all new frames and is still accepted.
/// While frames still arrive, the limits of a segment suffice: what moves on the joint's part
/// raises its cost and may only be beginning to move.
fn goes_on(search: &SearchState, joint: &JointEstimate) -> bool {
    let config = search.config();
    let new = &joint.known[search.earlier.frames..];
    let followed = new.iter().filter(|k| **k).count();
    let is_tolerable = || {
        !search.is_the_end()
            && is_segment(joint, config)
            && joint.evidence.uncovered_ratio <= config.max_uncovered
    };
    10 * followed >= 9 * new.len() && (accepts(joint, config) || is_tolerable())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::candidates::grow_candidates;
    use crate::learn::joint_search::config::JointSearchConfig;
    use crate::learn::joint_search::selection::best_of;
    use crate::learn::joint_search::test_data::{
        ON_FRONT, drawer, drawer_recording, front, with_search,
    };
    use crate::learn::joint_search::warm_start::WarmStart;
    use crate::learn::recording::Recording;

    fn all_tracks() -> Vec<usize> {
        (0..ON_FRONT).collect()
    }

    /// What a search of the drawer's recording finds.
    fn searched(recording: &Recording) -> WarmStart {
        let config = JointSearchConfig::default();
        with_search(recording, &config, &WarmStart::default(), |search| {
            let candidates = grow_candidates(search, Vec::new(), &all_tracks(), 0);
            let best = best_of(search, &candidates).expect("the drawer");
            add_joint(search, best, &all_tracks());
            search.to_warm_start()
        })
    }

    #[test]
    fn a_joint_that_goes_on_as_before_is_adopted_and_its_tracks_are_not_searched() {
        let recording = drawer_recording(front);
        let earlier = searched(&recording);
        let mut unexplained = all_tracks();
        with_search(&recording, &JointSearchConfig::default(), &earlier, |search| {
            let doubtful = reuse_joints(search, &mut unexplained);
            assert_eq!((search.joints.len(), doubtful.len()), (1, 0));
            assert!(search.joints[0].dof.axis.z.abs() > 0.999);
            assert!(unexplained.is_empty(), "{unexplained:?}");
            assert!(search.invalidated.is_empty());
        });
    }

    #[test]
    fn a_joint_that_the_pictures_now_contradict_competes_with_others() {
        let earlier = searched(&drawer_recording(front));
        let mut unexplained = all_tracks();
        let through = drawer_recording(|_| 2.4);
        with_search(&through, &JointSearchConfig::default(), &earlier, |search| {
            let doubtful = reuse_joints(search, &mut unexplained);
            assert_eq!((search.joints.len(), doubtful.len()), (0, 1));
            assert_eq!(unexplained.len(), ON_FRONT);
            assert_eq!(search.invalidated, [None], "hypotheses of the base are grown anew");
        });
    }

    #[test]
    fn without_an_earlier_search_there_is_nothing_to_reuse() {
        let recording = drawer_recording(front);
        let config = JointSearchConfig::default();
        with_search(&recording, &config, &WarmStart::default(), |search| {
            assert!(reuse_joints(search, &mut all_tracks()).is_empty());
            assert!(search.joints.is_empty() && search.invalidated.is_empty());
        });
    }

    #[test]
    fn a_joint_goes_on_where_it_is_known_in_nearly_all_new_frames() {
        let recording = drawer_recording(front);
        let config = JointSearchConfig::default();
        let mut earlier = searched(&recording);
        earlier.frames = 40;
        with_search(&recording, &config, &earlier, |search| {
            let known_to = |last: usize| {
                let joint = drawer(&search.base_view, |f| f < last);
                let view = search.view_from(None);
                verify(search, &view, joint, &all_tracks(), "in a test")
            };
            assert!(goes_on(search, &known_to(60)));
            assert!(!goes_on(search, &known_to(50)));
        });
    }
}
