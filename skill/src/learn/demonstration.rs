//! All that was learned from one demonstration, put together from the joints that a method found.

use super::ego_motion::EgoMotion;
use super::grasp_point::GraspEstimator;
use super::keyframes::Keyframes;
use super::learned_joint::LearnedJoint;
use super::stage_times::StageTimes;
use super::tracking::{TrackSet, Trajectory};
use crate::config::SkillConfig;
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointKind;
use crate::object::model::{MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use nalgebra::Point3;
use rayon::prelude::*;

/// All that was learned from one demonstration.
pub struct Demonstration {
    /// Parts and joints.
    pub model: ObjectModel,
    /// `camera_from_part`, a trajectory a part; part axes are the object frame's at the
    /// reference frame, so that the base's is `camera_from_object`.
    pub camera_from_part: Vec<Trajectory>,
    /// Time of each frame, microseconds.
    pub frame_utimes: Vec<i64>,
    /// Tracks, for pictures.
    pub tracks: TrackSet,
    /// The part of each track; `None`: not known.
    pub track_parts: Vec<Option<usize>>,
    /// By part: places on a plain one, which no track tells of, in its coordinates.
    pub plain_surface: Vec<Vec<Point3<f64>>>,
    /// Frames kept for appearance.
    pub keyframes: Keyframes,
    /// Where the time went.
    pub times: StageTimes,
}

pub(super) fn assemble(
    object: &str,
    config: &SkillConfig,
    set: TrackSet,
    base: &EgoMotion,
    joints: Vec<LearnedJoint>,
    keyframes: Keyframes,
    mut times: StageTimes,
) -> Demonstration {
    let mut track_parts: Vec<Option<usize>> =
        base.tracks.iter().map(|t| (!t.moves).then_some(0)).collect();
    let mut parts = vec![Part::new(0, "base", base.static_count)];
    let mut camera_from_part: Vec<Trajectory> =
        vec![base.camera_from_base.iter().copied().map(Some).collect()];
    for learned in &joints {
        let id = parts.len();
        parts.push(Part::new(id, format!("part{id}"), learned.tracks.len()));
        for &track in &learned.tracks {
            track_parts[track] = Some(id);
        }
        let poses = learned
            .base_from_part
            .iter()
            .zip(&base.camera_from_base)
            .map(|(part, camera)| part.map(|p: Pose| camera * p))
            .collect();
        camera_from_part.push(poses);
    }
    times.measure("grasp", || {
        let grasp = |learned: &LearnedJoint| {
            let (parent, child) = (learned.joint.parent, learned.joint.child);
            let held = GraspEstimator {
                camera_from_part: &camera_from_part[child],
                camera_from_parent: &camera_from_part[parent],
                surface: surface_of(&set, learned, &camera_from_part[child]),
            };
            (child, held.grasp(&keyframes))
        };
        let grasps: Vec<_> = joints.par_iter().map(grasp).collect();
        for (child, held) in grasps {
            parts[child].grasp = held.map(Into::into);
        }
    });
    let surfaces = joints.iter().map(|learned| learned.plain_surface.clone());
    let plain_surface = std::iter::once(Vec::new()).chain(surfaces).collect();
    let model = ObjectModel {
        schema: MODEL_SCHEMA.to_owned(),
        object: object.to_owned(),
        reference_frame: ReferenceFrame::at_camera(set.frame_utimes[0] as f64 * 1e-6),
        parts,
        joints: joints.into_iter().map(|j| j.joint).collect(),
        demonstrations: 1,
        profile: config.profile.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    };
    debug_assert!(model.joints.iter().all(|j| j.kind != JointKind::Fixed));
    Demonstration {
        model,
        camera_from_part,
        frame_utimes: set.frame_utimes.clone(),
        tracks: set,
        track_parts,
        plain_surface,
        keyframes,
        times,
    }
}

/// Places of tracks on their part, in its coordinates: where each was first seen while the part's
/// pose is known. Of a plain part, places on its plane.
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
