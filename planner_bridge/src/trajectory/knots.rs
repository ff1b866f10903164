//! The instants by which a motion is told to planners.
//!
//! In: a motion. Out: knots, seconds from its beginning, radians or metres and their derivatives.

use linkage_realtime::JointMotion;

/// One instant of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knot {
    /// Seconds from the start.
    pub t: f64,
    /// Configuration; rad or m.
    pub q: f64,
    /// Velocity.
    pub qd: f64,
    /// Acceleration.
    pub qdd: f64,
}

/// Seconds between knots at least, and hardly more where that does not make too many.
pub const KNOT_PERIOD: f64 = 0.02;
/// Knots at most: a slow motion has them farther apart.
const MAX_KNOTS: usize = 400;

/// Knots of a motion, evenly spread, at least two: each at a whole microsecond, the first at 0,
/// the last at rest at the target.
pub fn knots(motion: &JointMotion) -> Vec<Knot> {
    let steps = ((motion.duration() / KNOT_PERIOD) as usize).clamp(1, MAX_KNOTS - 1);
    (0..=steps)
        .map(|i| {
            let t = (motion.duration() * i as f64 / steps as f64 * 1e6).ceil() * 1e-6;
            let sample = motion.at(t);
            Knot { t, q: sample.position, qd: sample.velocity, qdd: sample.acceleration }
        })
        .collect()
}
