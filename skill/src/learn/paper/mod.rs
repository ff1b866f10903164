//! From clusters to a kinematic tree: the paper's sections III-B to III-D in a row, and the
//! tests that decide which of the moving things is a part of an object at all (an arm is
//! not).

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

/// Clusters of tracks (III-B), their poses (III-C), and the kinematic tree of the joints between
/// them (III-D); with the moving things that are no part of an object.
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

/// The moving things that are parts of an object, and those that are not.
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
