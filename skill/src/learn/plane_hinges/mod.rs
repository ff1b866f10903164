//! Learns hinges by depth alone. Where no track shows a joint, because texture is missing or a lid turns its other
//! face, a flat part is still seen to turn: its planes in all keyframes keep their distance from the line of the
//! hinge.
//!
//! A slide of a plain surface in its own plane leaves no trace in depth, and a slide along its normal is ambiguous,
//! so only hinges are searched for.
//!
//! In: the joints that tracks showed, and the recording.
//! Out: these joints, with configurations where tracks were lost, and the hinges of plain parts that no track showed.
//! Lines and points are in the base frame, metres and radians.

mod axis_direction;
mod carried_parts;
mod depth_following;
mod extend_range;
mod face_edge;
mod hinge;
mod line_alignment;
mod part_plane;
mod place_fusion;
mod plain_part;
mod plain_search;
mod plane_segments;
mod planes_about_axis;
mod same_joint;
#[cfg(test)]
pub(super) mod test_data;

use super::learned_joint::{LearnedJoint, LearnedJoints};
use super::recording::Recording;
use crate::object::model::Joint;
use carried_parts::{carried_parts, hang_on_carrier};
use extend_range::{extend, extend_to, pose_anew};
use place_fusion::fuse_place;
use plain_part::PlainPart;
use plain_search::{PlainParts, search};
use same_joint::{is_known, is_meagre};
pub use same_joint::{is_same_hinge, moves_together, take_turns};

/// Largest share of the range of a plain part's hinge that tracks of the same hinge show, for the plain part to
/// replace them.
const LESS_OF_THE_RANGE: f64 = 0.8;

/// Adds to the joints from tracks what planes show: hinges that no track showed, and configurations where tracks were
/// lost.
pub fn complete(found: LearnedJoints, recording: &Recording) -> LearnedJoints {
    let LearnedJoints { mut joints, mut rejections, .. } = found;
    extend(&mut joints, recording);
    let is_chain = joints.iter().any(|j| j.joint.parent != 0);
    if !is_chain {
        // Duplicates are removed before a plain part takes a joint over, so that it does not take over a duplicate.
        let doubles: Vec<bool> = joints.iter().map(|j| is_double(j, &joints)).collect();
        let mut doubles = doubles.into_iter();
        joints.retain(|_| !doubles.next().unwrap_or(false));
    }
    let mut plain: Vec<LearnedJoint> = Vec::new();
    let mut known: Vec<LearnedJoint> = Vec::new();
    let PlainParts { parts, unknown_lines, turning } = search(recording);
    for part in parts {
        let mut learned = part.to_learned(recording);
        if !is_chain {
            take_over(&mut joints, &mut learned);
            fuse(&mut joints, &learned, recording);
        }
        // Both faces of a lid are one part.
        let is_same_part = |p: &LearnedJoint| {
            is_same_hinge(&p.joint, &learned.joint) && moves_together(p, &learned)
        };
        if plain.iter().chain(&known).any(is_same_part) {
            continue;
        }
        if !joints.iter().any(|j| is_known(j, &learned)) {
            extend_to(part.reach(), &mut learned, recording);
            plain.push(learned);
        } else {
            known.push(learned);
        }
    }
    // The motion of a hand that held a plain part is not a joint of its own.
    let is_held_by = |j: &LearnedJoint, part: &LearnedJoint| {
        !is_same_hinge(&j.joint, &part.joint) && moves_together(part, j)
    };
    let is_hand = |j: &LearnedJoint| {
        is_meagre(j) && plain.iter().chain(&known).any(|part| is_held_by(j, part))
    };
    if !is_chain {
        joints.retain(|j| !is_hand(j));
        number(&mut joints, 1);
    }
    number(&mut plain, joints.len() + 1);
    plain.iter_mut().for_each(|part| hang_on_carrier(part, &joints, recording));
    joints.append(&mut plain);
    let mut carried = carried_parts(&joints, recording);
    number(&mut carried, joints.len() + 1);
    joints.append(&mut carried);
    // A part whose motion a joint explains is not reported as unclear.
    let is_told = |part: &PlainPart| {
        let learned = part.to_learned(recording);
        joints.iter().any(|j| moves_together(j, &learned))
    };
    rejections.extend(unknown_lines.iter().filter(|p| !is_told(p)).map(PlainPart::unknown_line));
    LearnedJoints { joints, rejections, turning }
}

/// Lets a plain part take the place of a joint whose tracks show less of the same hinge: they were lost as the part
/// turned away. Few tracks are on the hand or on the part's edge and are dropped; many are on the part and are kept.
fn take_over(joints: &mut Vec<LearnedJoint>, plain: &mut LearnedJoint) {
    let Some(i) = joints.iter().position(|j| shows_less(&j.joint, &plain.joint)) else { return };
    let tracked = joints.remove(i);
    if !is_meagre(&tracked) {
        plain.joint.log_likelihood = tracked.joint.log_likelihood;
        plain.tracks = tracked.tracks;
    }
}

/// Fuses the place of a joint's line from tracks with that of the same part's line from planes.
fn fuse(joints: &mut [LearnedJoint], plain: &LearnedJoint, recording: &Recording) {
    for tracked in joints {
        if is_same_hinge(&tracked.joint, &plain.joint)
            && moves_together(tracked, plain)
            && fuse_place(tracked, &plain.joint)
        {
            tracing::debug!(joint = tracked.joint.name, "placed by its planes");
            pose_anew(tracked, &recording.tracks);
        }
    }
}

/// Numbers and names joints in their order, starting with `first`.
fn number(joints: &mut [LearnedJoint], first: usize) {
    for (i, learned) in joints.iter_mut().enumerate() {
        learned.joint.child = first + i;
        learned.joint.name = format!("joint{}", first + i);
    }
}

/// True if few tracks show a hinge that many tracks of another joint show as well and both turn together: they are on
/// the same part, badly placed.
fn is_double(learned: &LearnedJoint, all: &[LearnedJoint]) -> bool {
    let is_of = |other: &LearnedJoint| {
        !is_meagre(other)
            && is_same_hinge(&learned.joint, &other.joint)
            && moves_together(learned, other)
    };
    is_meagre(learned) && all.iter().any(is_of)
}

/// True if tracks show about the same hinge as a plain part's planes, over less of its range.
fn shows_less(tracked: &Joint, plain: &Joint) -> bool {
    let turn = |joint: &Joint| joint.range[1] - joint.range[0];
    is_same_hinge(tracked, plain) && turn(tracked) < LESS_OF_THE_RANGE * turn(plain)
}

#[cfg(test)]
mod tests {
    use super::same_joint::MEAGRE_GAIN;
    use super::test_data::{door_recording, turn};
    use super::*;
    use crate::math::rigid::distance_to_line;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::{Point3, UnitVector3, Vector3};

    fn hinge(direction: [f64; 3], origin: [f64; 3]) -> JointGeometry {
        let direction = UnitVector3::new_normalize(Vector3::from(direction));
        JointGeometry::hinge(direction, Point3::from(origin))
    }

    fn learned(q: impl Fn(f64) -> f64) -> LearnedJoint {
        let configuration = (0..20).map(|i| [f64::from(i), q(f64::from(i))]).collect();
        let line = hinge([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        let joint = Joint { configuration, ..Joint::of(&line) };
        LearnedJoint {
            joint,
            base_from_part: Vec::new(),
            tracks: Vec::new(),
            plain_surface: Vec::new(),
        }
    }

    #[test]
    fn a_plain_door_is_learned_by_its_planes_alone() {
        let recording = door_recording(24, turn);
        let learned = complete(LearnedJoints::default(), &recording).joints;
        assert_eq!(learned.len(), 1);
        let LearnedJoint { joint, base_from_part, plain_surface, .. } = &learned[0];
        let (axis, origin) = (Vector3::from(joint.axis), Point3::from(joint.origin));
        assert!(axis.y.abs() > 0.9998);
        assert!(distance_to_line(&origin, &axis, &Point3::new(-0.3, 0.0, 2.0)) < 0.02);
        assert!((joint.range[1] - joint.range[0] - 1.3).abs() < 0.03);
        // In each frame the surface lies where the door is.
        for (frame, pose) in base_from_part.iter().enumerate() {
            let Some(pose) = pose else { continue };
            let normal = Vector3::new(turn(frame).sin(), 0.0, turn(frame).cos());
            for p in plain_surface {
                let off = normal.dot(&(pose * p - Point3::new(-0.3, 0.0, 2.0)));
                assert!(off.abs() < 0.02, "{off} m off the door in frame {frame}");
            }
        }
    }

    #[test]
    fn a_few_badly_placed_tracks_of_a_door_do_not_stand_for_it() {
        let recording = door_recording(24, turn);
        let tracked = |gain: f64, z: f64, scale: f64| {
            let configuration = (0..11).map(|f| [0.1 * f as f64, scale * turn(f)]).collect();
            let range = [0.0, scale * turn(10)];
            let line = hinge([0.0, 1.0, 0.0], [-0.3, 0.0, z]);
            let joint = Joint { configuration, range, log_likelihood: gain, ..Joint::of(&line) };
            LearnedJoint { joint, base_from_part: vec![None; 24], ..learned(|_| 0.0) }
        };
        let (double, door) =
            (tracked(0.5 * MEAGRE_GAIN, 2.1, 0.5), tracked(5.0 * MEAGRE_GAIN, 2.0, 1.0));
        for joints in [vec![double.clone(), door.clone()], vec![door, double]] {
            let found = LearnedJoints { joints, ..LearnedJoints::default() };
            let learned = complete(found, &recording).joints;
            assert_eq!(learned.len(), 1);
            assert_eq!(learned[0].joint.log_likelihood, 5.0 * MEAGRE_GAIN);
            let turned = learned[0].joint.range[1] - learned[0].joint.range[0];
            assert!(turned > 1.2, "{turned}");
        }
    }

    #[test]
    fn a_door_that_stays_closed_or_stands_open_is_no_joint() {
        for stays in [0.0, 1.0] {
            let recording = door_recording(24, |_| stays);
            let found = complete(LearnedJoints::default(), &recording);
            assert!(found.joints.is_empty() && found.rejections.is_empty());
        }
    }

    #[test]
    fn a_hinge_is_the_same_only_near_the_line_of_the_tracks() {
        let plain = Joint::of(&hinge([0.0, 1.0, 0.0], [0.3, 0.1, 2.5]));
        let tracked = |direction, origin| Joint::of(&hinge(direction, origin));
        assert!(is_same_hinge(&tracked([0.1, -1.0, 0.0], [0.35, 0.8, 2.5]), &plain));
        assert!(!is_same_hinge(&tracked([0.0, 1.0, 0.0], [0.9, 0.1, 3.0]), &plain), "elsewhere");
        assert!(!is_same_hinge(&tracked([1.0, 0.0, 0.0], [0.3, 0.1, 2.5]), &plain), "crosswise");
    }

    #[test]
    fn tracks_that_show_half_of_a_hinge_show_less_than_its_planes() {
        let turning =
            |range| Joint { range, ..Joint::of(&hinge([0.0, 1.0, 0.0], [0.3, 0.1, 2.5])) };
        assert!(shows_less(&turning([0.0, 0.5]), &turning([0.0, 1.4])));
        assert!(!shows_less(&turning([0.0, 1.3]), &turning([0.0, 1.4])));
    }

    #[test]
    fn joints_move_together_where_one_configuration_is_a_function_of_the_other() {
        let door = learned(|t| 0.1 * t);
        assert!(moves_together(&door, &learned(|t| 0.3 - 0.02 * t)), "a hand on the door");
        let later = learned(|t| if t < 15.0 { 0.0 } else { 0.4 * ((t - 15.0) * 1.5).sin() });
        assert!(!moves_together(&door, &later), "another door, opened later");
    }

    #[test]
    fn a_few_tracks_of_a_lid_that_many_show_are_no_joint_of_their_own() {
        let of_gain = |gain: f64, q: fn(f64) -> f64| {
            let mut learned = learned(q);
            learned.joint.log_likelihood = gain;
            learned
        };
        let lid = of_gain(10.0 * MEAGRE_GAIN, |t| 0.1 * t);
        let double = of_gain(0.5 * MEAGRE_GAIN, |t| 0.3 - 0.05 * t);
        let seat =
            of_gain(0.5 * MEAGRE_GAIN, |t| if t < 15.0 { 0.0 } else { 0.4 * (t * 1.5).sin() });
        let all = [lid, double, seat];
        assert_eq!([0, 1, 2].map(|i| is_double(&all[i], &all)), [false, true, false]);
    }
}
