//! Adoption of the best candidate: the other segments of time in which its joint was seen are
//! merged into it, and it becomes a joint of the search or part of one that is there already.
//!
//! In: the best candidate, the other candidates, and the tracks that no joint explains.
//! Out: the search with the joint added, and the candidates that remain. Frames do not change.

use super::decision::{MAX_COST, MAX_STILL_THERE, SEGMENT_VIOLATION_SLACK, is_segment};
use super::estimate::JointEstimate;
use super::evidence::Evidence;
use super::merge_segments::{LineMatch, adds_frames, line_match, merged};
use super::search_state::SearchState;
use super::tracks_in_part_frame::TracksInFrame;
use super::verification::{evaluate, without_outliers};
use crate::math::robust::overlap;

/// Share of a segment's tracks in the chosen joint from which the segment adds nothing.
const SAME_TRACKS: f64 = 0.7;
/// Allowance above [`MAX_COST`] for the cost of a merged joint.
const COST_SLACK: f64 = 0.6;
/// Share of a candidate's tracks explained by an adopted joint from which the candidate is dropped.
const EXPLAINED: f64 = 0.3;

/// Merges the chosen joint with those candidates that are other segments of it.
pub fn with_its_segments(
    search: &SearchState,
    mut best: JointEstimate,
    candidates: &[JointEstimate],
    unexplained: &[usize],
) -> JointEstimate {
    let config = search.config();
    if !config.merge {
        return best;
    }
    let mut others: Vec<&JointEstimate> =
        candidates.iter().filter(|j| j.parent == best.parent && is_segment(j, config)).collect();
    others.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let view = search.view_from(best.parent);
    for other in others {
        if !adds_frames(&best, other) {
            continue;
        }
        let Some(line_match) = line_match(&best, other) else { continue };
        if overlap(&other.members, &best.members) < SAME_TRACKS {
            let whole = try_merge(search, &view, [&best, other], line_match, unexplained);
            best = whole.unwrap_or(best);
        }
    }
    best
}

/// Merges two segments; returns the joint with its evidence if it explains more than each of them.
fn try_merge(
    search: &SearchState,
    view: &TracksInFrame,
    [a, b]: [&JointEstimate; 2],
    line_match: LineMatch,
    unexplained: &[usize],
) -> Option<JointEstimate> {
    let config = search.config();
    let mut candidates = unexplained.to_vec();
    candidates.extend(a.members.iter().chain(&b.members));
    candidates.sort_unstable();
    candidates.dedup();
    let mut whole = merged(view, a, b, &candidates)?;
    whole = without_outliers(search, view, whole);
    let parent_correlation = a.evidence.parent_correlation;
    whole.evidence = Evidence { parent_correlation, ..evaluate(search, view, &whole) };
    let needed = a.gain.max(b.gain) + line_match.required_gain() * a.gain.min(b.gain);
    let is_better = whole.gain > needed
        && whole.cost < MAX_COST + COST_SLACK
        && whole.evidence.free_space_violation < config.max_through + SEGMENT_VIOLATION_SLACK
        && whole.evidence.still_there_ratio <= MAX_STILL_THERE;
    tracing::debug!(gain = whole.gain as i64, before = a.gain as i64, is_better, "merge");
    is_better.then_some(whole)
}

/// Adopts a joint and removes the tracks that it explains from `unexplained`. Returns the remaining
/// candidates: those that the joint does not explain and that are not attached to its part.
pub fn adopt(
    search: &mut SearchState,
    joint: JointEstimate,
    mut candidates: Vec<JointEstimate>,
    unexplained: &mut Vec<usize>,
) -> Vec<JointEstimate> {
    let explained = search.explained_tracks(&joint, unexplained);
    let adopted = add_joint(search, joint, unexplained);
    unexplained.retain(|t| !explained.contains(t));
    candidates.retain(|j| is_apart(j, &explained) && j.parent != Some(adopted));
    candidates
}

/// True if less than `EXPLAINED` of a candidate's tracks are among the `explained` ones.
pub fn is_apart(candidate: &JointEstimate, explained: &[usize]) -> bool {
    overlap(&candidate.members, explained) < EXPLAINED
}

/// Adds a joint to the search, or merges it with one that is there already. Returns the joint's
/// number.
pub fn add_joint(search: &mut SearchState, joint: JointEstimate, unexplained: &[usize]) -> usize {
    let matching: Vec<(usize, LineMatch)> = (0..search.joints.len())
        .filter(|_| search.config().merge)
        .filter_map(|i| Some((i, line_match(&search.joints[i], &joint)?)))
        .collect();
    let view = search.view_from(joint.parent);
    let same_parent = |(i, _): &&(usize, LineMatch)| search.joints[*i].parent == joint.parent;
    let whole = matching.iter().filter(same_parent).find_map(|&(i, line_match)| {
        let segments = [&search.joints[i], &joint];
        Some((i, try_merge(search, &view, segments, line_match, unexplained)?))
    });
    if let Some((i, whole)) = whole {
        search.joints[i] = whole;
        search.renew_views(i);
        return i;
    }
    // There is only one joint on a line: one that cannot be merged with it is dropped.
    if let Some((i, _)) = matching.iter().find(|(_, line_match)| *line_match == LineMatch::Same) {
        return *i;
    }
    search.joints.push(joint);
    search.renew_views(search.joints.len() - 1);
    search.joints.len() - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::config::JointSearchConfig;
    use crate::learn::joint_search::test_data::{
        FRAMES, ON_FRONT, drawer, drawer_recording, front, with_search,
    };
    use crate::learn::joint_search::warm_start::WarmStart;

    fn looking<T>(merge: bool, look: impl FnOnce(&mut SearchState) -> T) -> T {
        let config = JointSearchConfig { merge, ..JointSearchConfig::default() };
        with_search(&drawer_recording(front), &config, &WarmStart::default(), look)
    }

    /// The opening of the drawer in two segments of time, each seen by half of its tracks and some more.
    fn segments(search: &SearchState) -> [JointEstimate; 2] {
        let half = |early: bool| {
            let mut joint = drawer(&search.base_view, |f| (f < FRAMES / 2) == early);
            joint.members = if early { (0..36).collect() } else { (24..ON_FRONT).collect() };
            joint.gain = 400.0;
            joint
        };
        [half(true), half(false)]
    }

    #[test]
    fn two_segments_of_one_drawer_become_one_joint() {
        let all: Vec<usize> = (0..ON_FRONT).collect();
        looking(true, |search| {
            let [early, late] = segments(search);
            let others = [late];
            let whole = with_its_segments(search, early.clone(), &others, &all);
            assert_eq!(whole.known_frames().len(), FRAMES);
            assert_eq!(whole.members.len(), ON_FRONT);
            assert!((whole.span() - 0.3).abs() < 0.01, "{}", whole.span());
            let alone = with_its_segments(search, early.clone(), &[], &all);
            assert_eq!(alone.known, early.known);
        });
    }

    #[test]
    fn nothing_is_merged_where_that_is_not_wanted() {
        let all: Vec<usize> = (0..ON_FRONT).collect();
        looking(false, |search| {
            let [early, late] = segments(search);
            let kept = with_its_segments(search, early.clone(), &[late], &all);
            assert_eq!(kept.known, early.known);
        });
    }

    #[test]
    fn an_adopted_joint_takes_its_tracks_and_the_candidates_of_these_with_it() {
        let mut unexplained: Vec<usize> = (0..ON_FRONT).collect();
        looking(true, |search| {
            let joint = drawer(&search.base_view, |_| true);
            let same = joint.clone();
            let mut hanging = drawer(&search.base_view, |_| true);
            (hanging.parent, hanging.members) = (Some(0), Vec::new());
            let mut apart = drawer(&search.base_view, |_| true);
            apart.members = Vec::new();
            let left = adopt(search, joint, vec![same, hanging, apart], &mut unexplained);
            assert_eq!(search.joints.len(), 1);
            assert!(unexplained.is_empty(), "{unexplained:?}");
            assert_eq!(left.len(), 1);
            assert_eq!((left[0].parent, left[0].members.len()), (None, 0));
        });
    }

    #[test]
    fn a_joint_on_the_line_of_another_is_no_joint_beside_it() {
        let all: Vec<usize> = (0..ON_FRONT).collect();
        looking(true, |search| {
            let joint = drawer(&search.base_view, |_| true);
            assert_eq!(add_joint(search, joint.clone(), &all), 0);
            assert_eq!(add_joint(search, joint.clone(), &all), 0);
            assert_eq!(search.joints.len(), 1);
            // A different line is a different joint.
            let mut across = joint;
            across.dof.axis = nalgebra::Vector3::x();
            assert_eq!(add_joint(search, across, &all), 1);
        });
    }

    #[test]
    fn a_candidate_is_apart_while_few_of_its_tracks_are_explained() {
        looking(true, |search| {
            let joint = drawer(&search.base_view, |_| true);
            assert!(is_apart(&joint, &[]));
            assert!(is_apart(&joint, &(0..17).collect::<Vec<_>>()), "17 of 60");
            assert!(!is_apart(&joint, &(0..18).collect::<Vec<_>>()), "18 of 60");
        });
    }
}
