//! Candidate search: motion hypotheses in the frames of the base and of moving parts, each grown over
//! time and verified.
//!
//! In: the candidates that are known already and the tracks that no joint explains.
//! Out: all candidates in the frames of their parents, accepted or not.

use super::config::JointSearchConfig;
use super::correlation::{ALLOWED_CORRELATION, MAX_CORRELATION, moves_during};
use super::decision::accepts;
use super::estimate::JointEstimate;
use super::growth::grow_hypothesis;
use super::motion_hypotheses::{COVERED, Hypothesis, hypotheses};
use super::screw_joint::ScrewJoint;
use super::search_state::{MIN_MOVING, SearchState};
use super::tracks_in_part_frame::TracksInFrame;
use super::verification::verify;
use super::warm_start::RejectedHypothesis;
use crate::math::robust::overlap;
use rayon::prelude::*;
use std::sync::Arc;

/// Largest number of hypotheses that are grown when a background search scans all windows again.
const RESCANNED_IN_BACKGROUND: usize = 4;
/// Hypotheses grown by the rescan after the last frame; fewer, because a user waits.
const RESCANNED_AT_END: usize = 2;
/// Smallest rank of a hypothesis that is grown, as a share of the strongest hypothesis's rank.
const MIN_RANK_SHARE: f64 = 0.02;
/// Number of hypotheses that are grown in parallel.
const BATCH: usize = 2;
/// Largest error of an accepted joint that explains a hypothesis, as a share of the displacement.
const ACCEPTED_SHARE: f64 = 0.5;
/// Largest error of a candidate that is not accepted and explains a hypothesis, as a share of the
/// displacement.
const REJECTED_SHARE: f64 = 0.25;
/// Share of tracks in common from which two candidates are the same.
const SAME: f64 = 0.9;

/// Motion hypotheses in the frame of one part.
struct FrameCandidates {
    /// Number of the part's joint; `None` for the base.
    parent: Option<usize>,
    view: Arc<TracksInFrame>,
    /// Tracks that move in the frame of the part.
    moving: Vec<usize>,
    /// Motion hypotheses, the strongest first.
    hypotheses: Vec<Hypothesis>,
}

/// Candidates in the frames of the base and of all parts: those that are `known`, and those that are
/// newly grown.
pub fn grow_candidates(
    search: &mut SearchState,
    known: Vec<JointEstimate>,
    unexplained: &[usize],
    round: usize,
) -> Vec<JointEstimate> {
    let parts = if search.config().chains { search.joints.len() } else { 0 };
    let of = |parent| -> Vec<JointEstimate> {
        known.iter().filter(|j| j.parent == parent).cloned().collect()
    };
    let parents = std::iter::once(None).chain((0..parts).map(Some));
    in_frames(search, parents.map(|p| (p, of(p))).collect(), unexplained, round)
}

/// Candidates in the base frame: those that are `known`, and those grown from the hypotheses of all
/// windows of time, including the frames of the earlier search.
pub fn rescan(
    search: &mut SearchState,
    known: Vec<JointEstimate>,
    unexplained: &[usize],
    round: usize,
) -> Vec<JointEstimate> {
    search.rescans = true;
    in_frames(search, vec![(None, known)], unexplained, round)
}

fn in_frames(
    search: &mut SearchState,
    known: Vec<(Option<usize>, Vec<JointEstimate>)>,
    unexplained: &[usize],
    round: usize,
) -> Vec<JointEstimate> {
    let state = &*search;
    let mut frames: Vec<(FrameCandidates, Vec<JointEstimate>)> = known
        .into_par_iter()
        .filter_map(|(parent, known)| {
            Some((hypotheses_in_frame(state, parent, unexplained, round)?, known))
        })
        .collect();
    for (frame, _) in &mut frames {
        search.invalidated.retain(|p| *p != frame.parent);
        let strongest = frame.hypotheses.first().map_or(0.0, |h| h.rank);
        search.best_rank = strongest.max(search.best_rank);
        let least_rank = MIN_RANK_SHARE * search.best_rank;
        frame.hypotheses.retain(|h| h.rank >= least_rank);
    }
    let state = &*search;
    let found: Vec<(Vec<JointEstimate>, Vec<RejectedHypothesis>)> =
        frames.into_par_iter().map(|(f, known)| candidates_in_frame(state, &f, known)).collect();
    let mut candidates = Vec::new();
    for (grown, mut rejected) in found {
        candidates.extend(grown);
        search.rejected.append(&mut rejected);
    }
    candidates
}

/// Motion hypotheses in the frame of a part; `None` where too few tracks move.
fn hypotheses_in_frame(
    search: &SearchState,
    parent: Option<usize>,
    unexplained: &[usize],
    round: usize,
) -> Option<FrameCandidates> {
    let view = search.view_from(parent);
    let moving = search.moving_tracks(parent, &view, unexplained);
    if moving.len() < MIN_MOVING {
        return None;
    }
    let since = match search.previous_id(parent) {
        Some(previous_id) if !search.rescans && !search.invalidated.contains(&parent) => {
            search.earlier.since(previous_id)
        }
        _ => 0,
    };
    let seed = search.settings.seed.wrapping_add(round as u64);
    let hypotheses = hypotheses(&view, &moving, since, search.config(), seed);
    Some(FrameCandidates { parent, view, moving, hypotheses })
}

/// Grows and verifies the hypotheses in the frame of one part. Returns the candidates, with those that
/// are `known`, and the rejected hypotheses of the base.
fn candidates_in_frame(
    search: &SearchState,
    frame: &FrameCandidates,
    known: Vec<JointEstimate>,
) -> (Vec<JointEstimate>, Vec<RejectedHypothesis>) {
    let FrameCandidates { parent, view, moving, hypotheses } = frame;
    let grow = |h: &Hypothesis| {
        let joint = grown(search, (h, None), (*parent, view, moving))?;
        Some(verify(search, view, joint, moving, "grown"))
    };
    let config = search.config();
    let mut queue = hypotheses.iter().filter(|h| says_something(search, h, *parent, view));
    let mut limit = most_grown(search, config);
    let mut tried: Vec<&[usize]> = Vec::new();
    let (mut candidates, mut rejected) = (known, Vec::new());
    loop {
        let mut batch: Vec<&Hypothesis> = Vec::new();
        while batch.len() < BATCH.min(limit) {
            let Some(h) = queue.next() else { break };
            if is_new(search, h, *parent, view, &candidates)
                && !tried.iter().any(|t| overlap(&h.tracks, t) > COVERED)
            {
                tried.push(&h.tracks);
                let was_rejected =
                    parent.is_none() && search.rejected_before.iter().any(|r| r.covers(h));
                if !was_rejected {
                    batch.push(h);
                }
            }
        }
        if batch.is_empty() || search.is_cancelled() {
            return (candidates, rejected);
        }
        limit -= batch.len();
        let more: Vec<Option<JointEstimate>> = batch.par_iter().map(|h| grow(h)).collect();
        for (h, joint) in batch.iter().zip(&more) {
            if parent.is_none() && !joint.as_ref().is_some_and(|j| accepts(j, config)) {
                rejected.push(RejectedHypothesis::new(h, joint.as_ref(), view));
            }
        }
        candidates.extend(more.into_iter().flatten());
    }
}

/// Largest number of hypotheses that are grown in the frame of one part.
fn most_grown(search: &SearchState, config: &JointSearchConfig) -> usize {
    match (search.rescans && search.earlier.frames > 0, search.is_the_end()) {
        (false, _) => config.max_hypotheses,
        (true, false) => RESCANNED_IN_BACKGROUND,
        (true, true) => RESCANNED_AT_END,
    }
}

/// Grows a hypothesis in the frame of `parent`, about a line if it is `known`, to a candidate that is not yet verified;
/// `None` where too few of the `moving` tracks follow it.
pub fn grown(
    search: &SearchState,
    (h, known): (&Hypothesis, Option<ScrewJoint>),
    (parent, view, moving): (Option<usize>, &TracksInFrame, &[usize]),
) -> Option<JointEstimate> {
    if search.is_cancelled() {
        return None;
    }
    let is_hopeless = |j: &JointEstimate| {
        search.is_cancelled()
            || !ALLOWED_CORRELATION.contains(&search.parent_correlation(j, parent))
    };
    let mut joint = grow_hypothesis(view, (h, known), moving, search.config(), is_hopeless)?;
    joint.parent = parent;
    joint.seed.clone_from(&h.tracks);
    Some(joint)
}

/// True if a hypothesis in the frame of `part` also moves in the frame of that part's parent, and the
/// part itself moves while the tracks are seen. While the part rests, both frames show the same
/// motions; and whatever stands still beside the moving part mirrors its joint. Always true for the
/// base.
fn says_something(
    search: &SearchState,
    h: &Hypothesis,
    part: Option<usize>,
    view: &TracksInFrame,
) -> bool {
    part.map(|p| &search.joints[p]).is_none_or(|joint| {
        !h.is_still_in(&search.view_from(joint.parent)) && moves_during(joint, view, &h.tracks)
    })
}

/// True if neither an adopted joint nor a candidate is what the hypothesis would grow to.
fn is_new(
    search: &SearchState,
    h: &Hypothesis,
    parent: Option<usize>,
    view: &TracksInFrame,
    grown: &[JointEstimate],
) -> bool {
    let mut adopted = search.joints.iter().filter(|j| j.parent == parent);
    if adopted.any(|j| h.is_explained_by(j, view, ACCEPTED_SHARE)) {
        return false;
    }
    !grown.iter().any(|g| {
        // Tracks shared with an accepted joint would lead the hypothesis to that joint again.
        let sound = accepts(g, search.config()) || g.evidence.parent_correlation > MAX_CORRELATION;
        let shared = overlap(&h.tracks, &g.members);
        shared > COVERED && (sound || is_found_again(g, grown))
            || sound && shared > 0.5 * COVERED
            || overlap(&h.tracks, &g.seed) > COVERED
            || h.is_explained_by(g, view, if sound { ACCEPTED_SHARE } else { REJECTED_SHARE })
    })
}

/// True if another hypothesis grew to the same tracks already, as for a person who walks by and moves
/// in every window.
fn is_found_again(joint: &JointEstimate, grown: &[JointEstimate]) -> bool {
    grown.iter().any(|o| !std::ptr::eq(o, joint) && same_tracks(o, joint))
}

fn same_tracks(a: &JointEstimate, b: &JointEstimate) -> bool {
    overlap(&a.members, &b.members) > SAME && overlap(&b.members, &a.members) > SAME
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::{
        FRAMES, ON_FRONT, drawer, drawer_recording, front, with_search,
    };
    use crate::learn::joint_search::warm_start::WarmStart;
    use crate::math::rigid::Pose;

    fn looking<T>(look: impl FnOnce(&mut SearchState) -> T) -> T {
        let config = JointSearchConfig::default();
        with_search(&drawer_recording(front), &config, &WarmStart::default(), look)
    }

    fn all_tracks() -> Vec<usize> {
        (0..ON_FRONT).collect()
    }

    #[test]
    fn a_drawer_that_nothing_explains_yet_is_among_the_candidates() {
        looking(|search| {
            let found = grow_candidates(search, Vec::new(), &all_tracks(), 0);
            let is_drawer = |j: &&JointEstimate| {
                !j.dof.hinge
                    && j.dof.axis.z.abs() > 0.999
                    && j.members.len() == ON_FRONT
                    && (j.span() - 0.3).abs() < 0.01
            };
            let drawer = found.iter().find(is_drawer).expect("a drawer");
            assert!(accepts(drawer, search.config()) && drawer.parent.is_none());
            assert!(search.best_rank > 0.0);
        });
    }

    #[test]
    fn what_is_known_stays_a_candidate_and_is_not_grown_again() {
        looking(|search| {
            let known = drawer(&search.base_view, |_| true);
            let found = grow_candidates(search, vec![known], &all_tracks(), 0);
            assert_eq!(found.len(), 1);
        });
    }

    #[test]
    fn where_too_little_moves_nothing_is_sought_and_nothing_is_kept() {
        looking(|search| {
            let few: Vec<usize> = (0..MIN_MOVING - 1).collect();
            let known = drawer(&search.base_view, |_| true);
            assert!(grow_candidates(search, vec![known], &few, 0).is_empty());
        });
    }

    #[test]
    fn what_an_adopted_joint_does_is_nothing_new() {
        looking(|search| {
            let joint = drawer(&search.base_view, |_| true);
            let view = search.view_from(None);
            let q = |f: usize| joint.q[f];
            let motion = Pose::translation(0.0, 0.0, q(20) - q(30));
            let h = Hypothesis { from: 20, to: 30, motion, tracks: (0..20).collect(), rank: 1.0 };
            assert!(is_new(search, &h, None, &view, &[]));
            search.joints.push(joint);
            assert!(!is_new(search, &h, None, &view, &[]));
        });
    }

    #[test]
    fn a_hypothesis_in_the_frame_of_a_part_counts_while_the_part_moves() {
        looking(|search| {
            search.joints.push(drawer(&search.base_view, |_| true));
            search.renew_views(0);
            let (base, part) = (search.view_from(None), search.view_from(Some(0)));
            let h = Hypothesis {
                from: 20,
                to: 30,
                motion: Pose::identity(),
                tracks: (0..20).collect(),
                rank: 1.0,
            };
            assert!(says_something(search, &h, None, &base), "of the base");
            assert!(says_something(search, &h, Some(0), &part));
            search.joints[0].filled = vec![0.0; FRAMES];
            assert!(!says_something(search, &h, Some(0), &part), "the part rests");
        });
    }

    #[test]
    fn two_candidates_of_the_same_tracks_are_the_same() {
        looking(|search| {
            let joint = drawer(&search.base_view, |_| true);
            let mut part = joint.clone();
            part.members.truncate(30);
            assert!(same_tracks(&joint, &joint.clone()));
            assert!(!same_tracks(&joint, &part) && !same_tracks(&part, &joint));
            let all = [joint.clone(), part, joint];
            assert!(is_found_again(&all[0], &all) && is_found_again(&all[2], &all));
            assert!(!is_found_again(&all[1], &all) && !is_found_again(&all[0], &all[..1]));
        });
    }

    #[test]
    fn a_scan_of_windows_that_were_searched_before_grows_few_of_them() {
        let config = JointSearchConfig::default();
        let recording = drawer_recording(front);
        let found = looking(|search| {
            assert_eq!(most_grown(search, &config), config.max_hypotheses);
            search.to_warm_start()
        });
        with_search(&recording, &config, &found, |search| {
            assert_eq!(most_grown(search, &config), config.max_hypotheses);
            rescan(search, Vec::new(), &all_tracks(), 0);
            assert_eq!(most_grown(search, &config), RESCANNED_AT_END);
        });
    }
}
