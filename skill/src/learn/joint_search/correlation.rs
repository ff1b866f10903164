//! Dependence of one joint's configuration on another's. A hand follows what it holds; and in the
//! frame of a moving part, whatever stands still seems to move by the inverse of the part's own
//! joint.
//!
//! In: the configurations of two joints by frame, radians or metres. Out: a share, up to 1.
//! From: coefficient of determination (R squared) of a linear or quadratic fit.

use super::estimate::JointEstimate;
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::robust::{Moments, median};
use nalgebra::{DMatrix, DVector};
use std::ops::RangeInclusive;

/// Largest share of a child's configuration that may be a function of its parent's.
pub const MAX_CORRELATION: f64 = 0.85;
/// Allowed correlation with a parent. A negative value means that the parent rests in all frames in
/// which the child is known.
pub const ALLOWED_CORRELATION: RangeInclusive<f64> = 0.0..=MAX_CORRELATION;
/// Number of known frames over which the changes of two configurations are compared.
const LAG: usize = 5;
/// Fewest changes of a slide's configuration with which another slide's are compared.
const LEAST_MOVES: u32 = 8;
/// Change of a child's configuration that noise may cause, radians or metres.
const CHILD_NOISE: f64 = 0.01;

/// Share of a child's configuration, 0 to 1, that is a function of its parent's; 1 where fewer than
/// five frames are common, and -1 where the parent rests in them.
pub fn correlation_with_parent(joint: &JointEstimate, parent: &JointEstimate) -> f64 {
    let common: Vec<usize> =
        joint.known_frames().into_iter().filter(|&f| parent.known[f]).collect();
    if common.len() < 5 {
        return 1.0;
    }
    let pairs: Vec<(f64, f64)> = common.iter().map(|&f| (parent.filled[f], joint.q[f])).collect();
    let moments = Moments::of(&pairs);
    if moments.xx.sqrt() < resting_spread(parent) {
        return -1.0;
    }
    let overall = moments.correlation_sq().unwrap_or(1.0);
    overall.max(correlation_of_changes(joint, parent, &common))
}

/// Share of the changes of a child's configuration, 0 to 1, that follow from its parent's changes
/// while the parent moves. It is small for a part that the parent carries, which rests in the
/// parent's frame; a part of the base moves back there as fast as the parent moves forward.
fn correlation_of_changes(joint: &JointEstimate, parent: &JointEstimate, common: &[usize]) -> f64 {
    let (mut pp, mut cc, mut pc) = (0.0, 0.0, 0.0);
    for pair in common.windows(LAG + 1) {
        let (a, b) = (pair[0], pair[LAG]);
        let dp = parent.filled[b] - parent.filled[a];
        if b - a > 2 * LAG || dp.abs() < 0.1 * parent.span() {
            continue;
        }
        let dc = joint.q[b] - joint.q[a];
        pp += dp * dp;
        cc += dc * dc + CHILD_NOISE * CHILD_NOISE;
        pc += dp * dc;
    }
    if pp <= 0.0 { 0.0 } else { pc * pc / (pp * cc) }
}

/// Share of a joint's configuration, up to 1, that is a quadratic function of another's; 0 if fewer
/// than 80 % of the joint's known frames, or fewer than ten, are known for the other.
pub fn share_following(joint: &JointEstimate, other: &JointEstimate) -> f64 {
    let known = joint.known_frames();
    let common: Vec<usize> = known.iter().copied().filter(|&f| other.known[f]).collect();
    if common.len() < 10 || 5 * common.len() < 4 * known.len() {
        return 0.0;
    }
    let design = DMatrix::from_fn(common.len(), 3, |i, k| other.q[common[i]].powi(k as i32));
    let q = DVector::from_fn(common.len(), |i, _| joint.q[common[i]]);
    let Ok(fitted) = design.clone().svd(true, true).solve(&q, 1e-9) else { return 0.0 };
    let spread = q.add_scalar(-q.mean()).norm_squared();
    1.0 - (design * fitted - &q).norm_squared() / spread.max(f64::EPSILON)
}

/// Share of the motion of `other`, 0 to 1, during which `joint` moves the same way, at least a third as fast; 0 unless
/// both are slides of one parent, and `other` moves for a while.
pub fn share_going_along(joint: &JointEstimate, other: &JointEstimate) -> f64 {
    if joint.dof.hinge || other.dof.hinge || joint.parent != other.parent {
        return 0.0;
    }
    let same_way = joint.dof.axis.dot(&other.dof.axis);
    let common: Vec<usize> = joint.known_frames().into_iter().filter(|&f| other.known[f]).collect();
    let (mut moves, mut along) = (0, 0);
    for pair in common.windows(LAG + 1) {
        let (a, b) = (pair[0], pair[LAG]);
        let way = other.q[b] - other.q[a];
        if b - a > 2 * LAG || way.abs() < resting_spread(other) {
            continue;
        }
        moves += 1;
        let own = same_way * (joint.q[b] - joint.q[a]);
        along += u32::from(3.0 * own * way.signum() > way.abs());
    }
    if moves < LEAST_MOVES { 0.0 } else { f64::from(along) / f64::from(moves) }
}

/// Largest spread of a configuration at which a part counts as at rest, radians or metres.
fn resting_spread(joint: &JointEstimate) -> f64 {
    if joint.dof.hinge { 0.04 } else { 0.02 }
}

/// True if a part moves over the frames in which some of the `tracks` are seen; `view` holds the
/// tracks in the frame of the part.
pub fn moves_during(part: &JointEstimate, view: &TracksInFrame, tracks: &[usize]) -> bool {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (f, _) in tracks.iter().flat_map(|&t| view.life(t)) {
        low = low.min(part.filled[f]);
        high = high.max(part.filled[f]);
    }
    high - low > resting_spread(part)
}

/// By frame: true if a part is away from its median configuration over the frames in which `joint`
/// is known.
pub fn frames_away(part: &JointEstimate, joint: &JointEstimate) -> Vec<bool> {
    let mut beside: Vec<f64> = joint.known_frames().iter().map(|&f| part.filled[f]).collect();
    let usual = median(&mut beside).unwrap_or(0.0);
    part.filled.iter().map(|q| (q - usual).abs() > resting_spread(part)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::{Point3, Vector3};

    /// A slide with these configurations.
    fn slide(q: impl Fn(f64) -> f64) -> JointEstimate {
        let dof = ScrewJoint::slide(Vector3::x(), Point3::origin());
        let view = seen_moving(&dof, &[Point3::new(0.0, 0.0, 1.0)], &[0.0; 60]);
        let mut joint = JointEstimate::new(dof, &view, 0);
        joint.q = (0..60).map(|f| q(f64::from(f))).collect();
        joint.known = vec![true; 60];
        joint.summarise();
        joint
    }

    #[test]
    fn a_person_goes_along_with_what_is_pulled_and_drawers_take_turns() {
        let moved = |from: f64| move |f: f64| 0.02 * (f - from).clamp(0.0, 15.0);
        let drawer = slide(moved(10.0));
        assert!(share_going_along(&slide(|f| 0.7 * moved(10.0)(f)), &drawer) > 0.9);
        assert_eq!(share_going_along(&slide(moved(30.0)), &drawer), 0.0);
        assert_eq!(share_going_along(&slide(|f| -moved(10.0)(f)), &drawer), 0.0, "the other way");
        let slowly = slide(|f| 0.2 * moved(10.0)(f));
        assert_eq!(share_going_along(&slowly, &drawer), 0.0);
        assert_eq!(share_going_along(&drawer, &slide(|_| 0.0)), 0.0, "it rests");
        let on_it = JointEstimate { parent: Some(0), ..slide(moved(10.0)) };
        assert_eq!(share_going_along(&on_it, &drawer), 0.0, "the next slide of a telescope");
    }

    #[test]
    fn what_mirrors_its_parent_is_told_from_what_moves_by_itself() {
        let parent = slide(|f| 0.2 * (0.2 * f).sin());
        let mirror = slide(|f| -0.2 * (0.2 * f).sin());
        let own = slide(|f| 0.2 * (0.07 * f).cos());
        assert!(correlation_with_parent(&mirror, &parent) > 0.9);
        assert!(ALLOWED_CORRELATION.contains(&correlation_with_parent(&own, &parent)));
        assert_eq!(correlation_with_parent(&own, &slide(|_| 0.1)), -1.0, "the parent rests");
    }

    #[test]
    fn what_follows_another_joint_smoothly_follows_it() {
        let other = slide(|f| 0.2 * (0.05 * f).sin());
        assert!(share_following(&slide(|f| (0.2 * (0.05 * f).sin()).powi(2)), &other) > 0.99);
        assert!(share_following(&slide(|f| 0.2 * (0.9 * f).sin()), &other) < 0.5);
    }
}
