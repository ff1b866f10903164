//! Verification of a joint: it is confronted with the depth pictures, outlier tracks and frames that
//! the pictures contradict are taken out of it, and what then speaks for and against it is returned
//! as its [`Evidence`]. Whether that suffices is decided elsewhere (`decision`).

use super::association::associate;
use super::decision::{self, decide};
use super::estimate::JointEstimate;
use super::evidence::Evidence;
use super::growth::HOPELESSLY_UNCOVERED;
use super::search_state::SearchState;
use super::tracks_in_part_frame::TracksInFrame;

/// Rounds of association after tracks or frames were taken out.
const ROUNDS: usize = 2;
/// Share of points seen through from which no frame is worth taking out: all contradict.
const HOPELESS_VIOLATION: f64 = 0.95;
/// Fewest frames that must be left when frames are taken out.
const MIN_FRAMES_LEFT: usize = 10;
/// Fewest tracks that must follow the joint then.
const MIN_TRACKS_LEFT: usize = 4;

/// What pictures, tracks and the parent say of a joint as it is.
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
    Evidence {
        free_space_violation: seen.violation,
        discriminability: seen.discriminability,
        unobserved_ratio: seen.unobserved_ratio,
        unattached_ratio: seen.unattached_ratio,
        parent_correlation,
        uncovered_ratio,
        configuration_from_depth,
        contradicted_frames: seen.contradicted_frames,
    }
}

/// Verifies a joint: returns it without outlier tracks and without frames that the pictures
/// contradict, with its evidence. `how` it came about is traced.
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

/// Takes out tracks that only held the part, and refines the joint on the others: outliers drew its
/// line.
pub fn without_outliers(
    search: &SearchState,
    view: &TracksInFrame,
    mut joint: JointEstimate,
) -> JointEstimate {
    if !search.config().dismiss_strangers {
        return joint;
    }
    let inliers = search.free_space().inlier_members(&joint, &search.joints);
    if inliers.len() < joint.members.len() {
        joint.members.clone_from(&inliers);
        associate(view, &mut joint, &inliers, ROUNDS);
    }
    joint
}

/// Takes back configurations that the pictures contradict. The joint stays as it is where hardly any
/// track would follow it then.
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

/// Traces a joint with its evidence, and why it is rejected, if it is.
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

    /// What verification makes of the drawer, changed before.
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

    /// For some frames the front is away: what the tracks followed is not it.
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
        let config = JointSearchConfig { dismiss_strangers: false, ..Default::default() };
        let recording = drawer_recording(|_| 2.4);
        with_search(&recording, &config, &WarmStart::default(), |search| {
            let joint = drawer(&search.base_view, always);
            let kept = without_outliers(search, &search.base_view, joint);
            assert_eq!(kept.members.len(), ON_FRONT);
        });
    }
}
