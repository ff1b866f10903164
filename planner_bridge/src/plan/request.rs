//! What a plan is asked for: a joint, a target, what the gripper holds, and what moves already.
//!
//! In and out: a target in the joint's unit, radians or metres; a grasp in the camera frame, metres;
//! what is commanded now, in the time of the stream's clock.

use linkage_realtime::Moving;
use linkage_skill::predict::Target;
use nalgebra::Point3;

/// What is to be predicted.
#[derive(Debug, Clone, Copy)]
pub struct Request<'r> {
    /// The joint to move; all whose configuration was seen where none is named.
    pub joint: Option<&'r str>,
    /// Where to.
    pub target: Target,
    /// What the gripper holds now, in the camera frame, metres; where the demonstrator's hand was
    /// if it is not given.
    pub grasp: Option<Point3<f64>>,
    /// What is commanded now, where the object is being moved: the plan goes on from there.
    pub moving: Option<&'r Moving>,
}

impl Request<'_> {
    /// All joints that were seen, from rest to a target.
    pub fn to(target: Target) -> Self {
        Self { joint: None, target, grasp: None, moving: None }
    }
}
