//! Weighs all evidence on a candidate together: much evidence for it outweighs a limit that it breaks.
//!
//! In: a candidate with its evidence, and for how long it rests; metres, radians, shares from 0 to 1.
//! Out: the logarithm of the odds that the candidate is a joint.
//! From: logistic regression, one for hinges and one for slides, where each joint has the same weight, and so have the
//! false candidates of each demonstration. It was fitted on 2 300 candidates of 173 demonstrations: five lists of
//! household things by a separate renderer, and the simulator's things in a plain room and in a home. `README.md` gives
//! what it found on the lists when it was fitted on the others.

use super::estimate::JointEstimate;
use super::evidence::Evidence;
use super::free_space_check::SILENT;

/// Weights for hinges. (What is seen through told nothing of them beyond its own limit.)
const HINGE: Weights = Weights {
    offset: -4.5,
    cost: -1.0,
    through: 0.0,
    missing: -2.7,
    uncovered: -2.4,
    discriminability: 6.9,
    way: 5.3,
    rest: 3.1,
    sibling: 2.1,
    gain: 0.0,
    most_way: 1.0,
    least_discriminability: SILENT,
    sure: 1.5,
};
/// Weights for slides.
const SLIDE: Weights = Weights {
    offset: -4.8,
    cost: -0.2,
    through: -5.2,
    missing: -2.2,
    uncovered: -2.4,
    discriminability: 4.4,
    way: 3.6,
    rest: 1.6,
    sibling: 4.5,
    gain: 0.47,
    most_way: 0.25,
    least_discriminability: 0.3,
    sure: 1.2,
};
/// Fewest frames for which a candidate must rest when it is first or last known. Persons who walk past slide by 0.7 m
/// and rest for one to six frames. Of 41 true joints whose odds are high enough, three rest for fewer than eight.
const LEAST_REST: usize = 8;
/// Largest share of uncovered observations of what is sure. A trunk that bends turned by 1.1 rad between two rests, and
/// left 0.47 uncovered.
const MOST_UNCOVERED: f64 = 0.4;
/// Discriminability from which more of it is no further evidence.
const MOST_DISCRIMINABILITY: f64 = 0.6;
/// Number of frames of rest from which more of them are no further evidence.
const MOST_REST: f64 = 30.0;
/// Gain that is neither evidence for a slide nor against it.
const NEUTRAL_GAIN: f64 = 300.0;
/// Least gain that is distinguished.
const LEAST_GAIN: f64 = 50.0;

/// Weight of each kind of evidence, per unit, and what is needed to be sure; for one type of joint.
struct Weights {
    /// Logarithm of the odds of a candidate without any evidence.
    offset: f64,
    /// Mean cost of an observation.
    cost: f64,
    /// Share of the points that are seen through.
    through: f64,
    /// Share of the points, over all frames, that depth images do not show.
    missing: f64,
    /// Share of the tracks' observations in frames of unknown configuration.
    uncovered: f64,
    /// Share of the points that would be seen through half a range aside.
    discriminability: f64,
    /// Turn or travel, as a share of the most that counts.
    way: f64,
    /// Longest rest at either end, as a share of the most that counts.
    rest: f64,
    /// 1 for a parallel sibling of an adopted joint.
    sibling: f64,
    /// Natural logarithm of the gain's ratio to the neutral gain.
    gain: f64,
    /// Turn, radians, or travel, metres, from which more of it is no further evidence.
    most_way: f64,
    /// Smallest discriminability. A trunk that followed a door by 0.3 m and came back had 0.21 as a slide.
    least_discriminability: f64,
    /// Logarithm of the odds from which a candidate is a joint though it breaks a limit. False candidates reached 1.3
    /// (hinges) and 0.9 (slides) by weights that were fitted on the other lists.
    sure: f64,
}

impl Weights {
    /// The weights for a candidate's type.
    fn of(joint: &JointEstimate) -> &'static Self {
        if joint.dof.hinge { &HINGE } else { &SLIDE }
    }
}

/// True if all evidence together makes it sure that a candidate is a joint. What depth images do not discriminate is
/// never sure: corners between a person's outline and a wall slide along the wall, far and at rest in between, and a
/// trunk that goes along with a door slides far between two rests. Nor is what hardly rests, as a person who walks past.
/// `longest_rest`: number of frames for which the candidate rests when it is first or last known.
pub fn is_sure(joint: &JointEstimate, evidence: &Evidence, longest_rest: usize) -> bool {
    let weights = Weights::of(joint);
    longest_rest >= LEAST_REST
        && evidence.uncovered_ratio <= MOST_UNCOVERED
        && evidence.discriminability >= weights.least_discriminability
        && log_odds(joint, evidence, longest_rest) >= weights.sure
}

/// Logarithm of the odds that a candidate is a joint.
pub fn log_odds(joint: &JointEstimate, evidence: &Evidence, longest_rest: usize) -> f64 {
    let weights = Weights::of(joint);
    weights.offset
        + weights.cost * joint.cost
        + weights.through * evidence.free_space_violation
        + weights.missing * joint.missing_share(evidence)
        + weights.uncovered * evidence.uncovered_ratio
        + weights.discriminability * evidence.discriminability.min(MOST_DISCRIMINABILITY)
        + weights.way * (joint.span() / weights.most_way).min(1.0)
        + weights.rest * (longest_rest as f64 / MOST_REST).min(1.0)
        + weights.sibling * f64::from(u8::from(evidence.is_parallel_sibling))
        + weights.gain * (joint.gain.max(LEAST_GAIN) / NEUTRAL_GAIN).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::{Point3, Vector3};

    const FRAMES: usize = 100;

    /// A slide that is known in all frames, with the evidence of a drawer that a person opens and closes.
    fn drawer() -> JointEstimate {
        let slide = ScrewJoint::slide(Vector3::z(), Point3::origin());
        let mut joint =
            JointEstimate::new(slide, &seen_moving(&slide, &[Point3::origin()], &[0.0; FRAMES]), 0);
        joint.known = vec![true; FRAMES];
        joint.range = [0.0, 0.25];
        (joint.gain, joint.cost) = (1300.0, 3.0);
        joint.evidence.discriminability = 0.5;
        joint
    }

    fn with(change: impl Fn(&mut Evidence)) -> JointEstimate {
        let mut joint = drawer();
        change(&mut joint.evidence);
        joint
    }

    fn discriminated(mut joint: JointEstimate, discriminability: f64) -> JointEstimate {
        joint.evidence.discriminability = discriminability;
        joint
    }

    fn is_sure(joint: &JointEstimate) -> bool {
        super::is_sure(joint, &joint.evidence, 20)
    }

    /// A hinge with the same evidence.
    fn door() -> JointEstimate {
        let dof = ScrewJoint::hinge(Vector3::x(), Point3::origin());
        JointEstimate { dof, range: [0.0, 1.0], ..drawer() }
    }

    #[test]
    fn what_goes_far_and_is_confirmed_by_all_pictures_is_sure() {
        assert!(is_sure(&drawer()) && is_sure(&door()));
    }

    #[test]
    fn worse_evidence_of_any_kind_makes_the_odds_worse() {
        let odds = |joint: &JointEstimate| log_odds(joint, &joint.evidence, 20);
        let best = odds(&drawer());
        let half_unknown = |joint: JointEstimate| JointEstimate {
            known: (0..FRAMES).map(|f| f < 50).collect(),
            ..joint
        };
        let worse = [
            with(|e| e.free_space_violation = 0.2),
            with(|e| e.uncovered_ratio = 0.3),
            with(|e| e.discriminability = 0.3),
            half_unknown(with(|e| e.unobserved_ratio = 0.6)),
            JointEstimate { range: [0.0, 0.1], ..drawer() },
            JointEstimate { cost: 4.0, ..drawer() },
            JointEstimate { gain: 400.0, ..drawer() },
        ];
        for (i, joint) in worse.iter().enumerate() {
            assert!(odds(joint) < best, "evidence {i}");
        }
        assert!(log_odds(&drawer(), &drawer().evidence, 2) < best, "it hardly rests");
        let of_doors = [
            JointEstimate { range: [0.0, 0.4], ..door() },
            JointEstimate { cost: 4.0, ..door() },
            discriminated(door(), 0.3),
        ];
        assert!(of_doors.iter().all(|joint| odds(joint) < odds(&door())));
        assert!(odds(&with(|e| e.is_parallel_sibling = true)) > best);
    }

    #[test]
    fn no_gain_makes_sure_what_depth_images_do_not_discriminate() {
        let along_a_wall = with(|e| (e.discriminability, e.is_parallel_sibling) = (0.2, true));
        let far = JointEstimate { gain: 1e6, range: [0.0, 0.6], ..along_a_wall };
        assert!(log_odds(&far, &far.evidence, 50) > SLIDE.sure && !is_sure(&far));
    }

    #[test]
    fn a_person_who_walks_past_is_not_sure_however_well_pictures_show_it() {
        let walks = discriminated(drawer(), 1.0);
        let walks = JointEstimate { range: [0.0, 0.73], gain: 15_000.0, cost: 4.1, ..walks };
        assert!(log_odds(&walks, &walks.evidence, 1) > SLIDE.sure);
        assert!(!super::is_sure(&walks, &walks.evidence, 1));
    }

    #[test]
    fn a_person_who_sways_is_not_sure_however_much_is_gained() {
        let trunk = discriminated(door(), 0.4);
        let trunk = JointEstimate { range: [0.0, 0.2], gain: 31_000.0, cost: 3.8, ..trunk };
        assert!(!super::is_sure(&trunk, &trunk.evidence, 40));
    }

    #[test]
    fn more_of_what_is_enough_changes_nothing() {
        let enough = log_odds(&drawer(), &drawer().evidence, 30);
        assert_eq!(log_odds(&drawer(), &drawer().evidence, 90), enough);
        let far = JointEstimate { range: [0.0, 0.8], ..drawer() };
        assert_eq!(log_odds(&far, &far.evidence, 30), enough);
    }
}
