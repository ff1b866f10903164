//! Time-optimal motion of one joint from rest to rest under limits of velocity, acceleration
//! and jerk (Berscheid & Kröger 2021, through rsruckig).

use crate::limits::MotionLimits;
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

/// Seconds between knots.
pub const KNOT_PERIOD: f64 = 0.02;

/// Knots every [`KNOT_PERIOD`] from `from` to `to`, at rest at both ends; at least two, the
/// last exactly at the target.
///
/// # Errors
/// [`TrajectoryError`].
pub fn time_parameterise(
    from: f64,
    to: f64,
    limits: &MotionLimits,
) -> Result<Vec<Knot>, TrajectoryError> {
    if !(from.is_finite() && to.is_finite()) {
        return Err(TrajectoryError::NotFinite { from, to });
    }
    let at_rest = |t, q| Knot { t, q, qd: 0.0, qdd: 0.0 };
    if (to - from).abs() < 1e-9 {
        return Ok(vec![at_rest(0.0, from), at_rest(KNOT_PERIOD, to)]);
    }
    let unsolved = |reason: String| TrajectoryError::Unsolved { from, to, reason };
    let mut solver = Ruckig::<1, ThrowErrorHandler>::new(None, KNOT_PERIOD);
    let mut input = InputParameter::new(None);
    input.current_position[0] = from;
    input.target_position[0] = to;
    input.max_velocity[0] = limits.velocity;
    input.max_acceleration[0] = limits.acceleration;
    input.max_jerk[0] = limits.jerk;
    let mut trajectory = Trajectory::new(None);
    solver.calculate(&input, &mut trajectory).map_err(|e| unsolved(e.to_string()))?;
    let duration = trajectory.get_duration();
    let steps = ((duration / KNOT_PERIOD).ceil() as usize).max(1);
    let mut knots = Vec::with_capacity(steps + 1);
    for i in 0..steps {
        // Knots are spread evenly, so that the last comes out at the end.
        let t = duration * i as f64 / steps as f64;
        let (mut q, mut qd, mut qdd) = (
            DataArrayOrVec::new(None, 0.0),
            DataArrayOrVec::new(None, 0.0),
            DataArrayOrVec::new(None, 0.0),
        );
        trajectory.at_time(
            t,
            &mut Some(&mut q),
            &mut Some(&mut qd),
            &mut Some(&mut qdd),
            &mut None,
            &mut None,
        );
        knots.push(Knot { t, q: q[0], qd: qd[0], qdd: qdd[0] });
    }
    knots.push(at_rest(duration, to));
    Ok(knots)
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
            let knots = time_parameterise(from, to, &limits).unwrap();
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
        assert!(time_parameterise(f64::NAN, 1.0, &limits).is_err());
    }
}
