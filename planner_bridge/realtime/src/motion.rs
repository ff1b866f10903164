//! A motion as pieces of constant jerk, and what it is at an instant. A motion is checked when it
//! is made: it does not jump, it stays within its limits and its range, and it ends at rest.

use crate::brake::stop;
use crate::segment::{Bounds, MotionError, Sample, Segment};
use heapless::{String, Vec};

/// Joints that move together at most.
pub const MAX_JOINTS: usize = 8;
/// Pieces of constant jerk of one joint's motion at most: two that bring it within its limits and
/// seven that bring it to the target, or three to stop, a rest, and seven from there.
pub const MAX_SEGMENTS: usize = 12;
/// A name of an object or a joint, at most 63 bytes.
pub type Name = String<63>;

/// The motion of one joint, which comes to rest at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct JointMotion {
    name: Name,
    segments: Vec<Segment, MAX_SEGMENTS>,
    duration: f64,
    target: f64,
    bounds: Bounds,
}

impl JointMotion {
    /// A motion in pieces, in the order of their starts, the first at 0, that comes to rest at
    /// `target` after `duration` seconds.
    ///
    /// # Errors
    /// [`MotionError`] when there is no room for it, or when it jumps or leaves its bounds.
    pub fn new(
        name: &str,
        segments: &[Segment],
        duration: f64,
        target: f64,
        bounds: Bounds,
    ) -> Result<Self, MotionError> {
        let name = Name::try_from(name).map_err(|_| MotionError::TooMuch)?;
        let segments = Vec::from_slice(segments).map_err(|_| MotionError::TooMuch)?;
        let motion = Self { name, segments, duration, target, bounds };
        motion.check()?;
        Ok(motion)
    }

    fn check(&self) -> Result<(), MotionError> {
        let numbers = |s: &Segment| [s.start, s.position, s.velocity, s.acceleration, s.jerk];
        let finite = self.segments.iter().flat_map(numbers).all(f64::is_finite);
        let first = self.segments.first().ok_or(MotionError::Order)?;
        let ends = self.duration.is_finite() && self.target.is_finite();
        if !(finite && ends && self.bounds.are_sound()) {
            return Err(MotionError::NotFinite);
        }
        if first.start != 0.0 {
            return Err(MotionError::Order);
        }
        for (i, segment) in self.segments.iter().enumerate() {
            let next = self.segments.get(i + 1);
            let length = next.map_or(self.duration, |s| s.start) - segment.start;
            if length < 0.0 {
                return Err(MotionError::Order);
            }
            segment.check(length, &self.bounds)?;
            let follows = next.map_or(Sample::rest(self.target), |s| s.after(0.0));
            if !segment.after(length).is_near(&follows) {
                return Err(MotionError::Jump);
            }
        }
        self.bounds.check(&Sample::rest(self.target))
    }

    /// The joint's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Where it comes to rest, rad or m.
    pub fn target(&self) -> f64 {
        self.target
    }

    /// Its pieces.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// What it stays within.
    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// What the joint does at a time, in seconds from the start; at rest after the end.
    pub fn at(&self, time: f64) -> Sample {
        if time >= self.duration || time.is_nan() {
            return Sample::rest(self.target);
        }
        let begun = self.segments.iter().rev().find(|s| s.start <= time);
        match begun.or(self.segments.first()) {
            Some(s) => s.after((time - s.start).max(0.0)),
            None => Sample::rest(self.target),
        }
    }

    /// The motion that comes to rest as soon as its limits allow, from what this one is at a time.
    pub fn brake(&self, time: f64) -> Self {
        let stop = stop(self.at(time), &self.bounds.limits);
        Self {
            name: self.name.clone(),
            segments: Vec::from_slice(&stop.segments).unwrap_or_default(),
            duration: stop.duration,
            target: stop.position,
            bounds: self.bounds,
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
    /// A motion of an object, without joints yet.
    ///
    /// # Errors
    /// [`MotionError::TooMuch`] for a name that there is no room for.
    pub fn new(object: &str) -> Result<Self, MotionError> {
        let object = Name::try_from(object).map_err(|_| MotionError::TooMuch)?;
        Ok(Self { object, joints: Vec::new() })
    }

    /// Adds a joint.
    ///
    /// # Errors
    /// [`MotionError::TooMuch`] where there are [`MAX_JOINTS`] already, [`MotionError::SameName`]
    /// where one has its name.
    pub fn push(&mut self, joint: JointMotion) -> Result<(), MotionError> {
        if self.joint(joint.name()).is_some() {
            return Err(MotionError::SameName);
        }
        self.joints.push(joint).map_err(|_| MotionError::TooMuch)
    }

    /// The object's name.
    pub fn object(&self) -> &str {
        &self.object
    }

    /// Its joints that move.
    pub fn joints(&self) -> &[JointMotion] {
        &self.joints
    }

    /// The motion of a joint of that name.
    pub fn joint(&self, name: &str) -> Option<&JointMotion> {
        self.joints.iter().find(|j| j.name() == name)
    }

    /// Seconds until the last joint rests.
    pub fn duration(&self) -> f64 {
        self.joints.iter().map(JointMotion::duration).fold(0.0, f64::max)
    }

    /// True where no joint moves at the beginning.
    pub fn starts_at_rest(&self) -> bool {
        self.joints.iter().all(|j| j.at(0.0).is_rest())
    }

    /// True where it may follow another from a time on, without a jump: each joint of the other
    /// goes on as it is, or rests and is left out; each joint that is new begins at rest.
    pub fn follows(&self, before: &Self, time: f64) -> bool {
        let goes_on = |old: &JointMotion| {
            self.joint(old.name()).is_none_or(|new| new.at(0.0).is_near(&old.at(time)))
        };
        let begins =
            |new: &JointMotion| before.joint(new.name()).is_some() || new.at(0.0).is_rest();
        self.object == before.object
            && before.joints.iter().all(goes_on)
            && self.joints.iter().all(begins)
            && self.leaves_out_what_rests(before, time)
    }

    /// True where each joint of another motion that is not part of this one rests at a time.
    pub fn leaves_out_what_rests(&self, before: &Self, time: f64) -> bool {
        let left_out = |old: &&JointMotion| self.joint(old.name()).is_none();
        before.joints.iter().filter(left_out).all(|old| old.at(time).is_rest())
    }

    /// The motion that brings each joint to rest as soon as its limits allow.
    pub fn brake(&self, time: f64) -> Self {
        let mut joints = Vec::new();
        for joint in &self.joints {
            // There is as much room as in this motion.
            let _ = joints.push(joint.brake(time));
        }
        Self { object: self.object.clone(), joints }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::segment::Limits;
    use proptest::prelude::*;

    pub const BOUNDS: Bounds = Bounds {
        limits: Limits { velocity: 100.0, acceleration: 100.0, jerk: 100.0 },
        range: [-1000.0, 1000.0],
    };

    /// Jerk up and down by turns: from rest to rest in four equal pieces.
    pub fn there(jerk: f64, quarter: f64) -> JointMotion {
        let mut now = Sample::rest(0.2);
        let mut segments = [Segment::default(); 4];
        for (i, s) in segments.iter_mut().enumerate() {
            let jerk = if i == 0 || i == 3 { jerk } else { -jerk };
            *s = Segment::from(i as f64 * quarter, now, jerk);
            now = s.after(quarter);
        }
        JointMotion::new("joint1", &segments, 4.0 * quarter, now.position, BOUNDS).unwrap()
    }

    /// The motion of a joint, for one of another name.
    pub fn named(name: &str, motion: JointMotion) -> JointMotion {
        JointMotion { name: Name::try_from(name).unwrap(), ..motion }
    }

    /// A motion with another value in one of its pieces.
    fn changed(change: impl Fn(&mut JointMotion)) -> Result<(), MotionError> {
        let mut motion = there(2.0, 0.5);
        change(&mut motion);
        motion.check()
    }

    proptest! {
        #[test]
        fn a_motion_is_smooth_and_rests_at_both_ends(
            jerk in 0.1..20.0_f64, quarter in 0.05..1.0_f64, at in 0.0..1.0_f64,
        ) {
            let motion = there(jerk, quarter);
            let end = motion.duration();
            prop_assert_eq!(motion.at(-1.0), Sample::rest(0.2));
            prop_assert_eq!(motion.at(end + 1.0).velocity, 0.0);
            prop_assert!((motion.at(end - 1e-9).position - motion.at(end).position).abs() < 1e-7);
            let (t, h) = (at * end, 1e-6);
            let slope = (motion.at(t + h).position - motion.at(t).position) / h;
            prop_assert!((slope - motion.at(t).velocity).abs() < 1e-3 * (1.0 + jerk));
        }

        #[test]
        fn a_motion_with_any_one_number_changed_is_refused(
            piece in 0..4_usize, which in 0..4_usize, by in prop_oneof![0.01..9.0_f64, -9.0..-0.01],
        ) {
            let change = |m: &mut JointMotion| {
                let s = &mut m.segments[piece];
                *[&mut s.position, &mut s.velocity, &mut s.acceleration, &mut s.jerk][which] += by;
            };
            // Only the first piece may begin anywhere, but then it ends elsewhere.
            prop_assert!(changed(change).is_err());
        }
    }

    #[test]
    fn a_motion_that_leaves_its_bounds_is_refused_with_what_it_exceeds() {
        assert_eq!(changed(|_| {}), Ok(()));
        assert_eq!(changed(|m| m.bounds.limits.velocity = 0.4), Err(MotionError::Velocity));
        assert_eq!(changed(|m| m.bounds.limits.acceleration = 0.9), Err(MotionError::Acceleration));
        assert_eq!(changed(|m| m.bounds.limits.jerk = 1.9), Err(MotionError::Jerk));
        assert_eq!(changed(|m| m.bounds.range[1] = 0.6), Err(MotionError::Range));
        assert_eq!(changed(|m| m.bounds.limits.jerk = f64::NAN), Err(MotionError::NotFinite));
        assert_eq!(changed(|m| m.segments[2].start = f64::NAN), Err(MotionError::NotFinite));
        assert_eq!(changed(|m| m.segments[2].start = 0.1), Err(MotionError::Order));
        assert_eq!(changed(|m| m.duration = 1.7), Err(MotionError::Jump));
        assert_eq!(changed(|m| m.target += 0.1), Err(MotionError::Jump));
        assert_eq!(changed(|m| m.segments.clear()), Err(MotionError::Order));
    }

    #[test]
    fn an_extreme_inside_a_piece_is_found() {
        // It turns around at 0.5, beyond both of its ends.
        let out_and_back = Segment { velocity: 1.0, acceleration: -1.0, ..Segment::default() };
        let bounds = Bounds { range: [-1.0, 0.4], ..BOUNDS };
        assert_eq!(out_and_back.check(2.0, &bounds), Err(MotionError::Range));
        let wide = Bounds { range: [-1.0, 0.6], ..BOUNDS };
        assert_eq!(out_and_back.check(2.0, &wide), Ok(()));
    }

    #[test]
    fn time_that_is_no_number_means_rest_at_the_target() {
        let motion = there(1.0, 0.5);
        assert_eq!(motion.at(f64::NAN), motion.at(10.0));
    }

    #[test]
    fn what_there_is_no_room_for_is_refused() {
        let named = |name: &str, pieces: usize| {
            let segments = [Segment::default(); MAX_SEGMENTS + 1];
            JointMotion::new(name, &segments[..pieces], 0.0, 0.0, BOUNDS)
        };
        assert!(named("x", MAX_SEGMENTS).is_ok());
        assert_eq!(named(&"x".repeat(64), 1), Err(MotionError::TooMuch));
        assert_eq!(named("x", MAX_SEGMENTS + 1), Err(MotionError::TooMuch));
        let mut motion = Motion::new("door").unwrap();
        for name in ["a", "b", "c", "d", "e", "f", "g", "h"] {
            motion.push(named(name, 1).unwrap()).unwrap();
        }
        assert_eq!(motion.push(named("i", 1).unwrap()), Err(MotionError::TooMuch));
        assert_eq!(motion.push(named("a", 1).unwrap()), Err(MotionError::SameName));
    }

    #[test]
    fn what_follows_goes_on_from_what_was() {
        let mut before = Motion::new("door").unwrap();
        before.push(there(1.0, 0.5)).unwrap();
        assert!(before.brake(0.7).follows(&before, 0.7));
        assert!(!before.brake(0.7).follows(&before, 0.71), "the joint would jump back");
        let nothing = Motion::new("door").unwrap();
        assert!(!nothing.follows(&before, 0.7), "the joint still moves");
        assert!(nothing.follows(&before, 2.0));
        let mut other = Motion::new("drawer").unwrap();
        other.push(before.joints()[0].brake(0.7)).unwrap();
        assert!(!other.follows(&before, 0.7), "it is another object");
        let mut added = before.brake(0.7);
        let moving = Segment { velocity: 1.0, ..Segment::default() };
        added.push(named("new", there(1.0, 0.5))).unwrap();
        assert!(added.follows(&before, 0.7));
        added.joints[1].segments[0] = moving;
        assert!(!added.follows(&before, 0.7), "the new joint would begin at once");
    }
}
