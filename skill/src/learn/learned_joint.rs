//! What every learning method returns: joints, each with the part that it moves, and rejected
//! candidates.

use super::ego_motion::EgoMotion;
use super::tracking::{TrackSet, Trajectory};
use crate::math::rigid::Pose;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::Joint;
use nalgebra::{Point3, UnitVector3, Vector3};
use std::fmt;

/// A joint and the part that it moves.
#[derive(Debug, Clone)]
pub struct LearnedJoint {
    /// The joint, with its configuration in each frame that shows it.
    pub joint: Joint,
    /// Motion of the part in the base frame since the reference frame, for each frame.
    pub base_from_part: Trajectory,
    /// Indices of the tracks on the part.
    pub tracks: Vec<usize>,
    /// Points of a part that was found without tracks, in part coordinates, metres; else empty.
    pub plain_surface: Vec<Point3<f64>>,
}

impl LearnedJoint {
    /// Points of the part at configuration 0, base frame, metres: of its plain surface, or one of each track.
    pub fn points(&self, base: &EgoMotion) -> Vec<Point3<f64>> {
        if !self.plain_surface.is_empty() {
            return self.plain_surface.clone();
        }
        let first = |&id: &usize| {
            let seen = base.tracks[id].points.iter().enumerate();
            let mut posed = seen.filter_map(|(i, p)| {
                let base_from_part = self.base_from_part[base.tracks[id].first_frame + i]?;
                Some(base_from_part.inverse() * (*p)?.point)
            });
            posed.next()
        };
        self.tracks.iter().filter_map(first).collect()
    }

    /// Configuration of a hinge in each frame, radians, from the part's pose.
    pub fn configurations(&self) -> Vec<Option<f64>> {
        let axis = self.joint.geometry().axis;
        let turn = |pose: &Pose| pose.rotation.scaled_axis().dot(&axis);
        self.base_from_part.iter().map(|pose| pose.as_ref().map(turn)).collect()
    }

    /// Sets the configuration of a hinge in some frames, radians, with the part's poses and the joint's range.
    pub fn place(&mut self, shown: &[(usize, f64)], set: &TrackSet) {
        let geometry = self.joint.geometry();
        for &(frame, q) in shown {
            self.base_from_part[frame] = Some(geometry.motion(q));
        }
        let known = self.configurations().into_iter().enumerate();
        let (frames, turns): (Vec<usize>, Vec<f64>) =
            known.filter_map(|(frame, q)| Some((frame, q?))).unzip();
        self.joint.range = range_of(&turns);
        self.joint.configuration = set.timed(&frames, &turns);
    }
}

/// A moving thing that a method found and rejected as a part of the object.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedCandidate {
    /// Type of the joint that best explained the motion.
    pub kind: JointKind,
    /// Number of tracks that followed the motion.
    pub tracks: usize,
    /// Number of frames in which the configuration was known.
    pub frames: usize,
    /// Reason for the rejection, as a sentence without its full stop.
    pub reason: String,
    /// True if the candidate may be a part: a demonstration that shows more of its motion could
    /// confirm it.
    pub needs_more: bool,
}

impl fmt::Display for RejectedCandidate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, tracks, frames, reason, .. } = self;
        match tracks {
            0 => write!(f, "a plain {} candidate ({frames} frames): {reason}", kind.name()),
            _ => write!(
                f,
                "a {} candidate ({tracks} tracks, {frames} frames): {reason}",
                kind.name()
            ),
        }
    }
}

/// All that a learning method returns.
#[derive(Debug, Clone, Default)]
pub struct LearnedJoints {
    /// The joints, parents before children.
    pub joints: Vec<LearnedJoint>,
    /// Candidates that were rejected last, with the reasons.
    pub rejections: Vec<RejectedCandidate>,
    /// Planes that turned and of which no joint was made.
    pub turning: Vec<TurningPlane>,
}

/// A plane that turned about a line, and of which no joint was made. The direction of the line is
/// known well, because the normals determine it; the place of the line is known worse.
#[derive(Debug, Clone, Copy)]
pub struct TurningPlane {
    /// Unit direction of the line, base frame.
    pub axis: Vector3<f64>,
    /// A point of the line, base frame, metres.
    pub origin: Point3<f64>,
    /// Middle of the plane when it was first seen, base frame, metres.
    pub middle: Point3<f64>,
}

/// Shifts the configurations so that the first is 0, and reverses the axis if the first clear
/// motion (over a quarter of the span) would make them negative.
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

/// Smallest and largest configuration, without the outermost 1 % at each end, which may be
/// outliers. The range always contains 0.
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

/// Difference between the largest and the smallest configuration, radians or metres.
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
