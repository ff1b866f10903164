//! What a joint is to do: from what it does now to rest at a target, within its range and its limits.
//!
//! In and out: radians or metres, and their derivatives by seconds. A task makes a motion of the pieces
//! that a solver finds for it.

use super::error::TrajectoryError;
use super::knots::KNOT_PERIOD;
use crate::limits::MotionLimits;
use linkage_realtime::{Bounds, JointMotion, Limits, MotionError, Sample, Segment, stop};

/// What a joint is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Task<'t> {
    /// Its name.
    pub joint: &'t str,
    /// What it does now.
    pub from: Sample,
    /// Where it comes to rest; rad or m.
    pub to: f64,
    /// How fast it may be.
    pub limits: MotionLimits,
    /// Least and greatest configuration that it may have; rad or m.
    pub range: [f64; 2],
}

/// Share of the limits that is used at least.
const LEAST_USED: f64 = 0.5;

impl<'t> Task<'t> {
    /// A motion from rest to rest, which stays between its ends.
    pub fn between(joint: &'t str, from: f64, to: f64, limits: MotionLimits) -> Self {
        let range = [from.min(to), from.max(to)];
        Self { joint, from: Sample::rest(from), to, limits, range }
    }

    /// A motion from what a joint does now, within a range, which is widened by where the joint is,
    /// where it can stop, and where it is to go.
    pub fn within(
        joint: &'t str,
        from: Sample,
        to: f64,
        limits: MotionLimits,
        range: [f64; 2],
    ) -> Self {
        let must_hold = [from.position, stop(from, &limits.into()).position, to];
        let low = must_hold.into_iter().fold(range[0].min(range[1]), f64::min);
        let high = must_hold.into_iter().fold(range[0].max(range[1]), f64::max);
        Self { joint, from, to, limits, range: [low, high] }
    }

    /// The soonest stop.
    pub fn stopping(&self) -> Result<JointMotion, TrajectoryError> {
        let stop = stop(self.from, &self.limits.into());
        self.course(&stop.segments, stop.duration, stop.position)
            .map_err(|e| self.unsolved(e.to_string()))
    }

    pub(super) fn is_still(&self) -> bool {
        self.from.velocity == 0.0
            && self.from.acceleration == 0.0
            && (self.to - self.from.position).abs() < 1e-9
    }

    /// Limits below the given ones by what rounding positions to single floats makes of their
    /// differences from knot to knot, so that a planner which receives them finds the given ones
    /// held.
    pub(super) fn limits_with_room_for_rounding(&self) -> MotionLimits {
        let all = [self.range[0], self.range[1], self.from.position, self.to];
        let nearest = all.into_iter().map(f64::abs).fold(0.0, f64::max) as f32;
        let step = f64::from(nearest.next_up()) - f64::from(nearest);
        let less = |limit: f64, noise: f64| (0.9995 * limit - noise).max(LEAST_USED * limit);
        MotionLimits {
            velocity: less(self.limits.velocity, step / KNOT_PERIOD),
            acceleration: less(self.limits.acceleration, 2.0 * step / KNOT_PERIOD.powi(2)),
            jerk: less(self.limits.jerk, 4.0 * step / KNOT_PERIOD.powi(3)),
        }
    }

    /// A motion in pieces, some of which may take no time.
    pub(super) fn course(
        &self,
        segments: &[Segment],
        duration: f64,
        target: f64,
    ) -> Result<JointMotion, MotionError> {
        let bounds = Bounds { limits: self.limits.into(), range: self.range };
        let ends = segments.iter().skip(1).map(|s| s.start).chain([duration]);
        let mut kept: Vec<Segment> =
            segments.iter().zip(ends).filter(|(s, end)| *end > s.start).map(|(s, _)| *s).collect();
        if kept.is_empty() {
            kept.push(Segment::from(0.0, self.from, 0.0));
        }
        JointMotion::new(self.joint, &kept, duration, target, bounds)
    }

    /// Stays where it is for this many seconds.
    pub(super) fn rest(&self, duration: f64) -> Result<JointMotion, MotionError> {
        self.course(&[Segment::from(0.0, self.from, 0.0)], duration, self.from.position)
    }

    pub(super) fn unsolved(&self, reason: String) -> TrajectoryError {
        let (joint, from) = (self.joint.to_owned(), self.from.position);
        TrajectoryError::Unsolved { joint, from, to: self.to, reason }
    }
}

impl From<MotionLimits> for Limits {
    fn from(limits: MotionLimits) -> Self {
        let MotionLimits { velocity, acceleration, jerk } = limits;
        Self { velocity, acceleration, jerk }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: MotionLimits = MotionLimits { velocity: 0.5, acceleration: 1.0, jerk: 4.0 };

    fn moving(position: f64, velocity: f64) -> Sample {
        Sample { position, velocity, acceleration: 0.0 }
    }

    #[test]
    fn a_motion_between_two_rests_stays_between_them() {
        assert_eq!(Task::between("lid", 1.0, 0.2, LIMITS).range, [0.2, 1.0]);
        assert_eq!(Task::between("lid", 0.2, 1.0, LIMITS).range, [0.2, 1.0]);
    }

    #[test]
    fn a_range_is_widened_by_where_the_joint_is_where_it_can_stop_and_where_it_is_to_go() {
        let inside = Task::within("lid", Sample::rest(0.3), 0.5, LIMITS, [1.0, 0.0]);
        assert_eq!(inside.range, [0.0, 1.0], "the learned range, whichever end comes first");
        let beyond = Task::within("lid", Sample::rest(-0.1), 1.2, LIMITS, [0.0, 1.0]);
        assert_eq!(beyond.range, [-0.1, 1.2]);
        let fast = moving(0.95, 0.5);
        let stops_at = stop(fast, &LIMITS.into()).position;
        assert!(stops_at > 1.0);
        assert_eq!(Task::within("lid", fast, 0.5, LIMITS, [0.0, 1.0]).range, [0.0, stops_at]);
    }

    #[test]
    fn the_soonest_stop_begins_as_the_joint_moves_and_ends_at_rest() {
        let task = Task::within("lid", moving(0.3, 0.4), 0.9, LIMITS, [0.0, 1.0]);
        let stopping = task.stopping().unwrap();
        assert_eq!(stopping.at(0.0), task.from);
        let end = stopping.at(stopping.duration() - 1e-9);
        assert!(end.velocity.abs() < 1e-6 && end.position > 0.3 && end.position < 0.9);
    }

    #[test]
    fn a_joint_at_rest_at_its_target_is_still_and_stays_for_as_long_as_it_is_told() {
        assert!(Task::between("lid", 0.3, 0.3, LIMITS).is_still());
        assert!(!Task::between("lid", 0.3, 0.4, LIMITS).is_still());
        assert!(!Task::within("lid", moving(0.3, 0.1), 0.3, LIMITS, [0.0, 1.0]).is_still());
        let rest = Task::between("lid", 0.3, 0.3, LIMITS).rest(2.0).unwrap();
        assert_eq!((rest.duration(), rest.at(1.3)), (2.0, Sample::rest(0.3)));
    }

    #[test]
    fn limits_leave_room_for_rounding_and_never_less_than_half_of_them() {
        for place in [0.0, 1.0, 1e6] {
            let task = Task::between("lid", 0.0, place, LIMITS);
            let less = task.limits_with_room_for_rounding();
            for (used, given) in [
                (less.velocity, LIMITS.velocity),
                (less.acceleration, LIMITS.acceleration),
                (less.jerk, LIMITS.jerk),
            ] {
                assert!(used < given && used >= LEAST_USED * given, "{used} of {given}");
            }
        }
    }
}
