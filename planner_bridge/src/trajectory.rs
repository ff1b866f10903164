//! Time-optimal motion of one joint from rest to rest under limits of velocity, acceleration
//! and jerk (Berscheid & Kröger 2021, through rsruckig).

use crate::limits::MotionLimits;
use linkage_realtime::{JointMotion, Segment};
use rsruckig::prelude::*;

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

/// A trajectory that cannot be computed.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum TrajectoryError {
    /// A value is not finite.
    #[error("from {from} to {to}: both must be finite")]
    NotFinite {
        /// Start.
        from: f64,
        /// End.
        to: f64,
    },
    /// The time-optimal solver gave up.
    #[error("from {from} to {to}: no trajectory under the rig's limits ({reason})")]
    Unsolved {
        /// Start.
        from: f64,
        /// End.
        to: f64,
        /// The solver's word.
        reason: String,
    },
}

/// Seconds between knots at least, and hardly more where that does not make too many.
const KNOT_PERIOD: f64 = 0.02;
/// Knots at most: a slow motion has them farther apart.
const MAX_KNOTS: usize = 400;
/// Share of the limits that is used at least.
const LEAST_USED: f64 = 0.5;

/// Limits below the given ones by what rounding positions to single floats makes of their
/// differences from knot to knot, so that a planner which receives them finds the given ones held.
fn with_room_for_rounding(limits: &MotionLimits, largest: f64) -> MotionLimits {
    let nearest = largest.abs() as f32;
    let step = f64::from(nearest.next_up()) - f64::from(nearest);
    let less = |limit: f64, noise: f64| (0.9995 * limit - noise).max(LEAST_USED * limit);
    MotionLimits {
        velocity: less(limits.velocity, step / KNOT_PERIOD),
        acceleration: less(limits.acceleration, 2.0 * step / KNOT_PERIOD.powi(2)),
        jerk: less(limits.jerk, 4.0 * step / KNOT_PERIOD.powi(3)),
    }
}

/// The motion of a joint from rest to rest as fast as the limits allow.
///
/// # Errors
/// [`TrajectoryError`].
pub fn time_optimal(
    joint: &str,
    from: f64,
    to: f64,
    limits: &MotionLimits,
) -> Result<JointMotion, TrajectoryError> {
    if !(from.is_finite() && to.is_finite()) {
        return Err(TrajectoryError::NotFinite { from, to });
    }
    let unsolved = |reason: String| TrajectoryError::Unsolved { from, to, reason };
    let built = |segments: &[Segment], duration| {
        JointMotion::new(joint, segments, duration, to)
            .map_err(|_| unsolved(format!("\"{joint}\" is too long a name")))
    };
    if (to - from).abs() < 1e-9 {
        return built(&[Segment { position: from, ..Segment::default() }], KNOT_PERIOD);
    }
    let mut solver = Ruckig::<1, ThrowErrorHandler>::new(None, KNOT_PERIOD);
    let mut input = InputParameter::new(None);
    input.current_position[0] = from;
    input.target_position[0] = to;
    let limits = with_room_for_rounding(limits, from.abs().max(to.abs()));
    input.max_velocity[0] = limits.velocity;
    input.max_acceleration[0] = limits.acceleration;
    input.max_jerk[0] = limits.jerk;
    let mut trajectory = Trajectory::new(None);
    solver.calculate(&input, &mut trajectory).map_err(|e| unsolved(e.to_string()))?;
    let profile = &trajectory.get_profiles()[0][0];
    let mut start = 0.0;
    let mut segments = [Segment::default(); 7];
    for (i, segment) in segments.iter_mut().enumerate() {
        *segment = Segment {
            start,
            position: profile.p[i],
            velocity: profile.v[i],
            acceleration: profile.a[i],
            jerk: profile.j[i],
        };
        start = profile.t_sum[i];
    }
    built(&segments, trajectory.get_duration())
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn limits_hold_and_the_target_is_reached(
            from in -2.0..2.0_f64, to in -2.0..2.0_f64,
            velocity in 0.1..2.0_f64, acceleration in 0.2..4.0_f64, jerk in 0.5..20.0_f64,
        ) {
            let limits = MotionLimits { velocity, acceleration, jerk };
            let knots = knots(&time_optimal("joint1", from, to, &limits).unwrap());
            prop_assert!(knots.len() >= 2);
            prop_assert_eq!(knots[0].t, 0.0);
            prop_assert!((knots[0].q - from).abs() < 1e-9);
            prop_assert_eq!(knots.last().unwrap().q, to);
            for pair in knots.windows(2) {
                prop_assert!(pair[1].t > pair[0].t);
                prop_assert!(pair[1].qd.abs() <= velocity * (1.0 + 1e-9));
                prop_assert!(pair[1].qdd.abs() <= acceleration * (1.0 + 1e-9));
                let jerk_seen = (pair[1].qdd - pair[0].qdd) / (pair[1].t - pair[0].t);
                prop_assert!(jerk_seen.abs() <= jerk * (1.0 + 1e-6));
                // Nothing overshoots.
                prop_assert!(pair[1].q >= from.min(to) - 1e-9 && pair[1].q <= from.max(to) + 1e-9);
            }
        }
    }

    #[test]
    fn nan_is_refused() {
        let limits = MotionLimits { velocity: 1.0, acceleration: 1.0, jerk: 1.0 };
        assert!(time_optimal("joint1", f64::NAN, 1.0, &limits).is_err());
    }
}
