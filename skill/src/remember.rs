//! Demonstrations of one object, merged (paper, section III-E): an object that is seen again is
//! recognised in the first frame of the newer demonstration, which is then registered into the
//! object's frame.
//!
//! In: what is stored of an object, and a newer demonstration, in the frame of its first camera. Out:
//! the object with the joints of both, in the object frame, metres and radians. A joint that both saw
//! is fused by the covariances of its line (a Kalman update); one that is new is added with its part.

use crate::config::SkillConfig;
use crate::learn::appearance::build;
use crate::learn::demonstration::Demonstration;
use crate::math::rigid::{Pose, distance_to_line, line_angle, pose_from_array};
use crate::object::appearance::{Appearance, ModelFeature};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::{Joint, ObjectModel, covariance_rows};
use crate::object::stored_object::{Provenance, StoredObject};
use crate::recognise::{KnownObject, Scene, find};
use crate::vision_error::VisionError;
use nalgebra::{Matrix6, Point3, UnitVector3, Vector3, Vector6};

/// Two demonstrations of one object that do not go together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CombineError {
    /// The object is not found in the new demonstration.
    #[error(
        "the {object} of the earlier demonstrations is not recognised in this one; give it a name of its own"
    )]
    NotRecognised {
        /// The object.
        object: String,
    },
    /// A part moves otherwise than it did.
    #[error(
        "the demonstrations of {object} contradict each other about {joint}: {what}; demonstrate it again, or remove the wrong one from the store"
    )]
    Contradiction {
        /// The object.
        object: String,
        /// The joint of the earlier demonstrations.
        joint: String,
        /// How they differ.
        what: String,
    },
    /// The vision library failed.
    #[error("vision: {0}")]
    Vision(#[from] VisionError),
}

/// Largest angle between axes of one joint in two demonstrations, radians.
const SAME_AXIS_RAD: f64 = 0.2;
/// Largest distance between hinges of one joint in two demonstrations, metres.
const SAME_HINGE_M: f64 = 0.06;
/// Largest difference between a screw's pitches in two demonstrations, metres a turn.
const SAME_PITCH_M: f64 = 0.02;
/// Surface this near is the same surface, metres.
const SAME_SURFACE_M: f64 = 0.03;
/// Share of a part's surface that must be the same in two demonstrations.
const SAME_PART: f64 = 0.3;

/// A demonstration as an object of the store.
///
/// # Errors
/// [`VisionError`] if the vision library fails.
pub fn to_stored(
    demonstration: &Demonstration,
    provenance: Provenance,
) -> Result<StoredObject, VisionError> {
    Ok(StoredObject {
        model: demonstration.model.clone(),
        appearance: build(demonstration).map_err(VisionError::new)?,
        provenance: vec![provenance],
    })
}

/// A demonstration as an object, registered into what is known of it already, if anything is.
///
/// # Errors
/// [`CombineError::NotRecognised`] when the known object is not in the demonstration's first
/// keyframe; [`CombineError::Contradiction`] when one part moves in two ways.
pub fn add_demonstration(
    known: Option<&StoredObject>,
    demonstration: &Demonstration,
    provenance: Provenance,
    config: &SkillConfig,
) -> Result<StoredObject, CombineError> {
    match known {
        None => Ok(to_stored(demonstration, provenance)?),
        Some(known) => register(known, demonstration, provenance, config),
    }
}

/// Registers a newer demonstration into the first object frame: joints that both saw are
/// estimated over both and their ranges united, joints that are new are added with their parts.
///
/// # Errors
/// [`CombineError::NotRecognised`] when the known object is not in the demonstration's first
/// keyframe; [`CombineError::Contradiction`] when one part moves in two ways.
fn register(
    known: &StoredObject,
    newer: &Demonstration,
    provenance: Provenance,
    config: &SkillConfig,
) -> Result<StoredObject, CombineError> {
    let found = recognised_at_start(known, newer, config)?;
    let appearance = build(newer).map_err(VisionError::new)?;
    let motions = known.model.part_motions(&found.configurations);
    let mut stored = known.clone();
    stored.model.demonstrations += 1;
    stored.provenance.push(provenance);
    for joint in &newer.model.joints {
        let newer_surface = surface(&appearance, joint.child, &Pose::identity());
        let twin = known.model.joints.iter().position(|own| {
            // The known part where it stands at the newer demonstration's start.
            let newer_from_known = found.newer_from_object * motions[own.child];
            let known_surface = surface(&known.appearance, own.child, &newer_from_known);
            shared(&newer_surface, &known_surface) > SAME_PART
        });
        let object_from_newer = found.newer_from_object.inverse();
        match twin {
            Some(i) => {
                let own = &mut stored.model.joints[i];
                let start = found.configurations[i];
                fuse_joint(own, joint, &object_from_newer, start).map_err(|what| {
                    let (object, joint) = (known.model.object.clone(), own.name.clone());
                    CombineError::Contradiction { object, joint, what }
                })?;
            }
            None => add_joint(&mut stored, newer, joint, &appearance, &object_from_newer),
        }
    }
    let room = appearance.room.iter().map(|f| moved(f, &found.newer_from_object.inverse()));
    let older = std::mem::take(&mut stored.appearance.room);
    stored.appearance.room = room.chain(older).take(MAX_ROOM_FEATURES).collect();
    Ok(stored)
}

/// Where a known object is at the start of a newer demonstration.
struct AtStart {
    /// The newer demonstration's frame is its first camera's.
    newer_from_object: Pose,
    /// Configuration of each known joint.
    configurations: Vec<f64>,
}

/// Recognises a known object in the first keyframe of a newer demonstration.
fn recognised_at_start(
    known: &StoredObject,
    newer: &Demonstration,
    config: &SkillConfig,
) -> Result<AtStart, CombineError> {
    let unrecognised = || CombineError::NotRecognised { object: known.model.object.clone() };
    let (_, first) = newer.keyframes.iter().next().ok_or_else(unrecognised)?;
    let object = KnownObject::new(known.model.clone(), &known.appearance);
    let found = find(&Scene::new(first)?, &object, &config.recognise, config.seed)
        .filter(|f| f.score >= config.recognise.min_score)
        .ok_or_else(unrecognised)?;
    let newer_from_object = pose_from_array(&found.camera_from_object).ok_or_else(unrecognised)?;
    Ok(AtStart { newer_from_object, configurations: found.assumed })
}

/// Brings a joint that both demonstrations saw up to date: its line, its range, its observations.
/// `start` is its configuration at the newer demonstration's start. The error says how the two
/// contradict each other.
fn fuse_joint(
    own: &mut Joint,
    newer: &Joint,
    object_from_newer: &Pose,
    start: f64,
) -> Result<(), String> {
    let line = newer.geometry().transformed(object_from_newer);
    if let Some(what) = contradiction(&own.geometry(), &line) {
        return Err(what);
    }
    // A line that another part carries is known only where that part was.
    if own.parent == 0 && newer.parent == 0 {
        fuse_kalman(own, newer, object_from_newer);
    }
    let sign = Vector3::from(own.axis).dot(&line.axis).signum();
    let ends = newer.range.map(|q| start + sign * q);
    own.range[0] = own.range[0].min(ends[0].min(ends[1]));
    own.range[1] = own.range[1].max(ends[0].max(ends[1]));
    own.observations += newer.observations;
    Ok(())
}

/// Places of a part's surface, moved.
fn surface(appearance: &Appearance, part: usize, moved: &Pose) -> Vec<Point3<f64>> {
    appearance
        .surfels
        .iter()
        .filter(|s| usize::from(s.part) == part)
        .map(|s| moved * Point3::from(Vector3::from(s.point).map(f64::from)))
        .collect()
}

/// Share of `surface` that lies on `other`.
fn shared(surface: &[Point3<f64>], other: &[Point3<f64>]) -> f64 {
    let on = |p: &&Point3<f64>| other.iter().any(|o| (*p - o).norm() < SAME_SURFACE_M);
    surface.iter().filter(on).count() as f64 / surface.len().max(1) as f64
}

/// How a part's motion in a newer demonstration, in the object frame, differs from what is
/// known of it.
fn contradiction(known: &JointGeometry, newer: &JointGeometry) -> Option<String> {
    if known.kind != newer.kind {
        return Some(format!("it was {}, now it is {}", known.kind.name(), newer.kind.name()));
    }
    let angle = line_angle(&known.axis, &newer.axis);
    if angle > SAME_AXIS_RAD {
        return Some(format!("the axes differ by {:.0}°", angle.to_degrees()));
    }
    let apart = distance_to_line(&known.origin, &known.axis, &newer.origin);
    if known.kind != JointKind::Prismatic && apart > SAME_HINGE_M {
        return Some(format!("the hinges are {:.0} cm apart", 100.0 * apart));
    }
    let other_pitch = known.pitch - newer.pitch;
    (other_pitch.abs() > SAME_PITCH_M)
        .then(|| format!("the pitches differ by {:.1} cm a turn", 100.0 * other_pitch.abs()))
}

/// Features of the rooms of all demonstrations that are kept, those of the newest first: there it stands
/// now.
const MAX_ROOM_FEATURES: usize = 2400;

/// How well a demonstration is registered into the object frame: standard deviations of its
/// rotation, radians, and of its place, metres, as `bench --suite recognise` finds the base.
const REGISTRATION: (f64, f64) = (0.004, 0.004);
/// Keeps covariances of unit axes, which have no extent along the axis, invertible.
const RIDGE: f64 = 1e-12;

/// Brings what a newer demonstration says of a joint's line into what is known of it: a Kalman
/// update, each weighed by its covariance.
fn fuse_kalman(own: &mut Joint, newer: &Joint, object_from_newer: &Pose) {
    let (Some(known), Some(seen)) = (own.known_covariance(), newer.known_covariance()) else {
        return;
    };
    let (before, line) = (own.geometry(), newer.geometry().transformed(object_from_newer));
    let axis = before.axis.dot(&line.axis).signum() * line.axis.into_inner();
    // The newer origin slides along its line to beside the known one, and the uncertainty of
    // the axis with it.
    let along = axis.dot(&(before.origin - line.origin));
    let seen = registered(&seen, object_from_newer, along);
    let ridge = Matrix6::identity() * RIDGE;
    let Some(inverse) = (known + seen + ridge).try_inverse() else { return };
    let gain = known * inverse;
    let difference = [axis - before.axis.into_inner(), line.origin + along * axis - before.origin];
    let step = gain * Vector6::from_iterator(difference.iter().flat_map(|d| d.iter().copied()));
    let axis = UnitVector3::new_normalize(before.axis.into_inner() + step.fixed_rows::<3>(0));
    own.axis = axis.into_inner().into();
    own.origin = (before.origin + step.fixed_rows::<3>(3)).into();
    let left = (Matrix6::identity() - gain) * known;
    own.covariance = covariance_rows(&left);
}

/// A covariance of axis and origin in the object frame, the origin moved `along` the axis.
fn registered(covariance: &Matrix6<f64>, object_from_newer: &Pose, along: f64) -> Matrix6<f64> {
    let mut carried = Matrix6::identity();
    let turn = object_from_newer.rotation.to_rotation_matrix().into_inner();
    carried.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    carried.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    carried.fixed_view_mut::<3, 3>(3, 0).copy_from(&(along * turn));
    let mut registered = carried * covariance * carried.transpose();
    for k in 0..3 {
        registered[(k, k)] += REGISTRATION.0.powi(2);
        registered[(k + 3, k + 3)] += REGISTRATION.1.powi(2);
    }
    registered
}

/// A joint that the earlier demonstrations did not move, with its part's appearance.
fn add_joint(
    stored: &mut StoredObject,
    newer: &Demonstration,
    joint: &Joint,
    appearance: &Appearance,
    object_from_newer: &Pose,
) {
    let model: &mut ObjectModel = &mut stored.model;
    let id = model.parts.len();
    let line = joint.geometry().transformed(object_from_newer);
    let mut added = joint.clone();
    added.name = format!("joint{}", model.joints.len() + 1);
    added.parent = 0;
    added.child = id;
    added.axis = line.axis.into_inner().into();
    added.origin = line.origin.into();
    if let Some(seen) = joint.known_covariance() {
        added.covariance = covariance_rows(&registered(&seen, object_from_newer, 0.0));
    }
    model.joints.push(added);
    let mut part = newer.model.parts[joint.child].clone();
    part.id = id;
    part.name = format!("part{id}");
    part.grasp = part.grasp.map(|g| (object_from_newer * Point3::from(g)).into());
    model.parts.push(part);
    stored.appearance =
        with_part(&stored.appearance, appearance, joint.child, id, object_from_newer);
}

/// An appearance with that of a part of a newer demonstration, which becomes part `id`.
fn with_part(
    known: &Appearance,
    newer: &Appearance,
    part: usize,
    id: usize,
    object_from_newer: &Pose,
) -> Appearance {
    let place = |p: [f32; 3]| moved_place(p, object_from_newer);
    let turn = |n: [f32; 3]| turned(n, object_from_newer);
    let mut result = known.clone();
    for f in newer.features.iter().filter(|f| usize::from(f.part) == part) {
        result.features.push(ModelFeature { part: id as u16, ..moved(f, object_from_newer) });
    }
    for s in newer.surfels.iter().filter(|s| usize::from(s.part) == part) {
        let mut s = *s;
        (s.part, s.point, s.normal) = (id as u16, place(s.point), turn(s.normal));
        result.surfels.push(s);
    }
    for e in newer.edges.iter().filter(|e| usize::from(e.part) == part) {
        let mut e = *e;
        (e.part, e.surface, e.normal, e.beyond) =
            (id as u16, place(e.surface), turn(e.normal), place(e.beyond));
        result.edges.push(e);
    }
    result
}

/// A feature in the object frame of a newer demonstration, in that of the object.
fn moved(feature: &ModelFeature, object_from_newer: &Pose) -> ModelFeature {
    ModelFeature {
        point: moved_place(feature.point, object_from_newer),
        normal: turned(feature.normal, object_from_newer),
        ..feature.clone()
    }
}

fn moved_place(place: [f32; 3], by: &Pose) -> [f32; 3] {
    let moved = by * Point3::from(Vector3::from(place).map(f64::from));
    moved.coords.map(|x| x as f32).into()
}

fn turned(direction: [f32; 3], by: &Pose) -> [f32; 3] {
    (by * Vector3::from(direction).map(f64::from)).map(|x| x as f32).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Unit;

    fn hinge() -> JointGeometry {
        line(JointKind::Revolute, [0.0, 1.0, 0.0], [0.4, 0.0, 1.0])
    }

    fn line(kind: JointKind, axis: [f64; 3], origin: [f64; 3]) -> JointGeometry {
        let axis = Unit::new_normalize(Vector3::from(axis));
        JointGeometry { kind, axis, origin: Point3::from(origin), pitch: 0.0 }
    }

    #[test]
    fn the_same_hinge_seen_again_contradicts_nothing() {
        // Its axis may point the other way, and its origin lie elsewhere on the line.
        let again = line(JointKind::Revolute, [0.02, -1.0, 0.0], [0.41, 0.7, 1.01]);
        assert_eq!(contradiction(&hinge(), &again), None);
    }

    #[test]
    fn what_two_demonstrations_disagree_about_is_said() {
        let says = |newer: JointGeometry| contradiction(&hinge(), &newer).unwrap();
        let slide = line(JointKind::Prismatic, [0.0, 1.0, 0.0], [0.4, 0.0, 1.0]);
        assert!(says(slide).contains("was revolute, now it is prismatic"));
        let tilted = line(JointKind::Revolute, [0.0, 1.0, 0.7], [0.4, 0.0, 1.0]);
        assert!(says(tilted).contains("35°"));
        let elsewhere = line(JointKind::Revolute, [0.0, 1.0, 0.0], [-0.1, 0.0, 1.0]);
        assert!(says(elsewhere).contains("50 cm apart"));
    }

    /// A hinge whose axis and place are this uncertain, all ways.
    fn known(line: &JointGeometry, sigma: f64) -> Joint {
        let mut covariance = vec![[0.0; 6]; 6];
        (0..6).for_each(|k| covariance[k][k] = sigma * sigma);
        Joint { covariance, ..Joint::of(line) }
    }

    #[test]
    fn a_joint_is_estimated_over_demonstrations_by_what_each_knows() {
        let object_from_newer = Pose::from_parts(
            Vector3::new(0.3, -0.2, 0.1).into(),
            nalgebra::UnitQuaternion::from_euler_angles(0.2, -0.4, 0.1),
        );
        let truth = line(JointKind::Revolute, [0.0, 1.0, 0.0], [0.4, 0.0, 1.0]);
        // It points the other way, and its origin is farther down the same line.
        let seen = line(JointKind::Revolute, [0.0, -1.0, 0.0], [0.4, 0.5, 1.0])
            .transformed(&object_from_newer.inverse());
        let newer = known(&seen, 1e-4);
        let off = |joint: &Joint| {
            let place = distance_to_line(&truth.origin, &truth.axis, &Point3::from(joint.origin));
            (line_angle(&truth.axis, &joint.geometry().axis), place)
        };
        let rough = line(JointKind::Revolute, [0.0, 1.0, 0.1], [0.44, 0.0, 1.0]);
        let mut vague = known(&rough, 0.05);
        fuse_kalman(&mut vague, &newer, &object_from_newer);
        assert!(off(&vague).0 < 0.005 && off(&vague).1 < 0.005, "{:?}", off(&vague));
        assert!(vague.covariance[0][0] < 1e-4 && vague.axis[1] > 0.0);
        let mut sure = known(&truth, 1e-4);
        let aside = line(JointKind::Revolute, [0.0, 1.0, 0.2], [0.5, 0.0, 1.0]);
        let wrong = known(&aside, 0.05);
        fuse_kalman(&mut sure, &wrong, &Pose::identity());
        assert!(off(&sure).0 < 1e-4 && off(&sure).1 < 1e-4, "{:?}", off(&sure));
    }

    #[test]
    fn surface_is_shared_where_it_lies_on_the_other() {
        let row = |from: i32, to: i32| -> Vec<Point3<f64>> {
            (from..to).map(|i| Point3::new(0.05 * f64::from(i), 0.0, 1.0)).collect()
        };
        assert!((shared(&row(0, 10), &row(5, 15)) - 0.5).abs() < 1e-9);
        assert_eq!(shared(&[], &row(0, 3)), 0.0);
    }
}
