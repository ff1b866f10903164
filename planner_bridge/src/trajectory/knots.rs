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

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_realtime::{Bounds, Limits, Sample, Segment};

    /// A joint that stays where it is for so many seconds.
    fn resting(duration: f64) -> JointMotion {
        let from = Sample::rest(0.3);
        let limits = Limits { velocity: 1.0, acceleration: 1.0, jerk: 1.0 };
        let bounds = Bounds { limits, range: [0.0, 1.0] };
        let segments = [Segment::from(0.0, from, 0.0)];
        JointMotion::new("lid", &segments, duration, 0.3, bounds).unwrap()
    }

    #[test]
    fn knots_go_from_the_beginning_to_the_end_at_whole_microseconds() {
        for duration in [0.123_456_789, 1.0, 7.7] {
            let knots = knots(&resting(duration));
            assert_eq!(knots[0].t, 0.0);
            let last = knots[knots.len() - 1].t;
            assert!(last >= duration - 1e-12 && last < duration + 2e-6, "{last} of {duration}");
            for knot in &knots {
                let microseconds = knot.t * 1e6;
                assert!((microseconds - microseconds.round()).abs() < 1e-6);
            }
            assert!(knots.windows(2).all(|pair| pair[1].t > pair[0].t));
        }
    }

    #[test]
    fn a_short_motion_has_two_and_a_long_one_no_more_than_may_be() {
        assert_eq!(knots(&resting(0.001)).len(), 2);
        assert_eq!(knots(&resting(0.5 * KNOT_PERIOD)).len(), 2);
        assert_eq!(knots(&resting(1000.0)).len(), MAX_KNOTS);
    }
}
