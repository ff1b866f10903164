//! The motions in a cluster of tracks (paper, section III-C), without the tracks that do not
//! belong to it (outliers).

use super::pose_optimisation;
use super::pose_optimisation::PartMotion;
use super::segmentation::{Cluster, MIN_CLUSTER};
use crate::learn::free_space::{FreeSpaceCounts, count_free_space};
use crate::learn::recording::Recording;
use crate::math::robust::median_point;
use nalgebra::Point3;

/// The motions in a cluster, the clearest first. A hand and what it holds move as one for a while, so
/// that a cluster may hold several things: tracks that depart from its motion, or that the pictures
/// contradict, are a cluster of their own in the next round.
pub(super) fn motions_of(recording: &Recording, cluster: &Cluster, seed: u64) -> Vec<PartMotion> {
    let mut motions = Vec::new();
    let mut rest = cluster.tracks.clone();
    for round in 0..MOTIONS_OF_A_CLUSTER {
        let seed = seed + round;
        let Some(motion) = pose_optimisation::estimate(
            &recording.ego_motion,
            &Cluster { tracks: rest.clone() },
            seed,
        ) else {
            break;
        };
        let motion = without_outliers(recording, motion, seed);
        let before = rest.len();
        rest.retain(|t| !motion.tracks.contains(t));
        motions.push(motion);
        if rest.len() < MIN_CLUSTER || rest.len() == before {
            break;
        }
    }
    motions
}

/// Most motions sought in one cluster.
const MOTIONS_OF_A_CLUSTER: u64 = 5;

/// Takes out tracks that depart from the motion and tracks that the pictures contradict one by
/// one (a hand moves with what it holds, but comes and leaves), and estimates the motion anew
/// from the rest.
fn without_outliers(recording: &Recording, mut motion: PartMotion, seed: u64) -> PartMotion {
    let base = &recording.ego_motion;
    for round in 0..OUTLIER_ROUNDS {
        let all = motion.tracks.len();
        let mut kept = pose_optimisation::followers(base, &motion);
        kept = uncontradicted(recording, &motion, &kept);
        if kept.len() == all || kept.len() < MIN_CLUSTER {
            break;
        }
        let seed = seed + round;
        match pose_optimisation::estimate(base, &Cluster { tracks: kept }, seed) {
            Some(again) => motion = again,
            None => break,
        }
    }
    motion
}

/// Rounds of removing outliers: the motion is clearer after each.
const OUTLIER_ROUNDS: u64 = 3;

/// Tracks whose place on the part is not seen through in a third of the keyframes that show
/// something there.
fn uncontradicted(recording: &Recording, motion: &PartMotion, tracks: &[usize]) -> Vec<usize> {
    let base = &recording.ego_motion;
    let on_part = |id: usize| {
        let places: Vec<Point3<f64>> = base.tracks[id]
            .seen()
            .filter_map(|(t, p)| Some(motion.base_from_part[t]?.inverse_transform_point(&p.point)))
            .collect();
        median_point(&places)
    };
    let stands = |id: usize| {
        let Some(place) = on_part(id) else { return false };
        let mut all = FreeSpaceCounts::default();
        for (frame, picture) in recording.keyframes.iter() {
            if let Some(pose) = motion.base_from_part[frame] {
                let camera_from_part = base.camera_from_base[frame] * pose;
                all.add(count_free_space(picture, &[place], &camera_from_part));
            }
        }
        all.mostly_agrees()
    };
    tracks.iter().copied().filter(|&id| stands(id)).collect()
}
