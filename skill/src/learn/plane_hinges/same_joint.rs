//! Tests whether two joints show the same motion: tracks and planes may each show one part.

use crate::learn::learned_joint::LearnedJoint;
use crate::math::rigid::{distance_to_line, line_angle};
use crate::math::robust::Moments;
use crate::object::model::Joint;

/// Largest angle between the axes of one hinge from tracks and from planes, radians.
const SAME_DIRECTION_RAD: f64 = 0.2;
/// Largest distance between the lines of one hinge from tracks and from planes, metres.
const SAME_PLACE_M: f64 = 0.15;
/// Squared correlation of two configurations above which one joint is a consequence of the other.
const MAX_CORRELATION: f64 = 0.8;
/// Fewest common times that determine how two configurations correlate.
const MIN_COMMON: usize = 5;
/// Gain in log-likelihood below which a joint of tracks gives way to a plain part that moves
/// together with it.
pub const MEAGRE_GAIN: f64 = 1000.0;
/// Shares of its largest configuration from which a part is away from its rest, and up to which it is at rest.
const AWAY: f64 = 0.4;
const AT_REST: f64 = 0.15;
/// Fewest keyframes in which one of two parts must be away alone for them to take turns.
const MIN_ALONE: usize = 3;
/// Difference below which two times are of one frame, seconds.
const SAME_TIME_S: f64 = 1e-4;

/// True if a known joint shows what a plain part does.
pub fn is_known(joint: &LearnedJoint, plain: &LearnedJoint) -> bool {
    is_same_hinge(&joint.joint, &plain.joint) || !is_meagre(joint) && moves_together(joint, plain)
}

/// True if few tracks show the joint: its gain is small.
pub fn is_meagre(learned: &LearnedJoint) -> bool {
    learned.joint.log_likelihood < MEAGRE_GAIN
}

/// True if the configuration of one joint is nearly a linear function of the other's.
pub fn moves_together(a: &LearnedJoint, b: &LearnedJoint) -> bool {
    let common = at_common_times(a, b);
    common.len() >= MIN_COMMON
        && Moments::of(&common).correlation_sq().is_some_and(|share| share > MAX_CORRELATION)
}

/// True if each of two joints is away from its rest while the other one is at rest: they are two parts, however near
/// their lines are, like two letter trays above each other.
pub fn take_turns(a: &LearnedJoint, b: &LearnedJoint) -> bool {
    let common = at_common_times(a, b);
    let most =
        |j: &LearnedJoint| j.joint.configuration.iter().map(|q| q[1].abs()).fold(0.0, f64::max);
    let (of_a, of_b) = (most(a), most(b));
    let alone = |is_alone: &dyn Fn(f64, f64) -> bool| {
        common.iter().filter(|(a, b)| is_alone(a.abs() / of_a, b.abs() / of_b)).count()
    };
    alone(&|a, b| a > AWAY && b < AT_REST) >= MIN_ALONE
        && alone(&|a, b| b > AWAY && a < AT_REST) >= MIN_ALONE
}

/// Configurations of two joints at the times at which both are known.
fn at_common_times(a: &LearnedJoint, b: &LearnedJoint) -> Vec<(f64, f64)> {
    let of_b = &b.joint.configuration;
    let at = |time: f64| of_b.iter().find(|[t, _]| (t - time).abs() < SAME_TIME_S);
    a.joint.configuration.iter().filter_map(|[t, q]| Some((*q, at(*t)?[1]))).collect()
}

/// True if both joints are of one kind and have about the same line.
pub fn is_same_hinge(tracked: &Joint, plain: &Joint) -> bool {
    let axis = tracked.axis.into();
    tracked.kind == plain.kind
        && line_angle(&axis, &plain.axis.into()) < SAME_DIRECTION_RAD
        && distance_to_line(&tracked.origin.into(), &axis, &plain.origin.into()) < SAME_PLACE_M
}
