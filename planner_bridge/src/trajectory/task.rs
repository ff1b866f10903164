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
