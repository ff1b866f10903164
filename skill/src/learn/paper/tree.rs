//! Builds the kinematic tree: which part carries which, by least BIC.
//!
//! In: parts with their poses in the base frame, metres.
//! Out: joints in the object frame, which is the base frame at the first frame; metres, radians.
//! From: paper, section III-D; Sturm et al. 2011.

use super::candidate::{Candidate, relative_samples};
use crate::articulation::{FittedJoint, Link, fit_models, spanning_tree};
use crate::learn::learned_joint::{LearnedJoint, orient, range_of};
use crate::learn::recording::Recording;
use crate::learn::tracking::Trajectory;
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointKind;
use crate::object::model::{Joint, covariance_rows};

/// BIC per frame by which a moving parent must be better than the base. Two sliders side by side
/// also have one degree of freedom between them: where the base explains a part as well as a moving
/// part does, the base is preferred.
const PREFER_BASE: f64 = 2.0;

/// A joint that may be in the tree, fitted to the motion of node `b` in the frame of node `a`. Node
/// 0 is the base, node `i + 1` is part `i`.
struct PossibleJoint {
    link: Link,
    fit: FittedJoint,
    /// Frames of the samples that `fit` was fitted to.
    frames: Vec<usize>,
}

/// The joints of the minimum spanning tree over the base and the parts (paper, section III-D).
pub(super) fn build_tree(recording: &Recording, parts: Vec<Candidate>) -> Vec<LearnedJoint> {
    let possible = possible_joints(&parts);
    let links: Vec<Link> = possible.iter().map(|p| p.link).collect();
    let mut learned: Vec<LearnedJoint> = Vec::new();
    // Of the base and of the parts that have a joint.
    let mut number_of_node: Vec<Option<usize>> = vec![None; parts.len() + 1];
    number_of_node[0] = Some(0);
    for (parent, child, link) in spanning_tree(parts.len() + 1, &links) {
        // What a part that is left out carries is left out with it.
        let Some(number_of_parent) = number_of_node[parent] else { continue };
        // A link between parts was fitted as a -> b with a < b; the other direction is left out.
        let reversed = links[link].a != parent;
        if reversed && parent != 0 {
            continue;
        }
        let parent_part = parent.checked_sub(1).map(|p| &parts[p]);
        match to_learned(recording, &possible[link], &parts[child - 1], parent_part) {
            Some(mut joint) => {
                let number = learned.len() + 1;
                joint.joint.name = format!("joint{number}");
                joint.joint.parent = number_of_parent;
                joint.joint.child = number;
                number_of_node[child] = Some(number);
                learned.push(joint);
            }
            None => tracing::warn!(parent, child, "a joint is left out: its part has no pose"),
        }
    }
    learned
}

/// The possible joints of each part with the base, and those between two parts.
fn possible_joints(parts: &[Candidate]) -> Vec<PossibleJoint> {
    let with_base = |(i, part): (usize, &Candidate)| PossibleJoint {
        link: Link { a: 0, b: i + 1, cost: per_frame(&part.fit, part.frames.len()) },
        fit: part.fit.clone(),
        frames: part.frames.clone(),
    };
    let mut possible: Vec<PossibleJoint> = parts.iter().enumerate().map(with_base).collect();
    for i in 0..parts.len() {
        for j in i + 1..parts.len() {
            if let Some((fit, frames)) = fit_between(&parts[i], &parts[j]) {
                let cost = per_frame(&fit, frames.len()) + PREFER_BASE;
                possible.push(PossibleJoint {
                    link: Link { a: i + 1, b: j + 1, cost },
                    fit,
                    frames,
                });
            }
        }
    }
    possible
}

/// The joint that best explains the motion of `b` in the frame of `a`; `None` if both were seen
/// together in less than half of the frames of the longer one, or if no joint that moves fits.
fn fit_between(a: &Candidate, b: &Candidate) -> Option<(FittedJoint, Vec<usize>)> {
    let (frames, samples) = relative_samples(&a.motion, &b.motion)?;
    if 2 * frames.len() < a.frames.len().max(b.frames.len()) {
        return None;
    }
    let fits = fit_models(&samples).ok()?;
    let fit = fits.into_iter().find(|f| f.geometry.kind != JointKind::Fixed)?;
    Some((fit, frames))
}

fn per_frame(fit: &FittedJoint, frames: usize) -> f64 {
    fit.bic / frames.max(1) as f64
}

/// The joint in the object frame, without its number, and the poses of its part; `None` if the part
/// or its parent has no pose to start from.
fn to_learned(
    recording: &Recording,
    possible: &PossibleJoint,
    part: &Candidate,
    parent: Option<&Candidate>,
) -> Option<LearnedJoint> {
    let PossibleJoint { fit, frames, .. } = possible;
    // The line on a moving parent is carried to the object frame by the parent's pose in the first
    // frame that shows the parent.
    let base_from_parent = match parent {
        Some(parent) => *parent.motion.base_from_part.iter().flatten().next()?,
        None => Pose::identity(),
    };
    let mut geometry = fit.geometry.transformed(&base_from_parent);
    let mut configuration: Vec<f64> = fit.configuration.clone();
    orient(&mut geometry, &mut configuration);
    let poses = &part.motion.base_from_part;
    let part_from_base_at_rest = poses[*part.frames.first()?]?.inverse();
    let mut base_from_part: Trajectory = vec![None; recording.ego_motion.camera_from_base.len()];
    for &frame in &part.frames {
        base_from_part[frame] = poses[frame].map(|p| p * part_from_base_at_rest);
    }
    Some(LearnedJoint {
        joint: Joint {
            range: range_of(&configuration),
            covariance: covariance_rows(&fit.covariance),
            observations: frames.len(),
            bic: fit.bic,
            log_likelihood: fit.log_likelihood,
            position_rmse: fit.position_rmse,
            orientation_rmse: fit.orientation_rmse,
            configuration: recording.tracks.timed(frames, &configuration),
            ..Joint::of(&geometry)
        },
        base_from_part,
        tracks: part.motion.tracks.clone(),
        plain_surface: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::EgoMotion;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::paper::candidate::fit_to_base;
    use crate::learn::paper::pose_optimisation::PartMotion;
    use crate::learn::tracking::TrackSet;

    const FRAMES: usize = 40;

    /// Pose of a drawer that opens by 8 mm a frame.
    fn drawer(f: usize) -> Pose {
        Pose::translation(0.0, 0.0, 1.5 - 0.008 * f as f64)
    }

    fn candidate(pose: impl Fn(usize) -> Pose) -> Candidate {
        let base_from_part = (0..FRAMES).map(|f| Some(pose(f))).collect();
        fit_to_base(PartMotion { base_from_part, tracks: vec![3, 4] }).unwrap()
    }

    /// The joints of a drawer, after something was done to its part.
    fn joints_of_drawer(change: impl Fn(&mut Candidate)) -> Vec<LearnedJoint> {
        let mut drawer = candidate(drawer);
        change(&mut drawer);
        joints_of(vec![drawer])
    }

    fn joints_of(parts: Vec<Candidate>) -> Vec<LearnedJoint> {
        let recording = Recording {
            tracks: TrackSet { frame_utimes: (0..FRAMES as i64).collect(), tracks: Vec::new() },
            ego_motion: EgoMotion {
                camera_from_base: vec![Pose::identity(); FRAMES],
                ..EgoMotion::default()
            },
            keyframes: Keyframes::new(2),
        };
        build_tree(&recording, parts)
    }

    #[test]
    fn a_drawer_slides_on_the_base() {
        let joints = joints_of_drawer(|_| ());
        assert_eq!(joints.len(), 1);
        let LearnedJoint { joint, base_from_part, tracks, .. } = &joints[0];
        assert_eq!((joint.kind, joint.parent, joint.child), (JointKind::Prismatic, 0, 1));
        assert_eq!(tracks, &[3, 4]);
        assert_eq!(base_from_part[0], Some(Pose::identity()), "since the first frame");
        assert!((joint.range[1] - joint.range[0] - 0.312).abs() < 0.005, "{:?}", joint.range);
    }

    #[test]
    fn what_a_part_that_is_left_out_carries_is_left_out_with_it() {
        // A lid on the drawer.
        let turn = |f: usize| Pose::rotation(nalgebra::Vector3::new(0.02 * f as f64, 0.0, 0.0));
        let lid = || candidate(|f| drawer(f) * Pose::translation(0.0, 0.3, 0.0) * turn(f));
        let carried = joints_of(vec![candidate(drawer), lid()]);
        let tree: Vec<_> = carried.iter().map(|l| (l.joint.parent, l.joint.child)).collect();
        assert_eq!(tree, [(0, 1), (1, 2)]);
        let mut lost = candidate(drawer);
        lost.motion.base_from_part[0] = None;
        assert!(joints_of(vec![lost, lid()]).is_empty());
    }

    #[test]
    fn a_part_without_a_pose_to_start_from_is_left_out() {
        assert!(joints_of_drawer(|drawer| drawer.motion.base_from_part[0] = None).is_empty());
    }
}
