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
