//! A motion as pieces of constant jerk, and what it is at an instant.

use heapless::{String, Vec};

/// Joints that move together at most.
pub const MAX_JOINTS: usize = 8;
/// Pieces of constant jerk of one joint's motion at most; from rest to rest there are seven.
pub const MAX_SEGMENTS: usize = 8;
/// A name of an object or a joint, at most 63 bytes.
pub type Name = String<63>;

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
    /// Configuration.
    pub position: f64,
    /// Velocity.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
}

/// More than a motion has room for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooMuch;

/// The motion of one joint, from rest to rest.
#[derive(Debug, Clone, PartialEq)]
pub struct JointMotion {
    name: Name,
    segments: Vec<Segment, MAX_SEGMENTS>,
    duration: f64,
    target: f64,
}

impl JointMotion {
    /// A motion in pieces, in the order of their starts, that comes to rest at `target` after
    /// `duration` seconds.
    ///
    /// # Errors
    /// [`TooMuch`] for a name or a number of pieces that there is no room for.
    pub fn new(
        name: &str,
        segments: &[Segment],
        duration: f64,
        target: f64,
    ) -> Result<Self, TooMuch> {
        let name = Name::try_from(name).map_err(|_| TooMuch)?;
        let segments = Vec::from_slice(segments).map_err(|_| TooMuch)?;
        Ok(Self { name, segments, duration, target })
    }

    /// Of the joint.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// What the joint does at a time; at rest before the start and after the end.
    pub fn at(&self, time: f64) -> Sample {
        if time >= self.duration || time.is_nan() {
            return Sample { position: self.target, ..Sample::default() };
        }
        let begun = self.segments.iter().rev().find(|s| s.start <= time);
        let Some(s) = begun else {
            let position = self.segments.first().map_or(self.target, |s| s.position);
            return Sample { position, ..Sample::default() };
        };
        let t = time - s.start;
        Sample {
            position: s.position + t * (s.velocity + t * (s.acceleration / 2.0 + t * s.jerk / 6.0)),
            velocity: s.velocity + t * (s.acceleration + t * s.jerk / 2.0),
            acceleration: s.acceleration + t * s.jerk,
        }
    }
}

/// Joints of one object that move together.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    object: Name,
    joints: Vec<JointMotion, MAX_JOINTS>,
}

impl Motion {
    /// Of an object, without joints yet.
    ///
    /// # Errors
    /// [`TooMuch`] for a name that there is no room for.
    pub fn new(object: &str) -> Result<Self, TooMuch> {
        Ok(Self { object: Name::try_from(object).map_err(|_| TooMuch)?, joints: Vec::new() })
    }

    /// Adds a joint.
    ///
    /// # Errors
    /// [`TooMuch`] where there are [`MAX_JOINTS`] already.
    pub fn push(&mut self, joint: JointMotion) -> Result<(), TooMuch> {
        self.joints.push(joint).map_err(|_| TooMuch)
    }

    /// The object's name.
    pub fn object(&self) -> &str {
        &self.object
    }

    /// Its joints that move.
    pub fn joints(&self) -> &[JointMotion] {
        &self.joints
    }

    /// Seconds until the last joint rests.
    pub fn duration(&self) -> f64 {
        self.joints.iter().map(JointMotion::duration).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Jerk up and down by turns: from rest to rest in four equal pieces.
    fn there(jerk: f64, quarter: f64) -> JointMotion {
        let mut now = Sample { position: 0.2, ..Sample::default() };
        let mut segments = [Segment::default(); 4];
        for (i, s) in segments.iter_mut().enumerate() {
            let jerk = if i == 0 || i == 3 { jerk } else { -jerk };
            let start = i as f64 * quarter;
            *s = Segment {
                start,
                position: now.position,
                velocity: now.velocity,
                acceleration: now.acceleration,
                jerk,
            };
            let one = JointMotion::new("j", &[Segment { start: 0.0, ..*s }], 1e9, 0.0).unwrap();
            now = one.at(quarter);
        }
        JointMotion::new("joint1", &segments, 4.0 * quarter, now.position).unwrap()
    }

    proptest! {
        #[test]
        fn a_motion_is_smooth_and_rests_at_both_ends(
            jerk in 0.1..20.0_f64, quarter in 0.05..1.0_f64, at in 0.0..1.0_f64,
        ) {
            let motion = there(jerk, quarter);
            let end = motion.duration();
            prop_assert_eq!(motion.at(-1.0), Sample { position: 0.2, ..Sample::default() });
            prop_assert_eq!(motion.at(end + 1.0).velocity, 0.0);
            prop_assert!((motion.at(end - 1e-9).position - motion.at(end).position).abs() < 1e-7);
            let (t, h) = (at * end, 1e-6);
            let slope = (motion.at(t + h).position - motion.at(t).position) / h;
            prop_assert!((slope - motion.at(t).velocity).abs() < 1e-3 * (1.0 + jerk));
        }
    }

    #[test]
    fn time_that_is_no_number_means_rest_at_the_target() {
        let motion = there(1.0, 0.5);
        assert_eq!(motion.at(f64::NAN), motion.at(10.0));
    }

    #[test]
    fn what_there_is_no_room_for_is_refused() {
        assert!(JointMotion::new(&"x".repeat(64), &[], 0.0, 0.0).is_err());
        assert!(JointMotion::new("x", &[Segment::default(); MAX_SEGMENTS + 1], 0.0, 0.0).is_err());
        let mut motion = Motion::new("door").unwrap();
        for _ in 0..MAX_JOINTS {
            motion.push(there(1.0, 0.5)).unwrap();
        }
        assert_eq!(motion.push(there(1.0, 0.5)), Err(TooMuch));
    }
}
