//! Truth as the paper had it: poses of the parts' AprilTags, joints fitted to them.

use super::truth::{TrueJoint, Truth};
use crate::commands::{Outcome, demonstrate_past};
use crate::tags::TagLog;
use linkage_skill::articulate::{ArticulateConfig, PoseSample, fit_models};
use linkage_skill::geometry::{Pose, pose_to_array};
use linkage_skill::{Demonstration, SkillConfig};
use nalgebra::Point3;
use std::path::Path;

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

/// Learns from a recording with truth beside it; by tags, none of their pixels is learned from.
pub fn watch(recording: &Path, by_tags: bool, config: &SkillConfig) -> Outcome<Watched> {
    let exact = Truth::read(recording)?;
    let source = recording.display().to_string();
    let mut log = if by_tags { Some(TagLog::of(recording)?) } else { None };
    let mut frames = linkage_driver::open(&source)?;
    let found = demonstrate_past(log.as_mut(), &mut *frames, &exact.object, config, true)?;
    Ok(match log {
        None => Watched { found, truth: exact, joints_by_tags: None },
        Some(log) => {
            let (truth, told) = truth_by_tags(&exact, &log, &config.articulate);
            Watched { found, truth, joints_by_tags: Some(told) }
        }
    })
}

/// Truth by tags; joints whose parts' tags tell nothing keep the exact one. Also how many
/// joints the tags told. Kinds and names are the experimenter's knowledge.
fn truth_by_tags(exact: &Truth, log: &TagLog, config: &ArticulateConfig) -> (Truth, usize) {
    let mut truth = exact.clone();
    let poses: Vec<Vec<Option<Pose>>> =
        exact.parts.iter().map(|part| by_frame(exact, &log.part_poses(&part.name))).collect();
    let of = |name: &str| exact.parts.iter().position(|p| p.name == name).map(|i| &poses[i]);
    let mut told = 0;
    for joint in truth.joints.iter_mut().filter(|j| j.moved) {
        let (Some(child), Some(parent)) = (of(&joint.child), of(&joint.parent)) else { continue };
        if let Some(fitted) = joint_by_tags(joint, parent, child, config) {
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
/// parent without a tag is taken to rest before the camera.
fn joint_by_tags(
    joint: &TrueJoint,
    parent: &[Option<Pose>],
    child: &[Option<Pose>],
    config: &ArticulateConfig,
) -> Option<TrueJoint> {
    let parent_tagged = parent.iter().flatten().count() > 0;
    let camera_from_parent = |f: usize| {
        if parent_tagged { parent[f] } else { Some(Pose::identity()) }
    };
    let frames: Vec<usize> = (0..child.len())
        .filter(|&f| child[f].is_some() && camera_from_parent(f).is_some())
        .collect();
    let samples: Vec<PoseSample> = frames
        .iter()
        .filter_map(|&f| {
            let parent_from_child = camera_from_parent(f)?.inverse() * child[f]?;
            Some(PoseSample::from_pose(f as f64, &parent_from_child))
        })
        .collect();
    let fits = fit_models(&samples, config).ok()?;
    let fit = fits.into_iter().find(|f| f.geometry.kind == joint.kind)?;
    let first = *frames.first()?;
    let line = fit.geometry.transformed(&camera_from_parent(first)?);
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
