//! Evidence for a state: its score, the parts that are seen, and the configurations that are determined.
//!
//! In: the verdict on a state, its inliers and its normal equations.
//! Out: a score, the probability that the state is right, the parts that were themselves seen, the joints of which
//! both sides were seen, and the standard deviation of each configuration (rad or m).
//! From: ours; the probability is a logistic curve through the pairs of `bench --suite recognise`.

use super::config::RecogniseConfig;
use super::hypothesis;
use super::kinematics::{Articulated, ChainJoint, State};
use super::matching::Match;
use super::normal_equations::System;
use super::verdict::Verdict;
use crate::object::joint_geometry::JointKind;

/// A state that was refined from a hypothesis, and its comparison with the image.
pub struct RefinedPose {
    /// Pose and configurations.
    pub state: State,
    /// Score of the state, 0 to 1.
    pub score: f64,
    /// Number of places with matches that agree geometrically.
    pub inliers: usize,
    /// Comparison with the image.
    pub verdict: Verdict,
}

/// A state of the object, and what is determined of it.
pub struct Detection {
    /// Pose and configurations, including those that are not determined.
    pub state: State,
    /// Score of the state, 0 to 1.
    pub score: f64,
    /// Number of places with matches that agree geometrically.
    pub inliers: usize,
    /// Comparison with the image.
    pub verdict: Verdict,
    /// For each part, true if seen evidence fixes its place.
    pub placed: Vec<bool>,
    /// For each joint, true if its configuration is determined.
    pub evident: Vec<bool>,
    /// Standard deviation of each configuration, rad or m, if it is known.
    pub deviations: Vec<Option<f64>>,
}

/// True if the score is high enough for the object to be reported.
pub fn is_believed(score: f64, config: &RecogniseConfig) -> bool {
    probability(score) >= config.min_score
}

/// Score of a state, 0 to 1: appearance times free space times edges times agreement, which is smaller with little
/// evidence; limited to the tests that the configuration switches on.
pub fn score_of(verdict: &Verdict, inliers: usize, config: &RecogniseConfig) -> f64 {
    let appearance = if config.compare_colour { verdict.appearance_score() } else { 1.0 };
    let free_space = if config.check_free_space { verdict.free_space() } else { 1.0 };
    let edges = if config.check_edges { verdict.edge_score() } else { 1.0 };
    appearance * free_space * edges * verdict.agreement(inliers)
}

/// For each part, true if features or surface of its own are seen where the state puts it.
pub fn placed_parts(
    articulated: &Articulated,
    matches: &[Match],
    state: &State,
    verdict: &Verdict,
) -> Vec<bool> {
    (0..articulated.parts)
        .map(|part| {
            let features = hypothesis::unique_inliers(articulated, matches, state, Some(part));
            features >= 4 || verdict.parts[part].is_seen()
        })
        .collect()
}

/// For each joint, true if a placed part is on either side of it.
pub fn evident_joints(articulated: &Articulated, placed: &[bool]) -> Vec<bool> {
    (0..articulated.joints.len())
        .map(|j| {
            let moved = articulated.moved_by(j);
            let on = |side: bool| {
                (0..articulated.parts).any(|p| placed[p] && moved.contains(&p) == side)
            };
            on(true) && on(false)
        })
        .collect()
}

/// Factor on the standard deviation that the residuals give: errors of neighbouring surfels are correlated, so that
/// they count as fewer.
const SCATTER_WORTH: f64 = 2.0;
/// Smallest standard deviation of a hinge's configuration, radians: the error of model and camera, however many
/// surfels agree.
const LEAST_TURN_DEVIATION: f64 = 0.008;
/// Smallest standard deviation of a slide's configuration, metres.
const LEAST_SLIDE_DEVIATION: f64 = 0.0015;

/// Standard deviation of each configuration, rad or m, by the normal equations at a state.
pub fn configuration_deviations(articulated: &Articulated, system: &System) -> Vec<Option<f64>> {
    let of_all = system.deviations();
    let of_joint = |(joint, deviation): (&ChainJoint, &Option<f64>)| {
        let least = match joint.geometry.kind {
            JointKind::Prismatic => LEAST_SLIDE_DEVIATION,
            _ => LEAST_TURN_DEVIATION,
        };
        deviation.map(|d| least.hypot(SCATTER_WORTH * d))
    };
    articulated.joints.iter().zip(&of_all[6..]).map(of_joint).collect()
}

/// Largest error of a configuration that is reported: metres for slides, radians for all others.
pub fn told_within(kind: JointKind) -> f64 {
    if kind == JointKind::Prismatic { 0.02 } else { 0.087 }
}

/// Withdraws configurations whose standard deviation is too large to be useful: a locker's door held by two features
/// was at 0.85 rad with a deviation of 1.2.
pub fn withdraw_uncertain(articulated: &Articulated, found: &mut Detection) {
    let joints = articulated.joints.iter().zip(&found.deviations);
    for (evident, (joint, deviation)) in found.evident.iter_mut().zip(joints) {
        *evident &= deviation.is_none_or(|d| d < told_within(joint.geometry.kind));
    }
}

/// Largest probability: the share of right reports among those with a perfect score.
const CEILING: f64 = 0.97;
/// Score at which the probability is half of [`CEILING`].
const EVEN: f64 = 0.42;
/// Steepness of the logistic curve at [`EVEN`].
const STEEPNESS: f64 = 16.0;

/// Probability that a state with this score is right: a logistic curve through the pairs of
/// `bench --suite recognise`, which prints how well it fits.
pub fn probability(score: f64) -> f64 {
    CEILING / (1.0 + (-STEEPNESS * (score - EVEN)).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn a_better_verdict_is_more_probable_and_none_is_certain() {
        let at = |score| probability(score);
        assert!(at(0.0) < 0.002 && at(0.2) < 0.05);
        assert!((1..=100).all(|i| at(f64::from(i) / 100.0) > at(f64::from(i - 1) / 100.0)));
        assert!(at(1.0) < 0.98);
    }

    #[test]
    fn a_configuration_that_may_be_anything_is_not_told() {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let joints = vec![ChainJoint::new(hinge, [0, 1], [0.0, 1.4])];
        let articulated = Articulated { parts: 2, joints };
        let is_told = |deviation| {
            let state = State { camera_from_object: Pose::identity(), q: vec![0.9] };
            let mut found = Detection {
                state,
                score: 0.9,
                inliers: 9,
                verdict: Verdict::default(),
                placed: vec![true; 2],
                evident: vec![true],
                deviations: vec![deviation],
            };
            withdraw_uncertain(&articulated, &mut found);
            found.evident[0]
        };
        assert!(is_told(Some(0.06)) && !is_told(Some(1.2)));
        assert!(is_told(None), "without depth nothing tells how sure it is");
    }

    #[test]
    fn a_joint_is_evident_where_something_on_either_side_of_it_is_seen() {
        let hinge = || JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let joint = |parts| ChainJoint::new(hinge(), parts, [0.0, 1.0]);
        let articulated = Articulated { parts: 3, joints: vec![joint([0, 1]), joint([1, 2])] };
        assert_eq!(evident_joints(&articulated, &[true, false, true]), [true, true]);
        assert_eq!(evident_joints(&articulated, &[true, true, false]), [true, false]);
        assert_eq!(evident_joints(&articulated, &[false, true, false]), [false, false]);
    }
}
