//! The last refinement of the joints that were found: on more tracks and more frames than while they
//! grew, parents first.

use super::association::{estimate_configurations, evenly_spread, thinned};
use super::bundle_adjustment::{FINISH_STEPS, OUTLIER_CUT, locate_points, refine};
use super::estimate::JointEstimate;
use super::search_state::SearchState;
use super::tracks_in_part_frame::TracksInFrame;
use rayon::prelude::*;

/// Tracks that the last refinement uses, and that vote for configurations.
const TRACKS: usize = 300;
/// Frames that it uses.
const FRAMES: usize = 120;

/// Refines all joints, one generation of the tree after the other.
pub fn refine_joints(search: &mut SearchState) {
    let mut generation = search.joints_with(|parent| parent.is_none());
    while !generation.is_empty() {
        let refined_joint = |&i: &usize| {
            let joint = search.joints[i].clone();
            refined(&search.view_from(joint.parent), joint)
        };
        let refined: Vec<JointEstimate> = generation.par_iter().map(refined_joint).collect();
        for (&i, joint) in generation.iter().zip(refined) {
            search.replace_refined(i, joint);
        }
        generation = search.joints_with(|parent| parent.is_some_and(|p| generation.contains(&p)));
    }
}

fn refined(view: &TracksInFrame, mut joint: JointEstimate) -> JointEstimate {
    let members = joint.members.clone();
    let some = evenly_spread(members.clone(), TRACKS);
    let known = joint.known.clone();
    joint.known = thinned(&known, joint.anchor, FRAMES);
    refine(&mut joint, view, &some, OUTLIER_CUT, FINISH_STEPS);
    joint.known = known;
    locate_points(&mut joint, view, &members, OUTLIER_CUT);
    estimate_configurations(view, &mut joint, &members, OUTLIER_CUT, TRACKS);
    joint.summarise();
    joint
}
