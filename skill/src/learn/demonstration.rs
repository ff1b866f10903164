//! Puts together what was learned from one demonstration.
//!
//! In: the recording, and the joints that a method found; base frame, metres, radians.
//! Out: a [`Demonstration`]: the object model with its parts, joints and grasp points, and the pose
//! of each part in each camera frame.

use super::ego_motion::EgoMotion;
use super::grasp_point::GraspEstimator;
use super::keyframes::Keyframes;
use super::learned_joint::{LearnedJoint, LearnedJoints, RejectedCandidate};
use super::recording::Recording;
use super::stage_times::StageTimes;
use super::tracking::{TrackSet, Trajectory};
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointKind;
use crate::object::model::{MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use nalgebra::Point3;
use rayon::prelude::*;

/// All that was learned from one demonstration.
pub struct Demonstration {
    /// Parts and joints of the object.
    pub model: ObjectModel,
    /// `camera_from_part` of each part, with one pose for each frame. All parts have the axes of
    /// the object frame at the reference frame, so that the trajectory of the base is
    /// `camera_from_object`.
    pub camera_from_part: Vec<Trajectory>,
    /// Time of each frame, microseconds.
    pub frame_utimes: Vec<i64>,
    /// Tracks in the camera frame of each frame, metres.
    pub tracks: TrackSet,
    /// Part of each track; `None` where it is not known.
    pub track_parts: Vec<Option<usize>>,
    /// For each part: points of its surface that were found without tracks, in part coordinates,
    /// metres; empty for other parts.
    pub plain_surface: Vec<Vec<Point3<f64>>>,
    /// Frames that were kept whole, for the appearance of the parts.
    pub keyframes: Keyframes,
    /// Moving things that are no part of the object, with the reason; for reports, not in the
    /// model.
    pub rejections: Vec<RejectedCandidate>,
    /// Wall time of each stage.
    pub times: StageTimes,
}

impl Demonstration {
    /// Reason why the demonstration has no joint, as a sentence without its full stop.
    pub fn why_nothing(&self) -> String {
        why_nothing(&self.rejections)
    }
}

/// The reason of the first candidate that may be a part and needs a longer demonstration; else the
/// candidate with the most observations (tracks times frames).
fn why_nothing(rejections: &[RejectedCandidate]) -> String {
    if let Some(unclear) = rejections.iter().find(|r| r.needs_more) {
        return format!("{}; nothing was learned", unclear.reason);
    }
    // Of those without tracks that of most frames, and the first of them.
    let closest = rejections.iter().rev().max_by_key(|r| (r.tracks * r.frames, r.frames));
    let closest = closest.map(|r| format!(" (closest was {r})")).unwrap_or_default();
    format!("nothing articulated moves; nothing was learned{closest}")
}

/// Puts a demonstration together: the base and one part for each joint, with poses and grasp
/// points.
pub(super) fn assemble(
    object: &str,
    profile: String,
    recording: Recording,
    learned: LearnedJoints,
    mut times: StageTimes,
) -> Demonstration {
    let Recording { tracks, ego_motion, keyframes } = recording;
    let LearnedJoints { joints, rejections, .. } = learned;
    let camera_from_part = poses_in_camera(&ego_motion, &joints);
    let mut parts = parts_of(&ego_motion, &joints);
    times.measure("grasp", || {
        let grasp = |learned: &LearnedJoint| {
            let grasp = grasp_of(learned, &tracks, &camera_from_part, &keyframes);
            (learned.joint.child, grasp)
        };
        let grasps: Vec<_> = joints.par_iter().map(grasp).collect();
        for (child, grasp) in grasps {
            parts[child].grasp = grasp.map(Into::into);
        }
    });
    let track_parts = parts_of_tracks(&ego_motion, &joints);
    let surfaces = joints.iter().map(|learned| learned.plain_surface.clone());
    let plain_surface = std::iter::once(Vec::new()).chain(surfaces).collect();
    let model = ObjectModel {
        schema: MODEL_SCHEMA.to_owned(),
        object: object.to_owned(),
        reference_frame: ReferenceFrame::at_camera(tracks.frame_utimes[0] as f64 * 1e-6),
        parts,
        joints: joints.into_iter().map(|j| j.joint).collect(),
        demonstrations: 1,
        profile,
        version: env!("CARGO_PKG_VERSION").to_owned(),
    };
    debug_assert!(model.joints.iter().all(|j| j.kind != JointKind::Fixed));
    Demonstration {
        model,
        camera_from_part,
        frame_utimes: tracks.frame_utimes.clone(),
        tracks,
        track_parts,
        plain_surface,
        keyframes,
        rejections,
        times,
    }
}

/// The base and the part of each joint.
fn parts_of(base: &EgoMotion, joints: &[LearnedJoint]) -> Vec<Part> {
    let of_joint = |(i, learned): (usize, &LearnedJoint)| {
        Part::new(i + 1, format!("part{}", i + 1), learned.tracks.len())
    };
    let base = Part::new(0, "base", base.static_count);
    std::iter::once(base).chain(joints.iter().enumerate().map(of_joint)).collect()
}

/// `camera_from_part` of the base and of the part of each joint.
fn poses_in_camera(base: &EgoMotion, joints: &[LearnedJoint]) -> Vec<Trajectory> {
    let camera_from_base = &base.camera_from_base;
    let of_joint = |learned: &LearnedJoint| {
        let poses = learned.base_from_part.iter().zip(camera_from_base);
        poses.map(|(part, camera)| part.map(|p: Pose| camera * p)).collect()
    };
    let of_base = camera_from_base.iter().copied().map(Some).collect();
    std::iter::once(of_base).chain(joints.iter().map(of_joint)).collect()
}

/// The part of each track: the base for static tracks; `None` where it is not known.
fn parts_of_tracks(base: &EgoMotion, joints: &[LearnedJoint]) -> Vec<Option<usize>> {
    let mut parts: Vec<Option<usize>> =
        base.tracks.iter().map(|t| (!t.moves).then_some(0)).collect();
    for (i, learned) in joints.iter().enumerate() {
        for &track in &learned.tracks {
            parts[track] = Some(i + 1);
        }
    }
    parts
}

/// The point at which the part of a joint was held, in part coordinates, metres; `None` if no hand
/// was found.
fn grasp_of(
    learned: &LearnedJoint,
    tracks: &TrackSet,
    camera_from_part: &[Trajectory],
    keyframes: &Keyframes,
) -> Option<Point3<f64>> {
    let (parent, child) = (learned.joint.parent, learned.joint.child);
    let estimator = GraspEstimator {
        camera_from_part: &camera_from_part[child],
        camera_from_parent: &camera_from_part[parent],
        surface: surface_of(tracks, learned, &camera_from_part[child]),
    };
    estimator.grasp(keyframes)
}

/// Points on the part, in its coordinates: the place of each track where it was first seen while
/// the pose of the part is known, and the points that were found without tracks.
fn surface_of(
    set: &TrackSet,
    learned: &LearnedJoint,
    camera_from_part: &Trajectory,
) -> Vec<Point3<f64>> {
    let place = |&track: &usize| {
        set.tracks[track]
            .lifted()
            .find_map(|(f, p)| Some(camera_from_part[f]?.inverse_transform_point(&p)))
    };
    let tracked = learned.tracks.iter().filter_map(place);
    tracked.chain(learned.plain_surface.iter().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointKind;

    #[test]
    fn where_nothing_is_learned_the_reason_names_what_came_closest() {
        let candidate = |tracks, needs_more| RejectedCandidate {
            kind: JointKind::Revolute,
            tracks,
            frames: 30,
            reason: format!("reason {tracks}"),
            needs_more,
        };
        assert_eq!(why_nothing(&[]), "nothing articulated moves; nothing was learned");
        assert_eq!(
            why_nothing(&[candidate(5, false), candidate(40, false)]),
            "nothing articulated moves; nothing was learned (closest was a revolute candidate \
             (40 tracks, 30 frames): reason 40)"
        );
        let unclear = [candidate(40, false), candidate(5, true)];
        assert_eq!(why_nothing(&unclear), "reason 5; nothing was learned");
    }
}
