//! How far learned motion is from true motion over time: poses of parts, configurations of
//! joints, features on the right part.

use super::score::{LearnScore, mean_difference};
use crate::truth::{TruePart, Truth};
use linkage_driver::image_file;
use linkage_skill::internals::Trajectory;
use linkage_skill::learn::Demonstration;
use linkage_skill::object::JointKind;
use linkage_skill::{Pose, pose_from_array};
use nalgebra::Point3;
use serde::Serialize;
use std::path::Path;

/// A part's poses against the truth, as the paper compares them (section IV): frames in which
/// both are known, aligned at the first.
#[derive(Debug, Clone, Serialize)]
pub struct PoseScore {
    /// The true part.
    pub part: String,
    /// Mean distance of its centre, centimetres.
    pub position_cm: f64,
    /// Mean angle, degrees.
    pub orientation_deg: f64,
    /// Share of frames in which its pose is known.
    pub known_share: f64,
}

/// Poses of the parts that found joints move.
pub fn pose_scores(
    demonstration: &Demonstration,
    truth: &Truth,
    score: &LearnScore,
) -> Vec<PoseScore> {
    let truths = truth.moved();
    score
        .joints
        .iter()
        .zip(truths)
        .filter_map(|(joint, true_joint)| {
            let part = truth.part(&true_joint.child)?;
            let child = demonstration.model.joints[joint.found?].child;
            let found = &demonstration.camera_from_part[child];
            pose_score(found, part, &demonstration.frame_utimes, truth)
        })
        .collect()
}

fn pose_score(
    found: &Trajectory,
    part: &TruePart,
    utimes: &[i64],
    truth: &Truth,
) -> Option<PoseScore> {
    let both: Vec<(Pose, Pose)> = found
        .iter()
        .zip(utimes)
        .filter_map(|(pose, &utime)| {
            let true_pose = part.camera_from_part.get(truth.frame_at(utime)?)?;
            Some(((*pose)?, pose_from_array(true_pose)?))
        })
        .collect();
    let (found_first, true_first) = *both.first()?;
    let centre = true_first * Point3::from(part.centroid);
    let (mut position, mut angle) = (0.0, 0.0);
    for (found, truly) in &both {
        let moved = found * found_first.inverse();
        let truly_moved = truly * true_first.inverse();
        position += (moved * centre - truly_moved * centre).norm();
        angle += (moved.rotation.inverse() * truly_moved.rotation).angle();
    }
    let n = both.len() as f64;
    Some(PoseScore {
        part: part.name.clone(),
        position_cm: 100.0 * position / n,
        orientation_deg: (angle / n).to_degrees(),
        known_share: n / utimes.len() as f64,
    })
}

/// Mean error of a configuration over the frames in which it is known: degrees or centimetres.
#[derive(Debug, Clone, Serialize)]
pub struct ConfigurationError {
    /// The true joint.
    pub joint: String,
    /// Mean absolute error.
    pub mean: f64,
    /// Its unit.
    pub unit: &'static str,
}

/// Configurations against the truth, aligned at the first frame, signs following the axes.
pub fn configuration_errors(
    demonstration: &Demonstration,
    truth: &Truth,
    score: &LearnScore,
) -> Vec<ConfigurationError> {
    score
        .joints
        .iter()
        .zip(truth.moved())
        .filter_map(|(joint, true_joint)| {
            let found = &demonstration.model.joints[joint.found?];
            let mean = mean_difference(found, true_joint, truth)?;
            let slide = true_joint.kind == JointKind::Prismatic;
            Some(ConfigurationError {
                joint: joint.name.clone(),
                mean: mean * if slide { 100.0 } else { 1.0_f64.to_degrees() },
                unit: if slide { "cm" } else { "deg" },
            })
        })
        .collect()
}

/// Share of the features given to found parts that lie on the true part, by the label
/// pictures; `None` without any.
pub fn segmentation_share(
    demonstration: &Demonstration,
    truth: &Truth,
    score: &LearnScore,
    recording: &Path,
) -> anyhow::Result<Option<f64>> {
    let label_of: Vec<(usize, u8)> = score
        .joints
        .iter()
        .zip(truth.moved())
        .filter_map(|(joint, true_joint)| {
            let child = demonstration.model.joints[joint.found?].child;
            Some((child, truth.part(&true_joint.child)?.label))
        })
        .collect();
    let (mut right, mut all) = (0, 0);
    for (frame, &utime) in demonstration.frame_utimes.iter().enumerate() {
        let path = recording.join(format!("labels/{:.6}.png", utime as f64 * 1e-6));
        if !path.is_file() {
            continue;
        }
        let (width, height, labels) = image_file::read_labels(&path)?;
        for (track, part) in demonstration.tracks.tracks.iter().zip(&demonstration.track_parts) {
            let Some(part) = part.filter(|p| *p > 0) else { continue };
            let Some(seen) = track.at(frame) else { continue };
            let (u, v) = (seen.pixel.x.round() as usize, seen.pixel.y.round() as usize);
            if u >= width || v >= height {
                continue;
            }
            all += 1;
            let label = labels[v * width + u];
            right += usize::from(label_of.contains(&(part, label)));
        }
    }
    Ok((all > 0).then(|| right as f64 / all as f64))
}
