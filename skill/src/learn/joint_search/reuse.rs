//! Reuse of the joints that a search over fewer frames found: they are carried on to the present
//! frame. Those that are beyond doubt are adopted; the others compete with what else can be grown,
//! and so do those that are lost while what was adopted moves.

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

/// Adopts the earlier search's joints that are beyond doubt, in the base frame and in the frames of
/// the parts that are adopted, and returns the others.
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

/// The earlier search's joints in the frame of a part, carried on to the present, and whether their
/// types were certain; `None` where the earlier search did not know the part or too little moves.
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

/// A joint of the earlier search does in the frames since what it did before. While more frames come
/// it may do so less well: what moves on its part is only just beginning to.
fn goes_on(search: &SearchState, joint: &JointEstimate) -> bool {
    let config = search.config();
    let new = &joint.known[search.earlier.frames..];
    let followed = new.iter().filter(|k| **k).count();
    let is_tolerable = || {
        !search.is_the_end()
            && is_segment(joint, config)
            && joint.evidence.uncovered_ratio <= config.max_unruly
    };
    10 * followed >= 9 * new.len() && (accepts(joint, config) || is_tolerable())
}
