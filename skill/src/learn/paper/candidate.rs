//! A moving part with the joint that explains its motion relative to the base.

use super::pose_optimisation::PartMotion;
use crate::articulation::{FittedJoint, PoseSample, fit_models};
use crate::learn::learned_joint::{RejectedCandidate, span_of};
use crate::math::robust::Moments;

/// A part while the tree is built.
#[derive(Clone)]
pub(super) struct Candidate {
    pub motion: PartMotion,
    pub fit: FittedJoint,
    /// Frames of the fit's samples.
    pub frames: Vec<usize>,
}

impl Candidate {
    /// What a report tells of a candidate that is no part of an object.
    pub(super) fn rejected(&self, reason: String) -> RejectedCandidate {
        let kind = self.fit.geometry.kind;
        let (tracks, frames) = (self.motion.tracks.len(), self.frames.len());
        RejectedCandidate { kind, tracks, frames, reason }
    }
}

/// Fits the joint models to the motion of a part in the base frame; `None` where no model fits.
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

/// The frames in which both parts have a pose, and the pose of `b` in the frame of `a` there;
/// `None` where there is no such frame.
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
/// moves with the part that it holds.
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
