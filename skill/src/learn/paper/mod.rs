//! From clusters to a kinematic tree: the paper's sections III-B to III-D in a row, and the
//! tests that decide which of the moving things is a part of an object at all (an arm is
//! not).

mod candidate;
pub(crate) mod config;
mod merge;
mod part_motions;
pub mod pose_optimisation;
mod rejection;
pub mod segmentation;
mod tree;

use super::ego_motion::EgoMotion;
use super::keyframes::Keyframes;
use super::learned_joint::LearnedJoint;
use super::stage_times::StageTimes;
use super::tracking::TrackSet;
use crate::config::SkillConfig;
use candidate::{Candidate, fit_to_base};
use merge::{merge_rigid, merge_stretches};
use part_motions::motions_of;
use pose_optimisation::PartMotion;
use rayon::prelude::*;
use rejection::doubt;
use segmentation::segment;
use tree::build_tree;

/// Sections III-B to III-D of the paper.
pub fn from_clusters(
    set: &TrackSet,
    base: &EgoMotion,
    keyframes: &Keyframes,
    config: &SkillConfig,
    times: &mut StageTimes,
) -> Vec<LearnedJoint> {
    let clusters = times.measure("segment", || segment(set, base, &config.segment));
    let motions: Vec<PartMotion> = times.measure("pose", || {
        clusters.par_iter().flat_map_iter(|c| motions_of(base, keyframes, c, config)).collect()
    });
    times.measure("articulate", || {
        let candidates = candidates(base, keyframes, motions, config);
        build_tree(set, base, candidates, config)
    })
}

fn candidates(
    base: &EgoMotion,
    keyframes: &Keyframes,
    motions: Vec<PartMotion>,
    config: &SkillConfig,
) -> Vec<Candidate> {
    let mut fitted: Vec<Candidate> =
        motions.into_iter().filter_map(|m| fit_to_base(m, config)).collect();
    merge_rigid(base, &mut fitted, config);
    merge_stretches(&mut fitted, config);
    fitted.sort_by_key(|c| std::cmp::Reverse(c.motion.tracks.len()));
    let mut believed: Vec<Candidate> = Vec::new();
    for candidate in fitted {
        let reason = doubt(base, keyframes, &candidate, &believed, config);
        tracing::debug!(
            tracks = candidate.motion.tracks.len(),
            kind = candidate.fit.geometry.kind.name(),
            frames = candidate.frames.len(),
            rmse_m = candidate.fit.position_rmse,
            outliers = candidate.fit.outlier_ratio,
            refused = reason.as_deref().unwrap_or("no"),
            "part"
        );
        if reason.is_none() {
            believed.push(candidate);
        }
    }
    believed
}
