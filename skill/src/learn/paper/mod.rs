//! The paper's method: from tracks to a kinematic tree, with tests that decide which of the moving
//! things is a part of an object; an arm is none.
//!
//! In: a [`Recording`]: tracks in the camera frame and in the base frame, and keyframes with depth.
//! Out: the joints in the object frame, which is the base frame at the first frame, and the
//! rejected candidates; metres, radians.
//! From: paper, sections III-B to III-D. The tests are ours.

mod candidate;
mod merge;
mod part_evidence;
mod part_motions;
pub(crate) mod pose_optimisation;
mod rejection;
pub(crate) mod segmentation;
mod tree;

use super::learned_joint::{LearnedJoints, RejectedCandidate};
use super::recording::Recording;
use super::stage_times::StageTimes;
use candidate::{Candidate, fit_to_base};
use merge::{merge_rigid, merge_segments};
use part_motions::motions_of;
use pose_optimisation::PartMotion;
use rayon::prelude::*;
use rejection::rejection_reason;
use segmentation::segment;
use tree::build_tree;

/// Clusters the tracks (III-B), estimates the poses of each cluster (III-C), and builds the
/// kinematic tree of the joints between them (III-D). Moving things that are no part of an object
/// are returned as rejected candidates.
pub fn learn(recording: &Recording, seed: u64, times: &mut StageTimes) -> LearnedJoints {
    let Recording { tracks, ego_motion, .. } = recording;
    let clusters = times.measure("segment", || segment(tracks, ego_motion));
    let motions: Vec<PartMotion> = times.measure("pose", || {
        clusters.par_iter().flat_map_iter(|c| motions_of(recording, c, seed)).collect()
    });
    times.measure("articulate", || {
        let (parts, rejections) = accepted(recording, motions, seed);
        LearnedJoints {
            joints: build_tree(recording, parts),
            rejections,
            ..LearnedJoints::default()
        }
    })
}

/// The moving things that are parts of an object, and the rejected candidates.
fn accepted(
    recording: &Recording,
    motions: Vec<PartMotion>,
    seed: u64,
) -> (Vec<Candidate>, Vec<RejectedCandidate>) {
    let mut fitted: Vec<Candidate> = motions.into_iter().filter_map(fit_to_base).collect();
    merge_rigid(&recording.ego_motion, &mut fitted, seed);
    merge_segments(&mut fitted);
    fitted.sort_by_key(|c| std::cmp::Reverse(c.motion.tracks.len()));
    let (mut accepted, mut rejections) = (Vec::new(), Vec::new());
    for candidate in fitted {
        let reason = rejection_reason(recording, &candidate, &accepted);
        tracing::debug!(
            tracks = candidate.motion.tracks.len(),
            kind = candidate.fit.geometry.kind.name(),
            frames = candidate.frames.len(),
            rmse_m = candidate.fit.position_rmse,
            outliers = candidate.fit.outlier_ratio,
            rejected = reason.as_deref().unwrap_or("no"),
            "part"
        );
        match reason {
            Some(reason) => rejections.push(candidate.rejected(reason)),
            None => accepted.push(candidate),
        }
    }
    (accepted, rejections)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::{
        FRAMES, ON_FRONT, drawer_recording, front, front_paths, recording_of,
    };
    use crate::learn::keyframes::Keyframes;
    use crate::object::joint_geometry::JointKind;
    use nalgebra::{Point3, Vector3};

    fn learned(recording: &Recording) -> LearnedJoints {
        learn(recording, 1, &mut StageTimes::default())
    }

    /// The tracks of the front and more, without pictures.
    fn with_paths(more: Vec<Vec<Point3<f64>>>) -> Recording {
        let paths = [front_paths(), more].concat();
        Recording { keyframes: Keyframes::new(2), ..recording_of(paths, front) }
    }

    /// Paths of twenty places that are moved by `way` in each frame.
    fn paths(way: impl Fn(usize) -> Vector3<f64>) -> Vec<Vec<Point3<f64>>> {
        let path = |i: usize| {
            let at = Point3::new(0.5 + 0.04 * (i % 5) as f64, 0.04 * (i / 5) as f64, 1.5);
            (0..FRAMES).map(|f| at + way(f)).collect()
        };
        (0..20).map(path).collect()
    }

    #[test]
    fn a_drawer_that_is_pulled_is_one_slide_on_the_base() {
        let found = learned(&drawer_recording(front));
        let [drawer] = &found.joints[..] else { panic!("{} joints", found.joints.len()) };
        let joint = &drawer.joint;
        assert_eq!((joint.kind, joint.parent, joint.child), (JointKind::Prismatic, 0, 1));
        assert!(joint.axis[2].abs() > 0.999, "{:?}", joint.axis);
        assert!((joint.range[1] - joint.range[0] - 0.3).abs() < 0.01, "{:?}", joint.range);
        assert!(drawer.tracks.len() > ON_FRONT / 2);
        assert!(found.rejections.is_empty());
    }

    #[test]
    fn what_the_pictures_see_through_is_no_part_and_the_reason_is_told() {
        // The board stays where it is; its tracks come nearer.
        let found = learned(&drawer_recording(|_| 1.5));
        assert!(found.joints.is_empty());
        let [refused] = &found.rejections[..] else { panic!("{:?}", found.rejections) };
        assert!(refused.reason.ends_with("seen through"), "{refused}");
    }

    #[test]
    fn two_drawers_that_are_opened_one_after_the_other_are_two_joints() {
        let other = paths(|f| Vector3::y() * -0.025 * (f.clamp(46, 58) - 46) as f64);
        let found = learned(&with_paths(other));
        let kinds: Vec<JointKind> = found.joints.iter().map(|j| j.joint.kind).collect();
        assert_eq!(kinds, [JointKind::Prismatic; 2], "{:?}", found.rejections);
    }

    #[test]
    fn what_always_moves_is_refused_and_the_reason_is_told() {
        let hand = paths(|f| Vector3::y() * (0.01 * f as f64));
        let found = learned(&with_paths(hand));
        assert_eq!(found.joints.len(), 1, "the drawer");
        let [refused] = &found.rejections[..] else { panic!("{:?}", found.rejections) };
        assert!(refused.reason.contains("ever rests"), "{refused}");
        assert!(refused.tracks > 10 && refused.frames > 30, "{refused}");
    }

    #[test]
    fn where_nothing_moves_nothing_is_learned_and_nothing_refused() {
        let still = recording_of(paths(|_| Vector3::zeros()), |_| 1.5);
        let found = learned(&still);
        assert!(found.joints.is_empty() && found.rejections.is_empty());
        let empty = learned(&recording_of(Vec::new(), |_| 1.5));
        assert!(empty.joints.is_empty() && empty.rejections.is_empty());
    }
}
