//! Motion segmentation (paper, section III-B): features whose mutual distance and angle stay
//! constant over their common life lie on one rigid part; DBSCAN finds the parts.
//!
//! The base's own tracks are known already ([`crate::base`]); what moves is clustered here.
//! Two tracks that were never seen *moving* together say nothing about each other: their
//! similarity counts as none, otherwise everything that once rested side by side would be
//! one part.

mod dbscan;

use crate::base::{BaseMotion, BaseTrack};
use crate::track::TrackSet;
use dbscan::dbscan;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Values of the segmentation stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentConfig {
    /// Kernel width of Eq. 1 for distances (Eq. 2), metres: gamma = 1 / (2 sigma^2). The
    /// paper says "1/2cm", the original code sigma = 1 cm.
    pub distance_sigma_m: f64,
    /// Kernel width of Eq. 1 for normals (Eq. 3, 1 - cos), radians of the angle at which
    /// the kernel has fallen to exp(-1/2); 0 leaves normals out. The paper: 15 degrees.
    pub normal_sigma_rad: f64,
    /// Fewest frames two tracks must share. Original code: 10.
    pub min_common_frames: usize,
    /// Both tracks must move this far within their common frames, metres. Ours.
    pub min_common_motion_m: f64,
    /// DBSCAN radius on 1 - L. Original code: 0.2.
    pub epsilon: f64,
    /// DBSCAN core size. Original code: 3.
    pub min_neighbours: usize,
    /// Smaller clusters are dropped. Original code: 3; ours: 5.
    pub min_cluster: usize,
    /// Most tracks that are compared pairwise, longest paths first.
    pub max_tracks: usize,
}

impl Default for SegmentConfig {
    fn default() -> Self {
        Self {
            distance_sigma_m: 0.01,
            normal_sigma_rad: 0.262,
            min_common_frames: 10,
            min_common_motion_m: 0.02,
            epsilon: 0.2,
            min_neighbours: 3,
            min_cluster: 5,
            max_tracks: 2500,
        }
    }
}

/// Tracks of one rigidly moving thing, as indices into the track set; largest first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cluster {
    /// Members, ascending.
    pub tracks: Vec<usize>,
}

/// Clusters the tracks that move in the base.
pub fn segment(set: &TrackSet, base: &BaseMotion, config: &SegmentConfig) -> Vec<Cluster> {
    let moving = longest_moving(base, config.max_tracks);
    let neighbours: Vec<Vec<usize>> = (0..moving.len())
        .into_par_iter()
        .map(|i| {
            (0..moving.len())
                .filter(|&j| {
                    let similarity = similarity(set, base, moving[i], moving[j], config);
                    i != j && similarity.is_some_and(|l| 1.0 - l <= config.epsilon)
                })
                .collect()
        })
        .collect();
    let mut clusters: Vec<Cluster> = dbscan(&neighbours, config.min_neighbours)
        .into_iter()
        .filter(|members| members.len() >= config.min_cluster)
        .map(|members| {
            let mut tracks: Vec<usize> = members.into_iter().map(|i| moving[i]).collect();
            tracks.sort_unstable();
            Cluster { tracks }
        })
        .collect();
    clusters.sort_by_key(|c| std::cmp::Reverse(c.tracks.len()));
    clusters
}

fn longest_moving(base: &BaseMotion, limit: usize) -> Vec<usize> {
    let mut moving: Vec<usize> = (0..base.tracks.len()).filter(|&i| base.tracks[i].moves).collect();
    if moving.len() > limit {
        let seen = |i: usize| base.tracks[i].points.iter().flatten().count();
        moving.sort_by_key(|&i| std::cmp::Reverse(seen(i)));
        moving.truncate(limit);
        moving.sort_unstable();
    }
    moving
}

/// Eq. 1 over positions (Eq. 2) times Eq. 1 over normals (Eq. 3); `None` where the two
/// tracks hold no evidence about each other.
fn similarity(
    set: &TrackSet,
    base: &BaseMotion,
    a: usize,
    b: usize,
    config: &SegmentConfig,
) -> Option<f64> {
    let (track_a, track_b) = (&base.tracks[a], &base.tracks[b]);
    let common = common_frames(track_a, track_b);
    if common.len() < config.min_common_frames {
        return None;
    }
    if !(travels(track_a, &common, config.min_common_motion_m)
        && travels(track_b, &common, config.min_common_motion_m))
    {
        return None;
    }
    let distances: Vec<f64> = common
        .iter()
        .filter_map(|&t| Some((track_a.at(t)?.point - track_b.at(t)?.point).norm()))
        .collect();
    let by_distance = mean_kernel(&distances, config.distance_sigma_m);
    if 1.0 - by_distance > config.epsilon || config.normal_sigma_rad <= 0.0 {
        return Some(by_distance);
    }
    let normal =
        |id: usize, t: usize| -> Option<Vector3<f64>> { set.tracks[id].at(t)?.normal_in_camera };
    let angles: Vec<f64> =
        common.iter().filter_map(|&t| Some(1.0 - normal(a, t)?.dot(&normal(b, t)?))).collect();
    if angles.len() < config.min_common_frames {
        return Some(by_distance);
    }
    let width = 1.0 - config.normal_sigma_rad.cos();
    // Normals of small patches are noisy: they may veto, not improve.
    Some(by_distance * mean_kernel(&angles, 4.0 * width).max(0.5).powf(0.25))
}

fn common_frames(a: &BaseTrack, b: &BaseTrack) -> Vec<usize> {
    let first = a.first_frame.max(b.first_frame);
    let end = a.end_frame().min(b.end_frame());
    (first..end).filter(|&t| a.at(t).is_some() && b.at(t).is_some()).collect()
}

fn travels(track: &BaseTrack, frames: &[usize], least_m: f64) -> bool {
    let mut seen = frames.iter().filter_map(|&t| track.at(t));
    let Some(first) = seen.next() else { return false };
    seen.any(|p| (p.point - first.point).norm() > least_m.max(4.0 * p.sigma))
}

/// Eq. 1: mean of exp(-(d - mean d)^2 / 2 sigma^2).
fn mean_kernel(values: &[f64], sigma: f64) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n; // Eqs. 2 and 3
    let gamma = 1.0 / (2.0 * sigma * sigma);
    values.iter().map(|d| (-gamma * (d - mean).powi(2)).exp()).sum::<f64>() / n
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_distance_is_wholly_similar_and_a_growing_one_is_not() {
        let constant = vec![0.3; 40];
        let growing: Vec<f64> = (0..40).map(|t| 0.3 + 0.005 * f64::from(t)).collect();
        assert!(mean_kernel(&constant, 0.01) > 0.999);
        assert!(mean_kernel(&growing, 0.01) < 0.3);
    }
}
