//! Growth of a joint over time, from the window in which its motion was seen to all of the
//! recording. The joint's tracks give its configuration frame by frame; the configuration
//! determines which other tracks follow it.
//!
//! In: a motion hypothesis, or a joint of an earlier search, and candidate tracks in the frame of a
//! part, metres.
//! Out: the grown joint in that frame, not yet verified.

use super::association::{ADJUSTED_TRACKS, associate, evenly_spread, gather};
use super::bundle_adjustment::{FINISH_STEPS, OUTLIER_CUT, refine};
use super::config::JointSearchConfig;
use super::decision::{HOPELESS_COST, max_segment_cost};
use super::estimate::JointEstimate;
use super::helical_pitch;
use super::motion_hypotheses::Hypothesis;
use super::propagation::propagate;
use super::screw_joint::ScrewJoint;
use super::tracks_in_part_frame::TracksInFrame;
use super::type_selection;
use super::window_fit::{window_fit_about, window_fits};
use crate::object::joint_geometry::JointKind;

/// Largest mean cost of an observation at which a window's fit is grown.
const MAX_WINDOW_COST: f64 = 5.0;
/// Largest number of tracks with which a joint is propagated, besides those of its hypothesis.
const ANCHOR_TRACKS: usize = 200;
/// A candidate that leaves more than this share of its tracks' observations unexplained is not
/// refined any further, because it would be rejected.
pub const HOPELESSLY_UNCOVERED: f64 = 0.5;
/// Number of association rounds after a joint has been propagated.
const GROWTH_ROUNDS: usize = 3;
/// Number of association rounds for a joint whose type was certain in the earlier search.
const RENEWAL_ROUNDS: usize = 1;
/// The outlier cut is widened by this factor when the pitch of a screw is estimated.
const FAR: f64 = 16.0;
/// Number of times that the pitch is estimated; after each the axis is refined.
const PITCH_ROUNDS: usize = 3;
/// Factor by which the gain of a hinge must exceed that of a slide, because a large circle imitates
/// any line.
const HINGE_ADVANTAGE: f64 = 1.03;

/// Grows a slide and a hinge from a hypothesis, or a joint about a `known` line, and returns the better one. A
/// candidate that `is_hopeless` after its propagation is not refined.
pub fn grow_hypothesis(
    view: &TracksInFrame,
    (hypothesis, known): (&Hypothesis, Option<ScrewJoint>),
    candidates: &[usize],
    config: &JointSearchConfig,
    is_hopeless: impl Fn(&JointEstimate) -> bool,
) -> Option<JointEstimate> {
    let anchors = anchor_tracks(&hypothesis.tracks, candidates);
    let mut best: Option<JointEstimate> = None;
    let fits = match known {
        Some(line) => vec![window_fit_about(view, line, hypothesis)],
        None => window_fits(view, hypothesis),
    };
    for (start, cost) in fits {
        if cost > MAX_WINDOW_COST {
            continue;
        }
        let mut grown = propagate(view, start, &anchors);
        let mut rounds = if is_hopeless(&grown) { 0 } else { GROWTH_ROUNDS };
        if rounds > 0 && anchors.len() < candidates.len() {
            associate(view, &mut grown, &anchors, 1);
            if fits_poorly(view, &grown) {
                rounds = 0;
            }
        }
        associate(view, &mut grown, candidates, rounds);
        if grown.members.len() < 4 {
            continue;
        }
        let factor = match &best {
            None => 0.0,
            Some(_) if grown.dof.hinge => HINGE_ADVANTAGE,
            Some(_) => 1.0 / HINGE_ADVANTAGE,
        };
        if best.as_ref().is_none_or(|b| grown.gain > factor * b.gain) {
            best = Some(grown);
        }
    }
    best.map(|joint| with_pitch(view, joint, candidates, config))
}

/// Propagates a joint of an earlier search from its known frames to all frames. If its type
/// `was_certain`, one round of association suffices, because a few more frames hardly change its
/// line.
pub fn regrow(
    view: &TracksInFrame,
    joint: JointEstimate,
    was_certain: bool,
    candidates: &[usize],
    config: &JointSearchConfig,
) -> JointEstimate {
    let rounds = if was_certain { RENEWAL_ROUNDS } else { GROWTH_ROUNDS };
    let mut joint = propagate(view, joint, candidates);
    associate(view, &mut joint, candidates, rounds);
    with_pitch(view, joint, candidates, config)
}

/// Tracks with which a joint is propagated: those of its hypothesis, and an even selection of the
/// others.
fn anchor_tracks(of_hypothesis: &[usize], candidates: &[usize]) -> Vec<usize> {
    let mut some = evenly_spread(candidates.to_vec(), ANCHOR_TRACKS);
    some.extend(of_hypothesis);
    some.sort_unstable();
    some.dedup();
    some
}

/// True if the candidate fits so poorly that more tracks would not make it acceptable.
fn fits_poorly(view: &TracksInFrame, grown: &JointEstimate) -> bool {
    grown.members.len() >= 4
        && (grown.cost > HOPELESS_COST * max_segment_cost()
            || grown.uncovered_ratio(view) > HOPELESSLY_UNCOVERED)
}

/// Grows a joint that advances as it turns again as a screw, because as a hinge it loses the tracks
/// that advance. The joint is returned unchanged if it does not advance or gains nothing as a
/// screw.
fn with_pitch(
    view: &TracksInFrame,
    grown: JointEstimate,
    candidates: &[usize],
    config: &JointSearchConfig,
) -> JointEstimate {
    if !config.screws || !helical_pitch::turns_enough(&grown) {
        return grown;
    }
    // A pure hinge keeps only tracks with little advance, so the tracks it rejected are used too.
    let mut screw = grown.clone();
    let followers = gather(view, &mut screw, &mut candidates.to_vec(), FAR * OUTLIER_CUT);
    let followers: Vec<usize> = followers.into_iter().map(|m| m.track).collect();
    let some = evenly_spread(followers.clone(), ADJUSTED_TRACKS);
    let Some(axis) = helical_pitch::turning_axis(&screw, view, &followers) else { return grown };
    screw.dof.axis = axis;
    for _ in 0..PITCH_ROUNDS {
        screw.dof.pitch = helical_pitch::pitch_of(&screw, view, &followers);
        if screw.dof.pitch == grown.dof.pitch {
            return grown;
        }
        refine(&mut screw, view, &some, FAR * OUTLIER_CUT, FINISH_STEPS);
    }
    let mut screw = propagate(view, screw, candidates);
    associate(view, &mut screw, candidates, GROWTH_ROUNDS);
    if screw.gain > grown.gain && is_screw(&screw, view) { screw } else { grown }
}

/// True if a screw is the most likely type of a joint. Tracks that share errors may fit a screw better than the hinge
/// that they are on.
fn is_screw(joint: &JointEstimate, view: &TracksInFrame) -> bool {
    let of_types = type_selection::type_probabilities(joint, view);
    let likeliest = of_types.iter().max_by(|a, b| a.1.total_cmp(b.1));
    likeliest.is_some_and(|(kind, _)| *kind == JointKind::Helical)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::{Point3, Vector3};

    /// Twenty points that turn by 1.2 rad in 60 frames.
    fn seen(truth: &ScrewJoint) -> (TracksInFrame, Hypothesis) {
        let q: Vec<f64> = (0..60).map(|f| 1.2 * f64::from(f) / 59.0).collect();
        let places: Vec<Point3<f64>> = (0..20)
            .map(f64::from)
            .map(|i| Point3::new(0.15 + 0.02 * i, 0.2 * (1.3 * i).sin(), 1.5))
            .collect();
        let motion = truth.geometry().motion(q[24] - q[12]);
        let tracks = (0..8).collect();
        let window = Hypothesis { from: 12, to: 24, motion, tracks, rank: 1.0 };
        (seen_moving(truth, &places, &q), window)
    }

    /// What a window of them grows to.
    fn grown(truth: &ScrewJoint) -> JointEstimate {
        let (view, window) = seen(truth);
        let all: Vec<usize> = (0..20).collect();
        let config = JointSearchConfig::default();
        grow_hypothesis(&view, (&window, None), &all, &config, |_| false).unwrap()
    }

    #[test]
    fn a_window_of_a_door_grows_to_a_hinge_of_all_its_tracks_in_all_frames() {
        let door = ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5));
        let joint = grown(&door);
        assert!(joint.dof.hinge && joint.dof.pitch.is_none());
        assert!(joint.members.len() >= 18, "{:?}", joint.members);
        assert!(joint.known.iter().all(|k| *k));
        assert!((joint.span() - 1.2).abs() < 0.05, "{}", joint.span());
    }

    #[test]
    fn what_advances_as_it_turns_grows_to_a_screw() {
        let hinge = ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5));
        let joint = grown(&ScrewJoint { pitch: Some(0.04), ..hinge });
        let pitch = joint.dof.pitch.unwrap() * joint.dof.axis.y.signum();
        assert!((pitch.abs() - 0.04).abs() < 0.005, "{pitch}");
    }

    #[test]
    fn a_door_whose_tracks_need_no_pitch_is_no_screw() {
        let door = ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5));
        let lift = ScrewJoint { pitch: Some(0.04), ..door };
        let with_pitch = |truth: &ScrewJoint, pitch: f64| {
            let mut joint = grown(truth);
            joint.dof.pitch = Some(pitch);
            is_screw(&joint, &seen(truth).0)
        };
        assert!(!with_pitch(&door, 0.001));
        let pitch = grown(&lift).dof.pitch.unwrap();
        assert!(with_pitch(&lift, pitch));
    }
}
