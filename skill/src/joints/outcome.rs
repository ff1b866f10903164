//! From grown joints to learned ones: numbered parents first, carried into the object frame, the
//! first frame at configuration 0.

use super::adjust;
use super::grown::Grown;
use super::view::View;
use crate::articulate::JointKind;
use crate::base::BaseMotion;
use crate::config::SkillConfig;
use crate::geometry::Pose;
use crate::model::{Joint, covariance_rows};
use crate::structure::{LearnedJoint, orient, range_of};
use crate::track::{TrackSet, Trajectory};

/// Part motions in the base since the first frame, by joint and frame.
pub fn base_from_part(joints: &[Grown], index: usize, frame: usize) -> Pose {
    let joint = &joints[index];
    let own = joint.dof.geometry().motion(joint.filled[frame]);
    match joint.parent {
        None => own,
        Some(p) => base_from_part(joints, p, frame) * own,
    }
}

/// The learned joints, parents before children.
pub fn to_learned(
    set: &TrackSet,
    base: &BaseMotion,
    view: &View,
    joints: &[Grown],
    config: &SkillConfig,
) -> Vec<LearnedJoint> {
    let order = parents_first(joints);
    let number_of = |joint: usize| order.iter().position(|&j| j == joint).map_or(0, |n| n + 1);
    order
        .iter()
        .enumerate()
        .map(|(n, &i)| {
            let joint = &joints[i];
            let frames = joint.known_frames();
            // The object frame is the base at the first frame; a moving parent's line is
            // carried to where the parent is then.
            let base_from_parent =
                joint.parent.map_or_else(Pose::identity, |p| base_from_part(joints, p, 0));
            let mut geometry = joint.dof.geometry().transformed(&base_from_parent);
            let first = joint.filled[0];
            let mut configuration: Vec<f64> = frames.iter().map(|&f| joint.q[f] - first).collect();
            configuration.insert(0, 0.0);
            orient(&mut geometry, &mut configuration);
            configuration.remove(0);
            let rest = base_from_part(joints, i, 0).inverse();
            let mut trajectory: Trajectory = vec![None; base.camera_from_base.len()];
            for &f in &frames {
                trajectory[f] = Some(base_from_part(joints, i, f) * rest);
            }
            let some: Vec<usize> = joint.members.iter().copied().take(300).collect();
            let parent_view = joint.parent.map(|p| view_of(view, joints, p));
            let own_view = parent_view.as_ref().unwrap_or(view);
            let covariance = adjust::covariance(joint, own_view, &some, config.joints.cut);
            let mut line = geometry;
            if joint.dof.hinge || joint.members.is_empty() {
                line.origin = geometry.origin;
            } else {
                let mean = joint
                    .members
                    .iter()
                    .map(|&t| joint.points[t].coords)
                    .sum::<nalgebra::Vector3<f64>>()
                    / joint.members.len() as f64;
                line.origin = base_from_parent * nalgebra::Point3::from(mean);
            }
            LearnedJoint {
                joint: Joint {
                    name: format!("joint{}", n + 1),
                    parent: joint.parent.map_or(0, number_of),
                    child: n + 1,
                    kind: if joint.dof.hinge { JointKind::Revolute } else { JointKind::Prismatic },
                    axis: line.axis.into_inner().into(),
                    origin: line.origin.into(),
                    pitch: 0.0,
                    range: range_of(&configuration),
                    covariance: covariance_rows(&covariance),
                    observations: frames.len(),
                    bic: -2.0 * joint.gain,
                    log_likelihood: joint.gain,
                    position_rmse: position_rmse(joint, own_view),
                    orientation_rmse: 0.0,
                    configuration: set.timed(&frames, &configuration),
                    type_probabilities: Vec::new(),
                },
                base_from_part: trajectory,
                tracks: joint.members.iter().map(|&t| view.track_ids[t]).collect(),
            }
        })
        .collect()
}

fn view_of(view: &View, joints: &[Grown], part: usize) -> View {
    match joints[part].parent {
        None => view.seen_from(&joints[part]),
        Some(p) => view_of(view, joints, p).seen_from(&joints[part]),
    }
}

fn position_rmse(joint: &Grown, view: &View) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for &t in &joint.members {
        for (f, s) in view.life(t).filter(|(f, _)| joint.known[*f]) {
            let moved = joint.dof.move_point(joint.q[f], &joint.points[t]);
            if s.distance_sq(&moved) < 16.0 {
                sum += (moved - s.point).norm_squared();
                count += 1;
            }
        }
    }
    (sum / f64::from(count.max(1))).sqrt()
}

fn parents_first(joints: &[Grown]) -> Vec<usize> {
    let depth = |mut i: usize| {
        let mut depth = 0;
        while let Some(p) = joints[i].parent {
            depth += 1;
            i = p;
        }
        depth
    };
    let mut order: Vec<usize> = (0..joints.len()).collect();
    order.sort_by_key(|&i| depth(i));
    order
}
