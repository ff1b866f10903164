//! Final refinement of the adopted joints, on more tracks and frames than during growth, parents
//! first.
//!
//! In: adopted joints in the frames of their parents. Out: the refined joints in the same frames;
//! metres and radians.

use super::association::{estimate_configurations, evenly_spread, thinned};
use super::bundle_adjustment::{FINISH_STEPS, OUTLIER_CUT, locate_points, refine};
use super::estimate::JointEstimate;
use super::search_state::SearchState;
use super::tracks_in_part_frame::TracksInFrame;
use rayon::prelude::*;

/// Largest number of tracks that the final refinement uses and that vote for a configuration.
const TRACKS: usize = 300;
/// Largest number of frames that the final refinement uses, besides the anchor.
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
