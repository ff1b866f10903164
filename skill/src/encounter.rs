//! The two things that are done with a learned object when it is met again: a demonstration
//! is registered into its first frame, or it is recognised (paper, section III-E).

use crate::appearance::{Appearance, build};
use crate::config::SkillConfig;
use crate::geometry::{Pose, line_angle, pose_from_array};
use crate::learn::Demonstration;
use crate::model::ObjectModel;
use crate::recognise::{KnownObject, Scene, find};
use crate::store::{Provenance, StoredObject};
use nalgebra::Vector3;

/// Two demonstrations of one object that do not go together.
#[derive(Debug, thiserror::Error)]
pub enum CombineError {
    /// The object is not found in the new demonstration.
    #[error(
        "the {object} of the earlier demonstrations is not recognised in this one; give it a name of its own"
    )]
    NotRecognised {
        /// The object.
        object: String,
    },
    /// The vision library failed.
    #[error("vision: {0}")]
    Vision(#[from] opencv::Error),
}

/// Largest angle between axes of one joint in two demonstrations, radians.
const SAME_AXIS_RAD: f64 = 0.2;

/// A demonstration as an object of the store.
///
/// # Errors
/// Whatever the vision library says.
pub fn to_stored(
    demonstration: &Demonstration,
    provenance: Provenance,
    config: &SkillConfig,
) -> opencv::Result<StoredObject> {
    Ok(StoredObject {
        model: demonstration.model.clone(),
        appearance: build(demonstration, &config.appearance)?,
        provenance: vec![provenance],
    })
}

/// Registers a newer demonstration into the first object frame: the ranges of joints that
/// both saw are united, joints that are new are added with their parts.
///
/// # Errors
/// [`CombineError::NotRecognised`] when the known object is not in the demonstration's first
/// keyframe.
pub fn combine(
    known: &StoredObject,
    newer: &Demonstration,
    provenance: Provenance,
    config: &SkillConfig,
) -> Result<StoredObject, CombineError> {
    let unrecognised = || CombineError::NotRecognised { object: known.model.object.clone() };
    let (_, first) = newer.keyframes.iter().next().ok_or_else(unrecognised)?;
    let object = KnownObject::new(known.model.clone(), &known.appearance);
    let found = find(&Scene::new(first)?, &object, &config.recognise, config.seed)
        .filter(|f| f.score >= config.recognise.min_score)
        .ok_or_else(unrecognised)?;
    let camera_from_object = pose_from_array(&found.camera_from_object).ok_or_else(unrecognised)?;
    // The newer demonstration's frame is its first camera's.
    let object_from_newer = camera_from_object.inverse();
    let mut stored = known.clone();
    stored.model.demonstrations += 1;
    stored.provenance.push(provenance);
    for joint in &newer.model.joints {
        let line = joint.geometry().transformed(&object_from_newer);
        let twin = stored.model.joints.iter().position(|j| {
            j.kind == joint.kind && line_angle(&Vector3::from(j.axis), &line.axis) < SAME_AXIS_RAD
        });
        match twin {
            Some(i) => {
                let own = &mut stored.model.joints[i];
                let sign = Vector3::from(own.axis).dot(&line.axis).signum();
                let start = found.joints[i].configuration.unwrap_or(0.0);
                let ends = joint.range.map(|q| start + sign * q);
                own.range[0] = own.range[0].min(ends[0].min(ends[1]));
                own.range[1] = own.range[1].max(ends[0].max(ends[1]));
                own.observations += joint.observations;
            }
            None => add_joint(&mut stored, newer, joint, &object_from_newer, config)?,
        }
    }
    Ok(stored)
}

/// A joint that the earlier demonstrations did not move, with its part's appearance.
fn add_joint(
    stored: &mut StoredObject,
    newer: &Demonstration,
    joint: &crate::model::Joint,
    object_from_newer: &Pose,
    config: &SkillConfig,
) -> opencv::Result<()> {
    let appearance = build(newer, &config.appearance)?;
    let model: &mut ObjectModel = &mut stored.model;
    let id = model.parts.len();
    let line = joint.geometry().transformed(object_from_newer);
    let mut added = joint.clone();
    added.name = format!("joint{}", model.joints.len() + 1);
    added.parent = 0;
    added.child = id;
    added.axis = line.axis.into_inner().into();
    added.origin = line.origin.into();
    model.joints.push(added);
    let mut part = newer.model.parts[joint.child].clone();
    part.id = id;
    part.name = format!("part{id}");
    model.parts.push(part);
    stored.appearance =
        with_part(&stored.appearance, &appearance, joint.child, id, object_from_newer);
    Ok(())
}

fn with_part(
    known: &Appearance,
    newer: &Appearance,
    part: usize,
    id: usize,
    object_from_newer: &Pose,
) -> Appearance {
    let place = |p: [f32; 3]| -> [f32; 3] {
        let moved = object_from_newer * nalgebra::Point3::from(Vector3::from(p).map(f64::from));
        moved.coords.map(|x| x as f32).into()
    };
    let turn = |n: [f32; 3]| -> [f32; 3] {
        (object_from_newer * Vector3::from(n).map(f64::from)).map(|x| x as f32).into()
    };
    let mut result = known.clone();
    for f in newer.features.iter().filter(|f| usize::from(f.part) == part) {
        let mut f = f.clone();
        (f.part, f.point, f.normal) = (id as u16, place(f.point), turn(f.normal));
        result.features.push(f);
    }
    for s in newer.surfels.iter().filter(|s| usize::from(s.part) == part) {
        let mut s = *s;
        (s.part, s.point, s.normal) = (id as u16, place(s.point), turn(s.normal));
        result.surfels.push(s);
    }
    result
}
