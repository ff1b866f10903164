//! A moving part, and the joint that explains its motion relative to the base.

use super::pose_optimisation::PartMotion;
use crate::articulation::{FittedJoint, PoseSample, fit_models};
use crate::learn::learned_joint::{RejectedCandidate, span_of};
use crate::math::robust::Moments;

/// A moving part with its fitted joint, while the tree is built.
#[derive(Clone)]
pub(super) struct Candidate {
    pub motion: PartMotion,
    pub fit: FittedJoint,
    /// Frames of the samples that `fit` was fitted to.
    pub frames: Vec<usize>,
}

impl Candidate {
    /// The rejected candidate for a report, with the reason.
    pub(super) fn rejected(&self, reason: String) -> RejectedCandidate {
        let kind = self.fit.geometry.kind;
        let (tracks, frames) = (self.motion.tracks.len(), self.frames.len());
        RejectedCandidate { kind, tracks, frames, reason, needs_more: false }
    }
}

/// Fits the joint models to the motion of a part in the base frame; `None` if no model fits.
pub(super) fn fit_to_base(motion: PartMotion) -> Option<Candidate> {
    let (frames, samples): (Vec<usize>, Vec<PoseSample>) = motion
        .base_from_part
        .iter()
        .enumerate()
        .filter_map(|(t, pose)| Some((t, PoseSample::from_pose(t as f64, pose.as_ref()?))))
        .unzip();
    let fit = fit_models(&samples).ok()?.into_iter().next()?;
    tracing::debug!(
        tracks = motion.tracks.len(),
        kind = fit.geometry.kind.name(),
        frames = ?frames.first().zip(frames.last()),
        span = span_of(&fit.configuration),
        rmse_m = fit.position_rmse,
        "cluster"
    );
    Some(Candidate { motion, fit, frames })
}

/// The frames in which both parts have a pose, and the pose of `b` in the frame of `a` in each;
/// `None` if there is no such frame.
pub(super) fn relative_samples(
    a: &PartMotion,
    b: &PartMotion,
) -> Option<(Vec<usize>, Vec<PoseSample>)> {
    let pairs: Vec<(usize, PoseSample)> = a
        .base_from_part
        .iter()
        .zip(&b.base_from_part)
        .enumerate()
        .filter_map(|(t, (a, b))| {
            Some((t, PoseSample::from_pose(t as f64, &(a.as_ref()?.inverse() * b.as_ref()?))))
        })
        .collect();
    (!pairs.is_empty()).then(|| pairs.into_iter().unzip())
}

/// Squared correlation of two configurations, 0 to 1: a hand, or an edge that is dragged along,
/// moves with the part that it holds. 0 if `b` is known in less than half of the frames of `a`.
pub(super) fn correlation(a: &Candidate, b: &Candidate) -> f64 {
    let common: Vec<(f64, f64)> = a
        .frames
        .iter()
        .zip(&a.fit.configuration)
        .filter_map(|(f, &q)| Some((q, b.fit.configuration[b.frames.binary_search(f).ok()?])))
        .collect();
    if 2 * common.len() < a.frames.len() {
        return 0.0;
    }
    Moments::of(&common).correlation_sq().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::JointKind;

    /// A part that is at `z(frame)`, metres before the camera, in the given frames of forty.
    fn part(frames: std::ops::Range<usize>, z: impl Fn(usize) -> f64) -> PartMotion {
        let pose = |f: usize| frames.contains(&f).then(|| Pose::translation(0.0, 0.0, z(f)));
        PartMotion { base_from_part: (0..40).map(pose).collect(), tracks: vec![1] }
    }

    #[test]
    fn a_part_that_moves_straight_is_a_slide_over_the_frames_that_show_it() {
        let fitted = fit_to_base(part(5..40, |f| 1.0 - 0.01 * f as f64)).unwrap();
        assert_eq!(fitted.fit.geometry.kind, JointKind::Prismatic);
        assert_eq!(fitted.frames, (5..40).collect::<Vec<_>>());
    }

    #[test]
    fn a_part_that_is_never_seen_is_fitted_by_nothing() {
        assert!(fit_to_base(part(0..0, |_| 1.0)).is_none());
    }

    #[test]
    fn parts_are_compared_in_their_common_frames() {
        let (a, b) = (part(0..20, |_| 1.0), part(10..40, |f| 1.0 + 0.01 * f as f64));
        let (frames, samples) = relative_samples(&a, &b).unwrap();
        assert_eq!(frames, (10..20).collect::<Vec<_>>());
        assert!((samples[0].position.z - 0.1).abs() < 1e-12);
        assert!(relative_samples(&part(0..5, |_| 1.0), &b).is_none());
    }

    #[test]
    fn what_moves_as_another_part_does_is_a_function_of_it() {
        let steady = |f: usize| 1.0 - 0.01 * f as f64;
        let to_and_fro = |f: usize| 1.0 + 0.2 * (0.6 * f as f64).sin();
        let fitted = |z: &dyn Fn(usize) -> f64| fit_to_base(part(0..40, z)).unwrap();
        let drawer = fitted(&steady);
        assert!(correlation(&fitted(&|f| 3.0 - 0.02 * f as f64), &drawer) > 0.99);
        assert!(correlation(&fitted(&to_and_fro), &drawer) < 0.5);
    }
}
