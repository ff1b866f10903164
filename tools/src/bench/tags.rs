//! Truth as the paper had it: poses of the parts' AprilTags, joints fitted to them.

use crate::outcome::Outcome;
use crate::steps::demonstrate_past;
use crate::tags::TagLog;
use crate::truth::{PoseArray, TrueJoint, Truth};
use linkage_skill::articulation::{PoseSample, fit_models};
use linkage_skill::internals::rotation_nearest;
use linkage_skill::{Demonstration, Pose, SkillConfig, pose_from_array, pose_to_array};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// A part stands where it stood when its tag is within this distance, metres.
const NEAR_M: f64 = 0.03;
/// A part stands as it stood when its tag is within this turn, radians.
const NEAR_RAD: f64 = 0.06;
/// A part rests that stands where it stood in this share of the frames.
const RESTING_SHARE: f64 = 0.95;
/// Marks a frame in which a tag was not seen.
const UNSEEN: [f64; 7] = [f64::NAN; 7];

/// A demonstration learned from, with its truth: exact, or by tags and for how many joints.
pub struct Watched {
    /// What was learned.
    pub found: Demonstration,
    /// What is true.
    pub truth: Truth,
    /// Joints whose truth is by tags, where these are asked for; the rest is exact.
    pub joints_by_tags: Option<usize>,
}

/// The log of a recording's tags, where truth is asked of them.
pub fn log_of(recording: &Path, by_tags: bool) -> Outcome<Option<TagLog>> {
    Ok(by_tags.then(|| TagLog::of(recording)).transpose()?)
}

/// Learns from a recording with truth beside it; with tags, truth is theirs and none of their
/// pixels is learned from.
pub fn watch(
    recording: &Path,
    mut tags: Option<&mut TagLog>,
    config: &SkillConfig,
) -> Outcome<Watched> {
    let exact = Truth::read(recording)?;
    let source = recording.display().to_string();
    let mut frames = linkage_driver::open(&source)?;
    let found = demonstrate_past(tags.as_deref_mut(), &mut *frames, &exact.object, config, true)?;
    Ok(match tags {
        None => Watched { found, truth: exact, joints_by_tags: None },
        Some(tags) => {
            let (truth, told) = truth_by_tags(&exact, tags);
            Watched { found, truth, joints_by_tags: Some(told) }
        }
    })
}

/// Truth by tags; joints whose parts' tags tell nothing keep the exact one. Also how many
/// joints the tags told. Kinds and names are the experimenter's knowledge.
fn truth_by_tags(exact: &Truth, log: &TagLog) -> (Truth, usize) {
    let mut truth = exact.clone();
    let poses: Vec<Vec<Option<Pose>>> =
        exact.parts.iter().map(|part| by_frame(exact, &log.part_poses(&part.name))).collect();
    let of = |name: &str| exact.parts.iter().position(|p| p.name == name).map(|i| &poses[i]);
    let mut told = 0;
    for joint in truth.joints.iter_mut().filter(|j| j.moved) {
        let (Some(child), Some(parent)) = (of(&joint.child), of(&joint.parent)) else { continue };
        if let Some(fitted) = joint_by_tags(joint, parent, child, exact) {
            *joint = fitted;
            told += 1;
            if let Some(part) = truth.parts.iter_mut().find(|p| p.name == joint.child) {
                part.centroid = [0.0; 3];
                part.camera_from_part =
                    child.iter().map(|p| p.as_ref().map_or(UNSEEN, pose_to_array)).collect();
            }
        }
    }
    (truth, told)
}

fn by_frame(truth: &Truth, poses: &[(i64, Pose)]) -> Vec<Option<Pose>> {
    let mut frames = vec![None; truth.frames.len()];
    for (utime, pose) in poses {
        if let Some(frame) = truth.frame_at(*utime) {
            frames[frame] = Some(*pose);
        }
    }
    frames
}

/// The joint of the known kind that fits the child's tag as seen from the parent's best; a
/// parent whose tag is never seen is taken to rest in the room.
fn joint_by_tags(
    joint: &TrueJoint,
    parent: &[Option<Pose>],
    child: &[Option<Pose>],
    exact: &Truth,
) -> Option<TrueJoint> {
    let child = before_first_camera(child, exact)?;
    let mut parent = before_first_camera(parent, exact)?;
    let (stood, rests) = where_it_stood(&parent).unwrap_or((Pose::identity(), true));
    if rests {
        parent.fill(Some(stood));
    }
    let (frames, samples): (Vec<usize>, Vec<PoseSample>) = (0..child.len())
        .filter_map(|f| {
            let parent_from_child = parent[f]?.inverse() * child[f]?;
            Some((f, PoseSample::from_pose(f as f64, &parent_from_child)))
        })
        .unzip();
    let fits = fit_models(&samples).ok()?;
    let fit = fits.into_iter().find(|f| f.geometry.kind == joint.kind)?;
    let line = fit.geometry.transformed(&stood);
    let mut configuration = vec![f64::NAN; child.len()];
    for (&f, q) in frames.iter().zip(&fit.configuration) {
        configuration[f] = *q;
    }
    let low = fit.configuration.iter().copied().fold(f64::INFINITY, f64::min);
    let high = fit.configuration.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(TrueJoint {
        axis: line.axis.into_inner().into(),
        origin: Point3::into(line.origin),
        configuration,
        range_observed: [low, high],
        ..joint.clone()
    })
}

/// Poses in the camera of the first frame; the camera's own motion is the exact one. `None`
/// where that is not told of.
fn before_first_camera(poses: &[Option<Pose>], exact: &Truth) -> Option<Vec<Option<Pose>>> {
    let camera_from_world = pose_from_array(exact.world_from_camera.first()?)?.inverse();
    let in_first = |(pose, world_from_camera): (&Option<Pose>, &PoseArray)| {
        Some(camera_from_world * pose_from_array(world_from_camera)? * (*pose)?)
    };
    Some(poses.iter().zip(&exact.world_from_camera).map(in_first).collect())
}

/// Mean of the poses near the first one, and whether these are nearly all: one frame's tag is
/// a degree off. `None` when there is no pose.
fn where_it_stood(poses: &[Option<Pose>]) -> Option<(Pose, bool)> {
    let seen: Vec<&Pose> = poses.iter().flatten().collect();
    let first = *seen.first()?;
    let near: Vec<&Pose> = seen.iter().copied().filter(|p| is_near(p, first)).collect();
    let n = near.len() as f64;
    let place = near.iter().map(|p| p.translation.vector).sum::<Vector3<f64>>() / n;
    let turned = near.iter().map(|p| p.rotation.to_rotation_matrix().into_inner()).sum();
    let rests = n >= RESTING_SHARE * seen.len() as f64;
    Some((Pose::from_parts(place.into(), rotation_nearest(&turned)?), rests))
}

fn is_near(a: &Pose, b: &Pose) -> bool {
    (a.translation.vector - b.translation.vector).norm() < NEAR_M
        && a.rotation.angle_to(&b.rotation) < NEAR_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::internals::{distance_to_line, line_angle, rotation_about};
    use linkage_skill::object::JointKind;
    use nalgebra::UnitVector3;

    /// A turn by some degrees about some direction, another one each frame.
    fn jitter(f: usize) -> Pose {
        let direction = Vector3::new((f as f64).sin(), (2.1 * f as f64).cos(), 0.3);
        let turn = 0.02 * (0.7 * f as f64).sin();
        rotation_about(&Point3::origin(), &UnitVector3::new_normalize(direction), turn)
    }

    #[test]
    fn a_hinge_is_told_by_tags_that_jitter_before_a_camera_that_moves() {
        let axis = Vector3::y_axis();
        let origin = Point3::new(0.3, 0.0, 1.5);
        let frames = 60;
        let world_from_camera: Vec<Pose> =
            (0..frames).map(|f| Pose::translation(0.002 * f as f64, 0.0, 0.0)).collect();
        let angle = |f: usize| f as f64 / frames as f64;
        let seen = |f: usize, room: Pose| {
            // Neither tag is seen at first.
            (f >= 5).then(|| world_from_camera[f].inverse() * room)
        };
        let parent: Vec<Option<Pose>> =
            (0..frames).map(|f| seen(f, Pose::translation(0.5, 0.1, 1.6) * jitter(f))).collect();
        let child: Vec<Option<Pose>> = (0..frames)
            .map(|f| {
                let turned = rotation_about(&origin, &axis, angle(f));
                seen(f, turned * Pose::translation(0.0, 0.1, 1.4) * jitter(f + 7))
            })
            .collect();
        let exact = Truth {
            world_from_camera: world_from_camera.iter().map(pose_to_array).collect(),
            ..serde_json::from_value(serde_json::json!({
                "object": "", "category": "", "texture": "", "hand": true, "moving_camera": true,
                "encounter": false, "unknown": false, "frames": [], "world_from_camera": [],
                "parts": [], "joints": []
            }))
            .unwrap()
        };
        let asked: TrueJoint = serde_json::from_value(serde_json::json!({
            "name": "hinge", "type": "revolute", "parent": "frame", "child": "leaf",
            "axis": [0, 0, 0], "origin": [0, 0, 0], "axis_last": [0, 0, 0],
            "origin_last": [0, 0, 0], "pitch": 0, "configuration": [], "range_observed": [0, 0]
        }))
        .unwrap();
        let told = joint_by_tags(&asked, &parent, &child, &exact);
        let told = told.unwrap();
        assert_eq!(told.kind, JointKind::Revolute);
        assert!(line_angle(&told.axis.into(), &axis).to_degrees() < 0.5);
        let off = distance_to_line(&told.origin.into(), &told.axis.into(), &origin);
        assert!(off < 0.01, "{off}");
        let span = told.range_observed[1] - told.range_observed[0];
        assert!((span - (angle(59) - angle(5))).abs() < 0.04, "{span}");
    }
}
