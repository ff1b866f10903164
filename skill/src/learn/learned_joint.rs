//! What every method of learning returns: a joint with the part that it moves.

use super::tracking::Trajectory;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::Joint;
use nalgebra::{Point3, UnitVector3, Vector3};
use std::fmt;

/// A joint with the part that it moves.
#[derive(Debug, Clone)]
pub struct LearnedJoint {
    /// The joint.
    pub joint: Joint,
    /// Takes the part's points of the reference frame to where they are in the base frame.
    pub base_from_part: Trajectory,
    /// Tracks on the part.
    pub tracks: Vec<usize>,
    /// Places on a plain part, which has no tracks, in its coordinates.
    pub plain_surface: Vec<Point3<f64>>,
}

/// A moving thing that a method found and does not take for a part of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedCandidate {
    /// Type of the joint that explained its motion best.
    pub kind: JointKind,
    /// Tracks that followed it.
    pub tracks: usize,
    /// Frames in which its configuration was known.
    pub frames: usize,
    /// Why it was rejected, as a sentence without its full stop.
    pub reason: String,
    /// It may well be a part: a demonstration that shows more of its motion would tell.
    pub needs_more: bool,
}

impl fmt::Display for RejectedCandidate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, tracks, frames, reason, .. } = self;
        write!(f, "a {} candidate ({tracks} tracks, {frames} frames): {reason}", kind.name())
    }
}

/// What a method of learning returns.
#[derive(Debug, Clone, Default)]
pub struct LearnedJoints {
    /// The joints, parents before children.
    pub joints: Vec<LearnedJoint>,
    /// What was rejected last, and why.
    pub rejections: Vec<RejectedCandidate>,
    /// What else was seen to turn.
    pub turning: Vec<TurningPlane>,
}

/// A plane that turned about a line and that no joint was made of. Its line's direction is known well, for normals
/// tell it; its place is not.
#[derive(Debug, Clone, Copy)]
pub struct TurningPlane {
    /// Unit direction of the line, base frame.
    pub axis: Vector3<f64>,
    /// The middle of the plane when it was first seen.
    pub middle: Point3<f64>,
}

/// Configuration 0 at the first frame, growing with the first clear motion.
pub fn orient(geometry: &mut JointGeometry, configuration: &mut [f64]) {
    let Some(&first) = configuration.first() else { return };
    let span = span_of(configuration);
    let clear = configuration.iter().find(|q| (*q - first).abs() > 0.25 * span);
    let sign = if clear.is_some_and(|q| *q < first) { -1.0 } else { 1.0 };
    for q in configuration.iter_mut() {
        *q = sign * (*q - first);
    }
    if sign < 0.0 {
        geometry.axis = UnitVector3::new_unchecked(-geometry.axis.into_inner());
    }
}

/// Least and greatest configuration, single outliers left out.
pub fn range_of(configuration: &[f64]) -> [f64; 2] {
    let mut sorted = configuration.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    if n == 0 {
        return [0.0, 0.0];
    }
    let stray = n / 100;
    [sorted[stray].min(0.0), sorted[n - 1 - stray].max(0.0)]
}

/// How far a list of configurations reaches, radians or metres.
pub fn span_of(configuration: &[f64]) -> f64 {
    let low = configuration.iter().copied().fold(f64::INFINITY, f64::min);
    let high = configuration.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if high >= low { high - low } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn configurations_start_at_zero_and_grow_with_the_first_clear_motion() {
        let mut line = JointGeometry::slide(nalgebra::Vector3::x_axis(), Point3::origin());
        let mut configuration = [0.3, 0.3, 0.2, 0.0];
        orient(&mut line, &mut configuration);
        assert!((configuration[3] - 0.3).abs() < 1e-12 && configuration[0] == 0.0);
        assert_eq!(line.axis, -nalgebra::Vector3::x_axis());
        assert_eq!(range_of(&[]), [0.0, 0.0]);
        assert_eq!(span_of(&[0.1, 0.4]), 0.4 - 0.1);
    }

    #[test]
    fn a_rejected_candidate_is_told_in_a_sentence() {
        let rejected = RejectedCandidate {
            kind: JointKind::Prismatic,
            tracks: 12,
            frames: 40,
            reason: "it hardly moves".to_owned(),
            needs_more: false,
        };
        let said = "a prismatic candidate (12 tracks, 40 frames): it hardly moves";
        assert_eq!(rejected.to_string(), said);
    }
}
