//! Motion segmentation (paper, section III-B): features whose mutual distance and angle stay
//! constant over their common life lie on one rigid part; DBSCAN finds the parts.
//!
//! The base's own tracks are known already ([`crate::learn::ego_motion`]); what moves is clustered here.
//! Two tracks say something about each other only in frames in which one of them moves: a
//! long rest side by side would outvote any motion, and everything that once rested would be
//! one part.

mod dbscan;
mod pair_evidence;
mod split_chains;

use crate::learn::ego_motion::{BaseObservation, EgoMotion, TrackInBase};
use crate::learn::tracking::TrackSet;
use crate::math::robust::{extent, median_point};
use dbscan::dbscan;
use nalgebra::{DMatrix, Point3, Vector3};
use pair_evidence::PairEvidence;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use split_chains::split_chained_clusters;
use std::cmp::Ordering;

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
    /// A track moves in a frame when its smoothed place changes by this much from three
    /// frames before to three after, metres, and by more than noise explains. Ours.
    pub min_motion_m: f64,
    /// Way that each of two tracks must make in their common frames, metres: a hand and what
    /// it holds keep their distance for a little while only. Ours.
    pub min_common_motion_m: f64,
    /// Fewest common frames in which each of two tracks must move. Ours.
    pub min_moving_frames: usize,
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
            min_motion_m: 0.012,
            min_common_motion_m: 0.08,
            min_moving_frames: 5,
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
pub fn segment(set: &TrackSet, base: &EgoMotion, config: &SegmentConfig) -> Vec<Cluster> {
    let moving = longest_moving(base, config.max_tracks);
    let motion: Vec<Vec<bool>> =
        moving.par_iter().map(|&t| frames_of_motion(&base.tracks[t], config)).collect();
    let evidence = evidence(set, base, &moving, &motion, config);
    let neighbours: Vec<Vec<usize>> = (0..moving.len())
        .map(|i| (0..moving.len()).filter(|&j| evidence[(i, j)] == PairEvidence::Similar).collect())
        .collect();
    let mut clusters: Vec<Cluster> = dbscan(&neighbours, config.min_neighbours)
        .into_iter()
        .flat_map(|members| split_chained_clusters(&evidence, members, config.min_cluster))
        .map(|members| {
            let mut tracks: Vec<usize> = members.into_iter().map(|i| moving[i]).collect();
            tracks.sort_unstable();
            Cluster { tracks }
        })
        .collect();
    clusters.sort_by_key(|c| std::cmp::Reverse(c.tracks.len()));
    tracing::debug!(
        moving = moving.len(),
        linked = neighbours.iter().filter(|n| n.len() >= config.min_neighbours).count(),
        clusters = ?clusters.iter().map(|c| c.tracks.len()).collect::<Vec<_>>(),
        "segmented"
    );
    clusters
}

fn longest_moving(base: &EgoMotion, limit: usize) -> Vec<usize> {
    let mut moving: Vec<usize> = (0..base.tracks.len()).filter(|&i| base.tracks[i].moves).collect();
    if moving.len() > limit {
        let seen = |i: usize| base.tracks[i].points.iter().flatten().count();
        moving.sort_by_key(|&i| std::cmp::Reverse(seen(i)));
        moving.truncate(limit);
        moving.sort_unstable();
    }
    moving
}

/// The evidence between each two of `moving`.
fn evidence(
    set: &TrackSet,
    base: &EgoMotion,
    moving: &[usize],
    motion: &[Vec<bool>],
    config: &SegmentConfig,
) -> DMatrix<PairEvidence> {
    let n = moving.len();
    let rows: Vec<Vec<PairEvidence>> = (0..n)
        .into_par_iter()
        .map(|i| {
            (i + 1..n)
                .map(|j| {
                    let common = Common::of(base, (moving[i], &motion[i]), (moving[j], &motion[j]));
                    match similarity(set, base, &common, config) {
                        None => PairEvidence::None,
                        Some(l) if 1.0 - l <= config.epsilon => PairEvidence::Similar,
                        Some(_) => PairEvidence::Different,
                    }
                })
                .collect()
        })
        .collect();
    DMatrix::from_fn(n, n, |i, j| match i.cmp(&j) {
        Ordering::Less => rows[i][j - i - 1],
        Ordering::Equal => PairEvidence::None,
        Ordering::Greater => rows[j][i - j - 1],
    })
}

/// The frames in which two tracks say something about each other.
struct Common {
    tracks: [usize; 2],
    /// Frames in which both are seen and one of them moves.
    frames: Vec<usize>,
    /// In how many of them each moves.
    moving: [usize; 2],
}

impl Common {
    fn of(base: &EgoMotion, a: (usize, &[bool]), b: (usize, &[bool])) -> Self {
        let (track_a, track_b) = (&base.tracks[a.0], &base.tracks[b.0]);
        let first = track_a.first_frame.max(track_b.first_frame);
        let end = track_a.end_frame().min(track_b.end_frame());
        let mut common = Self { tracks: [a.0, b.0], frames: Vec::new(), moving: [0, 0] };
        for t in first..end {
            let (a_moves, b_moves) = (a.1[t - track_a.first_frame], b.1[t - track_b.first_frame]);
            if (a_moves || b_moves) && track_a.at(t).is_some() && track_b.at(t).is_some() {
                common.frames.push(t);
                common.moving[0] += usize::from(a_moves);
                common.moving[1] += usize::from(b_moves);
            }
        }
        common
    }
}

/// Eq. 1 over positions (Eq. 2) times Eq. 1 over normals (Eq. 3); `None` where the two
/// tracks hold no evidence about each other.
fn similarity(
    set: &TrackSet,
    base: &EgoMotion,
    common: &Common,
    config: &SegmentConfig,
) -> Option<f64> {
    if common.frames.len() < config.min_common_frames
        || common.moving.iter().any(|&m| m < config.min_moving_frames)
    {
        return None;
    }
    let [a, b] = common.tracks;
    let way = |id: usize| {
        let track = &base.tracks[id];
        extent(common.frames.iter().filter_map(|&t| track.at(t)).map(|p| p.point.coords))
    };
    if way(a).min(way(b)) < config.min_common_motion_m {
        return None;
    }
    let distances: Vec<f64> = common
        .frames
        .iter()
        .filter_map(|&t| Some((base.tracks[a].at(t)?.point - base.tracks[b].at(t)?.point).norm()))
        .collect();
    let by_distance = mean_kernel(&distances, config.distance_sigma_m);
    if 1.0 - by_distance > config.epsilon || config.normal_sigma_rad <= 0.0 {
        return Some(by_distance);
    }
    let normal =
        |id: usize, t: usize| -> Option<Vector3<f64>> { set.tracks[id].at(t)?.normal_in_camera };
    let angles: Vec<f64> = common
        .frames
        .iter()
        .filter_map(|&t| Some(1.0 - normal(a, t)?.dot(&normal(b, t)?)))
        .collect();
    if angles.len() < config.min_common_frames {
        return Some(by_distance);
    }
    let width = 1.0 - config.normal_sigma_rad.cos();
    // Normals of small patches are noisy: they may veto, not improve.
    Some(by_distance * mean_kernel(&angles, 4.0 * width).max(0.5).powf(0.25))
}

/// For each frame of a track's life: does it move then?
fn frames_of_motion(track: &TrackInBase, config: &SegmentConfig) -> Vec<bool> {
    const REACH: usize = 3;
    let place = |i: usize| {
        let near = i.saturating_sub(2)..(i + 3).min(track.points.len());
        let seen: Vec<Point3<f64>> = track.points[near].iter().flatten().map(|p| p.point).collect();
        median_point(&seen)
    };
    let smoothed: Vec<Option<Point3<f64>>> = (0..track.points.len()).map(place).collect();
    (0..track.points.len())
        .map(|i| {
            let before = smoothed[i.saturating_sub(REACH)];
            let after = smoothed[(i + REACH).min(smoothed.len() - 1)];
            let sigma = track.points[i].as_ref().map_or(0.0, BaseObservation::sigma);
            before
                .zip(after)
                .is_some_and(|(a, b)| (b - a).norm() > config.min_motion_m.max(3.0 * sigma))
        })
        .collect()
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
