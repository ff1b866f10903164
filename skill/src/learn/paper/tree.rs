//! The kinematic tree (paper, section III-D): which part hangs on which, by least BIC.

use super::candidate::{Candidate, relative_samples};
use super::pose_optimisation::PartMotion;
use crate::articulation::{FittedJoint, Link, fit_models, spanning_tree};
use crate::config::SkillConfig;
use crate::learn::ego_motion::EgoMotion;
use crate::learn::learned_joint::{LearnedJoint, orient, range_of};
use crate::learn::tracking::{TrackSet, Trajectory};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::{Joint, covariance_rows};
/// The minimum spanning tree over base and parts (paper, Eq. 7).
pub(super) fn build_tree(
    set: &TrackSet,
    base: &EgoMotion,
    parts: Vec<Candidate>,
    config: &SkillConfig,
) -> Vec<LearnedJoint> {
    let mut links = Vec::new();
    let mut fits: Vec<(FittedJoint, Vec<usize>)> = Vec::new();
    for (i, part) in parts.iter().enumerate() {
        links.push(Link { a: 0, b: i + 1, cost: per_frame(&part.fit, part.frames.len()) });
        fits.push((part.fit.clone(), part.frames.clone()));
    }
    for i in 0..parts.len() {
        for j in i + 1..parts.len() {
            let Some((frames, samples)) = relative_samples(&parts[i].motion, &parts[j].motion)
            else {
                continue;
            };
            // A link that was seen for a small part of the time explains little.
            if 2 * frames.len() < parts[i].frames.len().max(parts[j].frames.len()) {
                continue;
            }
            let Some(fit) = fit_models(&samples, &config.articulate)
                .ok()
                .and_then(|f| f.into_iter().find(|f| f.geometry.kind != JointKind::Fixed))
            else {
                continue;
            };
            // The base explains as well as a moving part: prefer it (two sliders beside one
            // another are joined by one degree of freedom, too).
            let cost = per_frame(&fit, frames.len()) + PREFER_BASE;
            links.push(Link { a: i + 1, b: j + 1, cost });
            fits.push((fit, frames));
        }
    }
    let mut learned: Vec<LearnedJoint> = Vec::new();
    let mut number_of_part = vec![0; parts.len() + 1];
    for (parent, child, link) in spanning_tree(parts.len() + 1, &links) {
        let (fit, frames) = &fits[link];
        let number = learned.len() + 1;
        number_of_part[child] = number;
        // Links between parts were fitted as a -> b with a < b.
        let reversed = links[link].a != parent;
        if reversed && parent != 0 {
            continue;
        }
        let in_parent = fit.geometry;
        let parent_motion = (parent > 0).then(|| &parts[parent - 1].motion);
        learned.push(to_learned(
            set,
            number,
            number_of_part[parent],
            in_parent,
            fit,
            frames,
            &parts[child - 1],
            parent_motion,
            base.camera_from_base.len(),
        ));
    }
    learned
}

/// BIC a frame by which a moving parent must be better than the base.
const PREFER_BASE: f64 = 2.0;

fn per_frame(fit: &FittedJoint, frames: usize) -> f64 {
    fit.bic / frames.max(1) as f64
}

#[allow(clippy::too_many_arguments)]
fn to_learned(
    set: &TrackSet,
    number: usize,
    parent: usize,
    in_parent: JointGeometry,
    fit: &FittedJoint,
    frames: &[usize],
    part: &Candidate,
    parent_motion: Option<&PartMotion>,
    frame_count: usize,
) -> LearnedJoint {
    // Object frame: the base at the first frame. A moving parent's line is carried there by
    // the parent's pose in the first frame that it was seen in.
    let base_from_parent = parent_motion
        .and_then(|m| m.base_from_part.iter().flatten().next().copied())
        .unwrap_or_default();
    let mut geometry = in_parent.transformed(&base_from_parent);
    let mut configuration: Vec<f64> = fit.configuration.clone();
    orient(&mut geometry, &mut configuration);
    let mut base_from_part: Trajectory = vec![None; frame_count];
    let rest = part.motion.base_from_part[part.frames[0]].unwrap_or_default();
    for (&frame, pose) in
        part.frames.iter().zip(part.frames.iter().map(|f| part.motion.base_from_part[*f]))
    {
        base_from_part[frame] = pose.map(|p| p * rest.inverse());
    }
    LearnedJoint {
        joint: Joint {
            name: format!("joint{number}"),
            parent,
            child: number,
            range: range_of(&configuration),
            covariance: covariance_rows(&fit.covariance),
            observations: frames.len(),
            bic: fit.bic,
            log_likelihood: fit.log_likelihood,
            position_rmse: fit.position_rmse,
            orientation_rmse: fit.orientation_rmse,
            configuration: set.timed(frames, &configuration),
            ..Joint::of(&geometry)
        },
        base_from_part,
        tracks: part.motion.tracks.clone(),
        plain_surface: Vec::new(),
    }
}
