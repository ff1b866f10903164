//! How a joint that moves comes to rest soonest: jerk down to the greatest deceleration that is
//! needed or allowed, holding it, and jerk back to no acceleration where the velocity is 0.

use crate::segment::{Limits, Sample, Segment};

/// A stop of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Its pieces; some may take no time.
    pub segments: [Segment; 3],
    /// Seconds.
    pub duration: f64,
    /// Where it comes to rest, rad or m.
    pub position: f64,
}

/// The soonest stop from what a joint does now. It moves no farther than any other motion that
/// holds the limits and does not turn back.
pub fn stop(from: Sample, limits: &Limits) -> Stop {
    let Limits { acceleration: greatest, jerk, .. } = *limits;
    // The velocity that would be left if the acceleration were taken back at once has the
    // direction that is to be braked.
    let left = from.velocity + from.acceleration * from.acceleration.abs() / (2.0 * jerk);
    let sign = if left < 0.0 { -1.0 } else { 1.0 };
    let (velocity, acceleration) = (sign * from.velocity, sign * from.acceleration);
    // Square of the deceleration from which the velocity ends with the acceleration.
    let square = (jerk * velocity + acceleration * acceleration / 2.0).max(0.0);
    let peak = libm::sqrt(square).min(greatest).max(-acceleration);
    let down = ((acceleration + peak) / jerk).max(0.0);
    let hold = if peak > 0.0 { (square / (jerk * peak) - peak / jerk).max(0.0) } else { 0.0 };
    let up = peak / jerk;
    let first = Segment::from(0.0, from, -sign * jerk);
    let second = Segment::from(down, first.after(down), 0.0);
    let third = Segment::from(down + hold, second.after(hold), sign * jerk);
    Stop {
        segments: [first, second, third],
        duration: down + hold + up,
        position: third.after(up).position,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits() -> impl Strategy<Value = Limits> {
        (0.1..2.0_f64, 0.2..4.0_f64, 0.5..40.0_f64)
            .prop_map(|(velocity, acceleration, jerk)| Limits { velocity, acceleration, jerk })
    }

    /// What a joint under limits can be doing: it can still keep its velocity limit.
    pub fn moving() -> impl Strategy<Value = (Limits, Sample)> {
        (limits(), -3.0..3.0_f64, -1.0..1.0_f64, -1.0..1.0_f64).prop_map(|(l, position, v, a)| {
            let acceleration = a * l.acceleration;
            let needed = acceleration * acceleration.abs() / (2.0 * l.jerk);
            let room = |side: f64| (l.velocity - (side * needed).max(0.0)).max(0.0);
            let velocity = if v > 0.0 { v * room(1.0) } else { v * room(-1.0) };
            (l, Sample { position, velocity, acceleration })
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn no_later_stop_is_nearer_for_a_joint_that_does_not_turn_back(
            (limits, any) in moving(), weaker in 0.3..1.0_f64,
        ) {
            let (velocity, acceleration) = (any.velocity.abs(), any.acceleration.abs());
            let from = Sample { velocity, acceleration, ..any };
            let weak = Limits {
                velocity: limits.velocity,
                acceleration: (weaker * limits.acceleration).max(from.acceleration),
                jerk: weaker * limits.jerk,
            };
            let (soonest, later) = (stop(from, &limits), stop(from, &weak));
            prop_assert!(soonest.duration <= later.duration + 1e-12);
            prop_assert!(soonest.position <= later.position + 1e-12);
        }
    }

    #[test]
    fn what_rests_is_stopped_at_once() {
        let limits = Limits { velocity: 1.0, acceleration: 1.0, jerk: 4.0 };
        let stop = stop(Sample::rest(0.7), &limits);
        assert_eq!((stop.duration, stop.position), (0.0, 0.7));
    }

    #[test]
    fn a_stop_from_steady_motion_is_the_textbook_one() {
        // 0.5 rad/s, 1 rad/s², 4 rad/s³: a quarter of a second down, as long again held, and up.
        let limits = Limits { velocity: 0.5, acceleration: 1.0, jerk: 4.0 };
        let stop = stop(Sample { velocity: 0.5, ..Sample::default() }, &limits);
        assert!((stop.duration - 0.75).abs() < 1e-12, "{}", stop.duration);
        assert!((stop.position - 0.1875).abs() < 1e-12, "{}", stop.position);
    }
}
