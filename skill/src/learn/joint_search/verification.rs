//! Verification of a joint by depth images: outlier tracks and frames that the images contradict
//! are removed from it, and its [`Evidence`] is computed. The decision on it is made in `decision`.
//!
//! In: a candidate in the frame of its parent, and the keyframes of the recording.
//! Out: the candidate without outliers, with its evidence (shares from 0 to 1).

use super::association::associate;
use super::decision::{self, decide, may_be_accepted};
use super::estimate::JointEstimate;
use super::evidence::Evidence;
use super::former_place::share_still_there;
use super::growth::HOPELESSLY_UNCOVERED;
use super::search_state::SearchState;
use super::tracks_in_part_frame::TracksInFrame;

/// Number of association rounds after tracks or frames were removed.
const ROUNDS: usize = 2;
/// Share of points seen through from which no frames are removed, because all of them contradict
/// the joint.
const HOPELESS_VIOLATION: f64 = 0.95;
/// Smallest number of known frames with which a joint is associated again after frames were
/// removed.
const MIN_FRAMES_LEFT: usize = 10;
/// Smallest number of tracks that must follow the joint after frames were removed; with fewer, the
/// removal is undone.
const MIN_TRACKS_LEFT: usize = 4;

/// Computes the evidence for a joint as it is, from depth images, tracks and its parent.
pub fn evaluate(search: &SearchState, view: &TracksInFrame, joint: &JointEstimate) -> Evidence {
    let before = &joint.evidence;
    let parent_correlation = search.parent_correlation(joint, joint.parent);
    let uncovered_ratio = joint.uncovered_ratio(view);
    let Some(seen) = search.free_space().evidence(joint, &search.joints) else {
        let free_space_violation = 1.0;
        let before = before.clone();
        return Evidence { free_space_violation, parent_correlation, uncovered_ratio, ..before };
    };
    // Keyframes that were dropped since the last verification keep their configurations.
    let mut configuration_from_depth = before.configuration_from_depth.clone();
    for (frame, q) in seen.configurations {
        configuration_from_depth[frame] = q;
    }
    let evidence = Evidence {
        free_space_violation: seen.violation,
        discriminability: seen.discriminability,
        unobserved_ratio: seen.unobserved_ratio,
        unattached_ratio: seen.unattached_ratio,
        parent_correlation,
        uncovered_ratio,
        still_there_ratio: 0.0,
        is_parallel_sibling: before.is_parallel_sibling,
        configuration_from_depth,
        contradicted_frames: seen.contradicted_frames,
    };
    // Images are compared last, because this takes longest.
    if !search.is_the_end() || !may_be_accepted(joint, &evidence, search.config()) {
        return evidence;
    }
    let still_there_ratio = share_still_there(search.recording, view, joint, &search.joints);
    Evidence { still_there_ratio, ..evidence }
}

/// Verifies a joint: removes outlier tracks and frames that depth images contradict, and adds the
/// evidence. `candidates` are tracks that may follow the joint; `how` the joint came about is
/// logged.
pub fn verify(
    search: &SearchState,
    view: &TracksInFrame,
    joint: JointEstimate,
    candidates: &[usize],
    how: &str,
) -> JointEstimate {
    let verified = verified(search, view, joint, candidates);
    trace(search, how, &verified);
    verified
}

fn verified(
    search: &SearchState,
    view: &TracksInFrame,
    mut joint: JointEstimate,
    candidates: &[usize],
) -> JointEstimate {
    if search.is_cancelled() {
        return joint;
    }
    let parent_correlation = search.parent_correlation(&joint, joint.parent);
    if !decision::is_worth_verifying(&joint, parent_correlation) {
        joint.evidence = Evidence { parent_correlation, ..joint.evidence };
        return joint;
    }
    if joint.uncovered_ratio(view) <= HOPELESSLY_UNCOVERED {
        joint = without_outliers(search, view, joint);
        joint.evidence = evaluate(search, view, &joint);
        let seen = &joint.evidence;
        if !seen.contradicted_frames.is_empty() && seen.free_space_violation < HOPELESS_VIOLATION {
            return without_contradicted_frames(search, view, joint, candidates);
        }
        return joint;
    }
    joint.evidence = evaluate(search, view, &joint);
    joint
}

/// Removes tracks that depth images contradict, such as those of a hand that held the part, and
/// refines the joint on the others, because outliers displaced its line.
pub fn without_outliers(
    search: &SearchState,
    view: &TracksInFrame,
    mut joint: JointEstimate,
) -> JointEstimate {
    if !search.config().remove_outliers {
        return joint;
    }
    let inliers = search.free_space().inlier_members(&joint, &search.joints);
    if inliers.len() < joint.members.len() {
        joint.members.clone_from(&inliers);
        associate(view, &mut joint, &inliers, ROUNDS);
    }
    joint
}

/// Removes configurations that depth images contradict. The joint is returned unchanged if fewer
/// than [`MIN_TRACKS_LEFT`] tracks would follow it then.
fn without_contradicted_frames(
    search: &SearchState,
    view: &TracksInFrame,
    joint: JointEstimate,
    candidates: &[usize],
) -> JointEstimate {
    let mut left = joint.clone();
    for &f in &joint.evidence.contradicted_frames {
        left.known[f] = false;
    }
    if left.known_frames().len() >= MIN_FRAMES_LEFT {
        associate(view, &mut left, candidates, ROUNDS);
        left = without_outliers(search, view, left);
        left.evidence = evaluate(search, view, &left);
    } else {
        left.evidence = Evidence {
            parent_correlation: search.parent_correlation(&left, left.parent),
            uncovered_ratio: left.uncovered_ratio(view),
            ..left.evidence
        };
    }
    if left.members.len() < MIN_TRACKS_LEFT { joint } else { left }
}

/// Logs a joint with its evidence and, if it is rejected, the reason.
fn trace(search: &SearchState, how: &str, joint: &JointEstimate) {
    let evidence = &joint.evidence;
    tracing::debug!(
        how,
        parent = joint.parent.map_or(0, |p| p + 1),
        kind = joint.dof.geometry().kind.name(),
        axis = format!("{:.2?}", joint.dof.axis.as_slice()),
        origin = format!("{:.2?}", joint.dof.origin.coords.as_slice()),
        gain = joint.gain as i64,
        members = joint.members.len(),
        span = format!("{:.2}", joint.span()),
        cost = format!("{:.2}", joint.cost),
        frames = joint.known_frames().len(),
        free_space_violation = format!("{:.2}", evidence.free_space_violation),
        unobserved = format!("{:.2}", evidence.unobserved_ratio),
        unattached = format!("{:.2}", evidence.unattached_ratio),
        discriminability = format!("{:.2}", evidence.discriminability),
        parent_correlation = format!("{:.2}", evidence.parent_correlation),
        uncovered = format!("{:.2}", evidence.uncovered_ratio),
        log_odds = format!("{:.1}", decision::log_odds(joint, evidence)),
        still_there = format!("{:.2}", evidence.still_there_ratio),
        rejected = decide(joint, evidence, search.config()).err().map(tracing::field::display),
        "joint"
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::config::JointSearchConfig;
    use crate::learn::joint_search::test_data::{
        FRAMES, ON_FRONT, drawer, drawer_recording, front, with_search,
    };
    use crate::learn::joint_search::warm_start::WarmStart;

    /// The evidence for a drawer whose pictures show a board at some depth.
    fn evidence(board_at: fn(usize) -> f64, known: fn(usize) -> bool) -> Evidence {
        let recording = drawer_recording(board_at);
        let config = JointSearchConfig::default();
        with_search(&recording, &config, &WarmStart::default(), |search| {
            let joint = drawer(&search.base_view, known);
            evaluate(search, &search.base_view, &joint)
        })
    }

    fn always(_: usize) -> bool {
        true
    }

    /// The drawer after a `change`, before and after verification.
    fn verified_as(
        board_at: impl Fn(usize) -> f64,
        change: fn(&mut JointEstimate),
    ) -> (JointEstimate, JointEstimate) {
        let recording = drawer_recording(board_at);
        let config = JointSearchConfig::default();
        with_search(&recording, &config, &WarmStart::default(), |search| {
            let mut joint = drawer(&search.base_view, always);
            change(&mut joint);
            let all: Vec<usize> = (0..ON_FRONT).collect();
            (joint.clone(), verify(search, &search.base_view, joint, &all, "in a test"))
        })
    }

    #[test]
    fn pictures_that_show_a_part_where_it_goes_speak_for_it() {
        let seen = evidence(front, always);
        assert!(seen.free_space_violation < 0.05, "{}", seen.free_space_violation);
        assert!(seen.discriminability > 0.3, "{}", seen.discriminability);
        assert_eq!((seen.uncovered_ratio, seen.parent_correlation), (0.0, 0.0));
        assert!(seen.contradicted_frames.is_empty());
        assert!(seen.is_found_everywhere());
    }

    #[test]
    fn a_part_that_pictures_see_through_is_contradicted() {
        assert!(evidence(|_| 2.4, always).free_space_violation > 0.9);
    }

    #[test]
    fn where_tracks_give_no_configuration_the_pictures_do() {
        let seen = evidence(front, |f| f < 40);
        assert!((seen.uncovered_ratio - 1.0 / 3.0).abs() < 1e-9);
        let q = seen.configuration_from_depth[54];
        assert!((q - (1.5 - front(54))).abs() < 0.02, "{q}");
        assert!(seen.configuration_from_depth[55].is_nan(), "no keyframe");
    }

    #[test]
    fn a_true_joint_comes_out_as_it_went_in_with_its_evidence() {
        let (before, after) = verified_as(front, |_| {});
        assert_eq!(after.members, before.members);
        assert_eq!(after.known, before.known);
        assert!(after.evidence.is_found_everywhere());
    }

    /// Depth of the drawer's front as the images show it: behind the tracked front for some frames.
    fn away(f: usize) -> f64 {
        if (24..30).contains(&f) { 2.4 } else { front(f) }
    }

    #[test]
    fn frames_around_pictures_that_see_through_it_are_contradicted() {
        let contradicted = evidence(away, always).contradicted_frames;
        assert_eq!((contradicted.iter().min(), contradicted.iter().max()), (Some(&22), Some(&29)));
    }

    #[test]
    fn a_joint_is_not_known_where_the_pictures_contradict_it() {
        let (before, after) = verified_as(away, |_| {});
        assert!(before.known[24] && before.known[27]);
        assert!(!after.known[24] && !after.known[27]);
        assert!(after.known_frames().len() > FRAMES / 2);
    }

    #[test]
    fn a_joint_of_few_tracks_is_not_compared_with_pictures() {
        let (_, after) = verified_as(|_| 2.4, |joint| joint.members.truncate(2));
        assert_eq!(after.evidence.free_space_violation, 0.0);
        assert!(after.evidence.configuration_from_depth.iter().all(|q| q.is_nan()));
    }

    #[test]
    fn tracks_stay_where_outliers_are_not_to_be_taken_out() {
        let config = JointSearchConfig { remove_outliers: false, ..Default::default() };
        let recording = drawer_recording(|_| 2.4);
        with_search(&recording, &config, &WarmStart::default(), |search| {
            let joint = drawer(&search.base_view, always);
            let kept = without_outliers(search, &search.base_view, joint);
            assert_eq!(kept.members.len(), ON_FRONT);
        });
    }
}
