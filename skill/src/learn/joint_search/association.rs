//! Data association over the whole recording: which tracks follow a joint, and which configuration they
//! give it in each frame. Each round gathers the tracks that follow the joint, refines it on some of
//! them, and lets them vote for the configuration of every frame.
//!
//! In: a joint and candidate tracks in the frame of its parent, metres.
//! Out: the joint with its line, configurations (radians or metres), members, gain, cost and range.

use super::bundle_adjustment::{FINISH_STEPS, OUTLIER_CUT, locate_points, refine};
use super::configuration_vote::{Voters, vote};
use super::estimate::{JointEstimate, TrackCost};
use super::tracks_in_part_frame::TracksInFrame;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Largest number of tracks in a bundle adjustment.
pub const ADJUSTED_TRACKS: usize = 150;
/// Largest number of frames in a bundle adjustment, besides the anchor; neighbouring frames are
/// redundant.
pub const ADJUSTED_FRAMES: usize = 60;
/// Gain subtracted for each known frame, so that a joint must explain more than its own parameters.
pub const FRAME_PENALTY: f64 = 1.5;
/// Largest number of tracks that vote for a frame's configuration.
const VOTERS: usize = 100;
/// Share of a track's observations that must be inliers for the track to stay a candidate in the next
/// round.
const HOPELESS_SHARE: f64 = 0.3;

/// A track that follows a joint, with its costs.
pub struct Follower {
    /// Row of the track in the view.
    pub track: usize,
    /// Cost of the track if it stood still.
    still: f64,
    /// Cost of the track under the joint.
    cost: f64,
    observations: usize,
}

/// Gathers members, refines the joint on them and estimates every frame's configuration, `rounds`
/// times; then computes members, gain, cost and range.
pub fn associate(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    candidates: &[usize],
    rounds: usize,
) {
    let mut rng = ChaCha8Rng::seed_from_u64(candidates.len() as u64);
    let mut candidates = candidates.to_vec();
    for round in 0..rounds {
        let cut = if round == 0 { 2.0 * OUTLIER_CUT } else { OUTLIER_CUT };
        let members: Vec<usize> =
            gather(view, joint, &mut candidates, cut).into_iter().map(|m| m.track).collect();
        if members.len() < 4 {
            break;
        }
        let mut some = members.clone();
        if some.len() > ADJUSTED_TRACKS {
            some.shuffle(&mut rng);
            some.truncate(ADJUSTED_TRACKS);
            some.sort_unstable();
        }
        let known = std::mem::take(&mut joint.known);
        joint.known = thinned(&known, joint.anchor, ADJUSTED_FRAMES);
        refine(joint, view, &some, OUTLIER_CUT, FINISH_STEPS);
        locate_points(joint, view, &members, OUTLIER_CUT);
        joint.known = known;
        estimate_configurations(view, joint, &members, OUTLIER_CUT, VOTERS);
    }
    let followers = gather(view, joint, &mut candidates, OUTLIER_CUT);
    let gain: f64 = followers.iter().map(|m| m.still - m.cost).sum();
    let cost: f64 = followers.iter().map(|m| m.cost).sum();
    let observations: usize = followers.iter().map(|m| m.observations).sum();
    let known = joint.known.iter().filter(|k| **k).count();
    joint.gain = gain / 5.0 - FRAME_PENALTY * (known + 5) as f64;
    joint.cost = cost / observations.max(1) as f64;
    joint.members = followers.into_iter().map(|m| m.track).collect();
    joint.summarise();
}

/// Tracks that follow the joint: at least five observations, over 70 % of them inliers, clearly better
/// explained than by rest, and moved by more than 1.2 cm. Candidates with few inliers are removed from
/// the list.
pub fn gather(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    candidates: &mut Vec<usize>,
    cut: f64,
) -> Vec<Follower> {
    locate_points(joint, view, candidates, 2.0 * cut);
    let motions = joint.motions();
    let judged: Vec<(bool, Option<Follower>)> = candidates
        .par_iter()
        .map(|&track| {
            let cost = joint.cost_of(&motions, view, track, cut);
            let right = cost.inliers as f64 / cost.observations.max(1) as f64;
            let is_right = cost.observations >= 5 && right > 0.7;
            let follower = is_right.then(|| follower(view, joint, track, &cost, cut)).flatten();
            (cost.observations < 5 || right > HOPELESS_SHARE, follower)
        })
        .collect();
    let mut hopeful = judged.iter().map(|(hopeful, _)| *hopeful);
    candidates.retain(|_| hopeful.next().unwrap_or(true));
    judged.into_iter().filter_map(|(_, follower)| follower).collect()
}

/// The track as a follower of the joint; `None` where rest explains it nearly as well, or where it
/// hardly moves.
fn follower(
    view: &TracksInFrame,
    joint: &JointEstimate,
    track: usize,
    cost: &TrackCost,
    cut: f64,
) -> Option<Follower> {
    let still = view.static_cost(track, &joint.known, cut);
    let follows = still - cost.sum > 2.0 * cut && joint.travel(view, track) > 0.012;
    follows.then_some(Follower { track, still, cost: cost.sum, observations: cost.observations })
}

/// Estimates the configuration of every frame by the vote of at most `voters` members.
pub fn estimate_configurations(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    members: &[usize],
    cut: f64,
    voters: usize,
) {
    let in_frame = |f: usize| -> Option<f64> {
        if !view.usable[f] || joint.evidence.contradicted_frames.contains(&f) {
            return None;
        }
        let alive: Vec<usize> =
            members.iter().copied().filter(|&t| view.at(t, f).is_some()).collect();
        configuration(view, joint, alive, (cut, voters), f)
    };
    let configured: Vec<Option<f64>> = (0..view.frames).into_par_iter().map(in_frame).collect();
    for (f, configuration) in configured.into_iter().enumerate() {
        joint.known[f] = configuration.is_some();
        joint.q[f] = configuration.unwrap_or(joint.q[f]);
    }
}

/// Configuration of a frame, if enough of the members that are seen in it vote for it. Two members are
/// too few for a vote; the present configuration is kept.
fn configuration(
    view: &TracksInFrame,
    joint: &JointEstimate,
    alive: Vec<usize>,
    (cut, voters): (f64, usize),
    frame: usize,
) -> Option<f64> {
    let guess = joint.known[frame].then_some(joint.q[frame]);
    match alive.len() {
        0 | 1 => return None,
        2 => return guess,
        _ => {}
    }
    let alive = evenly_spread(alive, voters);
    let weights = vec![1.0; alive.len()];
    let voters = Voters { view, tracks: &alive, weights: &weights };
    let outcome = vote(joint, &voters, frame, guess, cut);
    let enough = outcome.agreeing as f64 >= (0.4 * alive.len() as f64).max(3.0);
    enough.then_some(outcome.q)
}

/// At most `most` elements of a list, evenly spread.
pub fn evenly_spread(all: Vec<usize>, most: usize) -> Vec<usize> {
    let stride = all.len().div_ceil(most).max(1);
    all.into_iter().step_by(stride).collect()
}

/// At most `most` of the known frames, evenly spread, and the anchor if it is known.
pub fn thinned(known: &[bool], anchor: usize, most: usize) -> Vec<bool> {
    let stride = known.iter().filter(|k| **k).count().div_ceil(most).max(1);
    let mut before = 0;
    let mut kept = |(f, &known): (usize, &bool)| {
        before += usize::from(known);
        known && (before % stride == 1 % stride || f == anchor)
    };
    known.iter().enumerate().map(&mut kept).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_along;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn tracks_that_follow_a_slide_are_members_and_those_that_rest_are_not() {
        let q = |f: usize| 0.005 * f as f64;
        let path = |i: usize| -> Vec<Point3<f64>> {
            let moved = if i < 10 { 1.0 } else { 0.0 };
            (0..40).map(|f| Point3::new(moved * q(f), 0.03 * i as f64, 1.0)).collect()
        };
        let paths: Vec<_> = (0..20).map(path).collect();
        let view = TracksInFrame::from_base(&seen_along(&paths), (0..20).collect());
        let slide = ScrewJoint::slide(Vector3::x(), Point3::new(0.0, 0.0, 1.0));
        let mut joint = JointEstimate::new(slide, &view, 0);
        joint.q = (0..40).map(q).collect();
        joint.known = vec![true; 40];
        let all: Vec<usize> = (0..20).collect();
        associate(&view, &mut joint, &all, 2);
        assert_eq!(joint.members, (0..10).collect::<Vec<_>>());
        assert!((joint.span() - q(39)).abs() < 0.005, "{}", joint.span());
        assert!(joint.gain > 0.0 && joint.cost < 3.0);
    }

    #[test]
    fn a_thinned_choice_of_frames_keeps_the_anchor() {
        let kept = thinned(&[true; 100], 37, 10);
        assert!(kept[37] && kept.iter().filter(|k| **k).count() <= 11);
    }
}
