//! Merges two segments of one joint, which was seen in two intervals of time, for instance when it
//! opened and when it closed, because its surfaces turned away or an arm occluded them. The
//! segments share the line; their configurations are aligned by common frames or by depth images.
//!
//! In: two joints in the frame of one parent, and candidate tracks. Out: one joint in that frame;
//! metres, radians.

use super::association::associate;
use super::bundle_adjustment::{FINISH_STEPS, OUTLIER_CUT, refine};
use super::estimate::JointEstimate;
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::rigid::{distance_to_line, line_angle, nearest_on_line};
use crate::math::robust::{median, overlap};
use nalgebra::Point3;

/// Largest angle between the axes of two segments of one joint, radians.
const MAX_ANGLE: f64 = 0.175;
/// Largest distance between the lines of two segments of one hinge, metres.
const MAX_DISTANCE: f64 = 0.05;
/// Smallest number of common frames from which the configurations of two segments are compared.
const COMMON_FRAMES: usize = 8;
/// Smallest number of frames that a segment must add.
const LEAST_MORE: usize = 5;
/// Largest number of tracks of each segment on which the merged joint is refined.
const TRACKS_EACH: usize = 75;

/// Closeness of the lines of two segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LineMatch {
    /// The lines agree within the error to which the line of a joint is usually known.
    Same,
    /// The lines may be one, displaced by short segments or grazing views: the segments are one
    /// joint if one line explains both.
    Possible,
}

impl LineMatch {
    fn slack(self) -> f64 {
        match self {
            Self::Same => 1.0,
            Self::Possible => 2.0,
        }
    }

    /// Share of the smaller gain that the merged joint must add to the larger gain.
    pub fn required_gain(self) -> f64 {
        match self {
            Self::Same => 0.0,
            Self::Possible => 0.5,
        }
    }
}

/// Closeness of two joints' lines, if these have the same type, near lines, and configurations that
/// change alike over common frames; else `None`.
pub fn line_match(a: &JointEstimate, b: &JointEstimate) -> Option<LineMatch> {
    [LineMatch::Same, LineMatch::Possible].into_iter().find(|k| lines_match(a, b, k.slack()))
}

/// True if `other` is known in at least `LEAST_MORE` frames in which `joint` is not. In the
/// common frames `joint` would have gathered the tracks of `other` itself.
pub fn adds_frames(joint: &JointEstimate, other: &JointEstimate) -> bool {
    let beyond = joint.known.iter().zip(&other.known).filter(|(here, there)| !**here && **there);
    beyond.count() >= LEAST_MORE
}

/// True if two joints are of the same type and on near lines; for slides only the directions are
/// compared. `slack` is a factor on the limits.
pub fn shares_line(a: &JointEstimate, b: &JointEstimate, slack: f64) -> bool {
    if a.dof.hinge != b.dof.hinge || line_angle(&a.dof.axis, &b.dof.axis) > slack * MAX_ANGLE {
        return false;
    }
    if !a.dof.hinge {
        return true;
    }
    let n = b.members.len().max(1) as f64;
    let centre: nalgebra::Vector3<f64> =
        b.members.iter().map(|&t| b.points[t].coords).sum::<nalgebra::Vector3<f64>>() / n;
    let on_b = nearest_on_line(&b.dof.origin, &b.dof.axis, &Point3::from(centre));
    distance_to_line(&a.dof.origin, &a.dof.axis, &on_b) <= slack * MAX_DISTANCE
}

fn lines_match(a: &JointEstimate, b: &JointEstimate, slack: f64) -> bool {
    if !shares_line(a, b, slack) {
        return false;
    }
    let differences = differences(a, b);
    if differences.len() < COMMON_FRAMES {
        // Any two parallel slides match. They must also share tracks, and more of them than those
        // of the arm that moves both.
        let shared = overlap(&a.members, &b.members).max(overlap(&b.members, &a.members));
        return a.dof.hinge || shared > 0.3;
    }
    let mut sorted = differences.clone();
    let middle = median(&mut sorted).unwrap_or(0.0);
    let mut deviations: Vec<f64> = differences.iter().map(|d| (d - middle).abs()).collect();
    deviations.sort_by(f64::total_cmp);
    deviations[deviations.len() * 9 / 10] < 0.25 * a.span().max(b.span())
}

fn sign(a: &JointEstimate, b: &JointEstimate) -> f64 {
    if a.dof.axis.dot(&b.dof.axis) > 0.0 { 1.0 } else { -1.0 }
}

/// Configuration of `a` less that of `b` in common frames; the sign of `b` is reversed if its axis
/// points the other way.
fn differences(a: &JointEstimate, b: &JointEstimate) -> Vec<f64> {
    let s = sign(a, b);
    (0..a.q.len()).filter(|&f| a.known[f] && b.known[f]).map(|f| a.q[f] - s * b.q[f]).collect()
}

/// Merges both segments into one joint; `None` where fewer than five tracks follow it.
pub fn merged(
    view: &TracksInFrame,
    a: &JointEstimate,
    b: &JointEstimate,
    candidates: &[usize],
) -> Option<JointEstimate> {
    let s = sign(a, b);
    let mut common = differences(a, b);
    let offset = if common.len() >= 3 {
        median(&mut common)?
    } else {
        let a_by_depth = &a.evidence.configuration_from_depth;
        let mut by_depth: Vec<f64> = (0..b.q.len())
            .filter(|&f| b.known[f] && a_by_depth[f].is_finite())
            .map(|f| a_by_depth[f] - s * b.q[f])
            .collect();
        median(&mut by_depth).unwrap_or(0.0)
    };
    let mut joint = a.clone();
    for f in 0..joint.q.len() {
        if !joint.known[f] && b.known[f] {
            joint.q[f] = s * b.q[f] + offset;
            joint.known[f] = true;
        }
    }
    let mut some: Vec<usize> = spread(&a.members).chain(spread(&b.members)).collect();
    some.sort_unstable();
    some.dedup();
    refine(&mut joint, view, &some, OUTLIER_CUT, FINISH_STEPS + 1);
    associate(view, &mut joint, candidates, 3);
    (joint.members.len() >= 5).then_some(joint)
}

fn spread(members: &[usize]) -> impl Iterator<Item = usize> + '_ {
    members.iter().copied().step_by(members.len().div_ceil(TRACKS_EACH).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::Vector3;

    /// A door that opens and closes, known between two frames; its configuration has an offset.
    fn door(known: std::ops::Range<usize>, offset: f64) -> (TracksInFrame, JointEstimate) {
        let hinge = ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5));
        let q: Vec<f64> = (0..80).map(|f| 0.6 * (0.04 * f64::from(f)).sin()).collect();
        let places: Vec<Point3<f64>> = (0..12)
            .map(f64::from)
            .map(|i| Point3::new(0.15 + 0.03 * i, 0.2 * (1.3 * i).sin(), 1.5))
            .collect();
        let view = seen_moving(&hinge, &places, &q);
        let mut joint = JointEstimate::new(hinge, &view, known.start);
        joint.known = (0..80).map(|f| known.contains(&f)).collect();
        joint.q = q.iter().map(|q| q - offset).collect();
        joint.points = places.iter().map(|p| hinge.move_point(offset, p)).collect();
        joint.members = (0..12).collect();
        joint.summarise();
        (view, joint)
    }

    #[test]
    fn two_segments_of_a_door_are_one_joint_with_one_configuration() {
        let (view, opening) = door(0..50, 0.0);
        let (_, closing) = door(35..80, 0.2);
        assert_eq!(line_match(&opening, &closing), Some(LineMatch::Same));
        assert!(adds_frames(&opening, &closing));
        let all: Vec<usize> = (0..12).collect();
        let whole = merged(&view, &opening, &closing, &all).unwrap();
        assert!(whole.known.iter().all(|k| *k));
        let back = whole.q[79] - whole.q[0];
        assert!((back - 0.6 * (0.04 * 79.0_f64).sin()).abs() < 0.02, "{back}");
    }

    #[test]
    fn a_door_and_a_drawer_are_two_joints() {
        let (_, opening) = door(0..50, 0.0);
        let slide = ScrewJoint::slide(Vector3::z(), Point3::origin());
        assert_eq!(line_match(&opening, &JointEstimate { dof: slide, ..opening.clone() }), None);
    }
}
