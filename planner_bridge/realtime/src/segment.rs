//! A piece of constant jerk, what a joint does in it, and the bounds that it must hold.

use core::fmt;

/// Greatest step between two pieces that counts as none: rad or m, and the same per second and
/// per second squared. Solvers meet their targets to about 1e-8.
pub(crate) const STEP: f64 = 1e-6;
/// Share by which a limit may be exceeded, for rounding.
const ROUNDING: f64 = 1e-6;

/// A piece of constant jerk. Configurations in radians or metres, time in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Segment {
    /// When it begins, from the motion's start.
    pub start: f64,
    /// Configuration there.
    pub position: f64,
    /// Velocity there.
    pub velocity: f64,
    /// Acceleration there.
    pub acceleration: f64,
    /// Jerk throughout.
    pub jerk: f64,
}

/// What a joint does at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// Configuration, rad or m.
    pub position: f64,
    /// Velocity.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
}

/// Greatest velocity, acceleration and jerk of a joint, in either direction; rad or m, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// rad/s or m/s.
    pub velocity: f64,
    /// rad/s² or m/s².
    pub acceleration: f64,
    /// rad/s³ or m/s³.
    pub jerk: f64,
}

/// What the motion of a joint stays within.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// How fast it may be.
    pub limits: Limits,
    /// Least and greatest configuration, rad or m.
    pub range: [f64; 2],
}

/// A motion that must not be run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionError {
    /// More joints, pieces or bytes of a name than there is room for.
    TooMuch,
    /// A number is not finite, or a limit is not above 0.
    NotFinite,
    /// The pieces are not in the order of time.
    Order,
    /// A piece does not begin where the one before it ends, or the last does not end at rest.
    Jump,
    /// The velocity limit is exceeded.
    Velocity,
    /// The acceleration limit is exceeded.
    Acceleration,
    /// The jerk limit is exceeded.
    Jerk,
    /// The range is left.
    Range,
    /// Two joints have one name.
    SameName,
}

impl fmt::Display for MotionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooMuch => "more joints, pieces or bytes of a name than there is room for",
            Self::NotFinite => "a number is not finite, or a limit is not above 0",
            Self::Order => "its pieces are not in the order of time",
            Self::Jump => "it jumps, or does not end at rest",
            Self::Velocity => "the velocity limit is exceeded",
            Self::Acceleration => "the acceleration limit is exceeded",
            Self::Jerk => "the jerk limit is exceeded",
            Self::Range => "the range is left",
            Self::SameName => "two joints have one name",
        })
    }
}

impl core::error::Error for MotionError {}

impl Sample {
    /// A sample at rest.
    pub fn rest(position: f64) -> Self {
        Self { position, velocity: 0.0, acceleration: 0.0 }
    }

    /// True where it neither moves nor is about to.
    pub fn is_rest(&self) -> bool {
        self.velocity.abs() <= STEP && self.acceleration.abs() <= STEP
    }

    /// True where one may follow the other without a jump.
    pub(crate) fn is_near(&self, other: &Self) -> bool {
        (self.position - other.position).abs() <= STEP
            && (self.velocity - other.velocity).abs() <= STEP
            && (self.acceleration - other.acceleration).abs() <= STEP
    }
}

impl Bounds {
    /// True where all are numbers that can be held.
    pub(crate) fn are_sound(&self) -> bool {
        let Limits { velocity, acceleration, jerk } = self.limits;
        let above_zero = |limit: f64| limit.is_finite() && limit > 0.0;
        above_zero(velocity)
            && above_zero(acceleration)
            && above_zero(jerk)
            && self.range.iter().all(|q| q.is_finite())
    }

    /// Refuses what lies outside.
    pub(crate) fn check(&self, sample: &Sample) -> Result<(), MotionError> {
        let Limits { velocity, acceleration, .. } = self.limits;
        let [low, high] = self.range;
        if sample.velocity.abs() > velocity * (1.0 + ROUNDING) {
            return Err(MotionError::Velocity);
        }
        if sample.acceleration.abs() > acceleration * (1.0 + ROUNDING) {
            return Err(MotionError::Acceleration);
        }
        if sample.position < low - STEP || sample.position > high + STEP {
            return Err(MotionError::Range);
        }
        Ok(())
    }
}

impl Segment {
    /// A piece that begins with a sample.
    pub fn from(start: f64, sample: Sample, jerk: f64) -> Self {
        let Sample { position, velocity, acceleration } = sample;
        Self { start, position, velocity, acceleration, jerk }
    }

    /// What it is `t` seconds after its own beginning.
    pub fn after(&self, t: f64) -> Sample {
        let Self { position, velocity, acceleration, jerk, .. } = *self;
        Sample {
            position: position + t * (velocity + t * (acceleration / 2.0 + t * jerk / 6.0)),
            velocity: velocity + t * (acceleration + t * jerk / 2.0),
            acceleration: acceleration + t * jerk,
        }
    }

    /// Refuses a piece of this many seconds that leaves its bounds.
    pub(crate) fn check(&self, length: f64, bounds: &Bounds) -> Result<(), MotionError> {
        let Self { velocity, acceleration, jerk, .. } = *self;
        if jerk.abs() > bounds.limits.jerk * (1.0 + ROUNDING) {
            return Err(MotionError::Jerk);
        }
        // Velocity is extreme where acceleration is 0, position where velocity is.
        let root = libm::sqrt(acceleration * acceleration - 2.0 * jerk * velocity);
        let extremes = [
            -acceleration / jerk,
            -velocity / acceleration,
            (-acceleration - root) / jerk,
            (-acceleration + root) / jerk,
        ];
        bounds.check(&self.after(0.0))?;
        bounds.check(&self.after(length))?;
        extremes
            .iter()
            .filter(|t| (0.0..=length).contains(*t))
            .try_for_each(|t| bounds.check(&self.after(*t)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds {
        limits: Limits { velocity: 1.0, acceleration: 2.0, jerk: 8.0 },
        range: [-1.0, 1.0],
    };

    #[test]
    fn a_piece_is_the_integral_of_its_jerk() {
        let from = Sample { position: 0.1, velocity: 0.2, acceleration: -0.3 };
        let piece = Segment::from(5.0, from, 1.2);
        let (t, h) = (0.7, 1e-4);
        let (before, now, after) = (piece.after(t - h), piece.after(t), piece.after(t + h));
        assert_eq!(piece.after(0.0), from);
        assert!(((after.position - before.position) / (2.0 * h) - now.velocity).abs() < 1e-7);
        assert!(((after.velocity - before.velocity) / (2.0 * h) - now.acceleration).abs() < 1e-7);
        assert!(((after.acceleration - before.acceleration) / (2.0 * h) - 1.2).abs() < 1e-7);
    }

    #[test]
    fn a_piece_that_leaves_its_bounds_between_its_ends_is_refused() {
        // Thrown up from 0.9 with a velocity that is gone after 0.5 s, and back again.
        let up = Sample { position: 0.9, velocity: 0.5, acceleration: -1.0 };
        let piece = Segment::from(0.0, up, 0.0);
        assert!(piece.after(1.0).position <= 0.9);
        assert_eq!(piece.check(1.0, &BOUNDS), Err(MotionError::Range));
        assert_eq!(Segment { position: 0.8, ..piece }.check(1.0, &BOUNDS), Ok(()));
    }

    #[test]
    fn each_limit_is_told_by_its_name() {
        let with = |velocity, acceleration, jerk| {
            let sample = Sample { position: 0.0, velocity, acceleration };
            Segment::from(0.0, sample, jerk).check(0.01, &BOUNDS)
        };
        assert_eq!(with(0.5, 0.0, 0.0), Ok(()));
        assert_eq!(with(1.1, 0.0, 0.0), Err(MotionError::Velocity));
        assert_eq!(with(0.0, 2.1, 0.0), Err(MotionError::Acceleration));
        assert_eq!(with(0.0, 0.0, 8.1), Err(MotionError::Jerk));
    }

    #[test]
    fn bounds_must_be_numbers_above_zero() {
        let limits = |jerk| Bounds { limits: Limits { jerk, ..BOUNDS.limits }, ..BOUNDS };
        assert!(BOUNDS.are_sound() && !limits(0.0).are_sound() && !limits(f64::NAN).are_sound());
        assert!(!Bounds { range: [f64::NEG_INFINITY, 0.0], ..BOUNDS }.are_sound());
    }
}
