//! Computes the poses of plane patches about a hinge's line: angle, reach, and position along the line.
//!
//! In: a line and plane patches, base frame.
//! Out: planes beside the line, and planes along it but not beside it, metres and radians.

use super::plane_segments::PlanePatch;
use crate::math::rigid::{orthonormal_basis, wrapped};
use crate::object::joint_geometry::JointGeometry;
use nalgebra::{Point3, Vector3};

/// Largest difference of reach, or of position along the hinge, between two patches of one part, as a share of the
/// reach.
const MAX_CHANGE: f64 = 0.25;
/// Largest sine of the angle between the line and the plane of a part: the line of the tracks may be off by this
/// much.
const MAX_TILT: f64 = 0.12;
/// Largest distance between the line and a plane that counts as beside it, metres.
const MAX_DISTANCE_M: f64 = 0.05;
/// Largest difference between the distances of one edge from the line in two keyframes, metres.
const SAME_DISTANCE_M: f64 = 0.015;
/// Largest difference between the positions of an edge's middle along the line in two keyframes, metres: hands may
/// hide part of the edge.
const SAME_PLACE_M: f64 = 0.25;
/// Largest relative difference between the widths of one edge in two keyframes.
const SAME_WIDTH: f64 = 0.5;

/// Pose of a patch about a line.
pub struct PoseAboutAxis {
    /// Unit vector from the line into the patch, across the line.
    pub arm: Vector3<f64>,
    /// Smallest distance of the patch from the line, metres (5th percentile).
    pub least: f64,
    /// Largest distance of the patch from the line, metres (95th percentile).
    pub reach: f64,
    /// Position of the patch's middle along the line, metres.
    along: f64,
}

impl PoseAboutAxis {
    /// The pose of a patch; `None` for a patch on both sides of the line.
    pub fn of(patch: &PlanePatch, origin: &Point3<f64>, axis: &Vector3<f64>) -> Option<Self> {
        let mut arm = axis.cross(&patch.normal).try_normalize(1e-9)?;
        let n = patch.points.len() as f64;
        let mean = patch.points.iter().map(|p| p - origin).sum::<Vector3<f64>>() / n;
        if arm.dot(&mean) < 0.0 {
            arm = -arm;
        }
        let mut out: Vec<f64> = patch.points.iter().map(|p| arm.dot(&(p - origin))).collect();
        let (near, far) = (out.len() / 20, out.len() * 19 / 20);
        let (_, &mut reach, _) = out.select_nth_unstable_by(far, f64::total_cmp);
        let (_, &mut least, _) = out[..=far].select_nth_unstable_by(near, f64::total_cmp);
        // A part lies to one side of its hinge.
        (least > -0.15 * reach).then_some(Self { arm, least, reach, along: axis.dot(&mean) })
    }

    /// True if both patches reach about as far, at about the same place along the line.
    pub fn alike(&self, other: &Self) -> bool {
        let most = MAX_CHANGE * self.reach.max(other.reach);
        (self.reach - other.reach).abs() < most && (self.along - other.along).abs() < most
    }
}

/// A plane beside the line, in a keyframe.
pub struct PlaneObservation {
    /// Frame number.
    pub frame: usize,
    /// Pose of the plane about the line.
    pub pose: PoseAboutAxis,
    /// Angle of the plane's arm about the line, radians, from a direction that is the same in all keyframes.
    pub turn: f64,
    /// Unit normal, base frame.
    pub normal: Vector3<f64>,
    /// Number of samples on the plane.
    pub samples: usize,
    /// True if the face faces the way the part turns.
    pub fore: bool,
}

/// A plane along the line but not beside it, in a keyframe: the part's edge, or anything else.
pub struct Edge {
    /// Frame number.
    pub frame: usize,
    /// Angle of the plane's middle about the line, radians, from a direction that is the same in all keyframes.
    pub turn: f64,
    /// Distance of the plane from the line along the normal, metres.
    pub distance: f64,
    /// Position of the plane's middle along the line, metres.
    pub along: f64,
    /// Width across the line, metres: that of a uniform strip with the same variance.
    width: f64,
    /// Number of samples on the plane.
    pub samples: usize,
}

impl Edge {
    /// True if both could be the same surface: about the same distance from the line, position along it, and width.
    pub fn alike(&self, other: &Self) -> bool {
        (self.distance - other.distance).abs() < SAME_DISTANCE_M
            && (self.along - other.along).abs() < SAME_PLACE_M
            && (self.width - other.width).abs() < SAME_WIDTH * self.width.max(other.width)
    }
}

/// Angle of a direction about an axis, radians, from a direction that depends only on the axis.
fn angle(direction: &Vector3<f64>, axis: &Vector3<f64>) -> f64 {
    let (u, v) = orthonormal_basis(axis);
    direction.dot(&v).atan2(direction.dot(&u))
}

/// The patches whose planes are beside the line.
pub fn plane_observations(line: &JointGeometry, patches: &[PlanePatch]) -> Vec<PlaneObservation> {
    let (axis, origin) = (line.axis.into_inner(), line.origin);
    patches
        .iter()
        .filter(|p| {
            p.normal.dot(&axis).abs() < MAX_TILT
                && (p.offset - p.normal.dot(&origin.coords)).abs() < MAX_DISTANCE_M
        })
        .filter_map(|p| {
            let pose = PoseAboutAxis::of(p, &origin, &axis)?;
            let turn = angle(&pose.arm, &axis);
            let fore = axis.cross(&pose.arm).dot(&p.normal) > 0.0;
            let (frame, normal, samples) = (p.frame, p.normal, p.points.len());
            Some(PlaneObservation { frame, pose, turn, normal, samples, fore })
        })
        .collect()
}

/// The patches whose planes are along the line but not beside it.
pub fn edges(line: &JointGeometry, patches: &[PlanePatch]) -> Vec<Edge> {
    let (axis, origin) = (line.axis.into_inner(), line.origin);
    patches
        .iter()
        .filter(|p| p.normal.dot(&axis).abs() < MAX_TILT)
        .map(|p| {
            let n = p.points.len() as f64;
            let middle = p.points.iter().map(|x| x - origin).sum::<Vector3<f64>>() / n;
            let across = axis.cross(&p.normal);
            let out = |x: &Point3<f64>| across.dot(&(x - origin - middle)).powi(2);
            Edge {
                frame: p.frame,
                turn: angle(&middle, &axis),
                distance: p.offset - p.normal.dot(&origin.coords),
                along: axis.dot(&middle),
                width: (12.0 * p.points.iter().map(out).sum::<f64>() / n).sqrt(),
                samples: p.points.len(),
            }
        })
        .filter(|e| e.distance.abs() > MAX_DISTANCE_M)
        .collect()
}

/// The angle that differs from `angle` by whole turns and lies nearest to `to`, radians.
pub fn near(angle: f64, to: f64) -> f64 {
    to + wrapped(angle - to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn an_angle_is_taken_where_it_continues_the_last() {
        assert!((near(-3.0, 3.0) - (TAU - 3.0)).abs() < 1e-12);
        assert!((near(0.2, 0.0) - 0.2).abs() < 1e-12);
    }
}
