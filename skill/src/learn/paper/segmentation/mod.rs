//! Motion segmentation: features whose mutual distance and angle stay constant over their common
//! frames lie on one rigid part; DBSCAN finds the parts.
//!
//! In: tracks in the base frame, metres, with normals in the camera frame.
//! Out: clusters of tracks, the largest first.
//! From: paper, section III-B, Eqs. 1 to 3; DBSCAN of Ester et al. 1996. Ours: only tracks that
//! move in the base frame are clustered, and two tracks are compared only in frames in which one of
//! them moves. Else a long rest side by side would outweigh any motion, and everything that once
//! rested would be one part.

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
use split_chains::split_chained_clusters;
use std::cmp::Ordering;

/// Kernel width of Eq. 1 for distances (Eq. 2), metres: gamma = 1 / (2 sigma^2). The paper has 1 /
/// (2 cm) for gamma, the original code 1 cm for sigma.
const DISTANCE_SIGMA_M: f64 = 0.01;
/// Angle that determines the kernel width of Eq. 1 for normals (Eq. 3), radians: the width is four
/// times 1 - cos of the angle. The paper: 15 degrees.
const NORMAL_SIGMA_RAD: f64 = 0.262;
/// Smallest number of frames that two tracks must share. Original code: 10.
const MIN_COMMON_FRAMES: usize = 10;
/// Smallest motion of a track in a frame in which it moves, metres: the change of its smoothed
/// place from three frames before to three frames after, which must exceed noise too. Ours.
const MIN_MOTION_M: f64 = 0.012;
/// Smallest extent of the path of each of two tracks in their common frames, metres: a hand and the
/// part that it holds keep their distance over short paths only. Ours.
const MIN_COMMON_MOTION_M: f64 = 0.08;
/// Smallest number of common frames in which each of two tracks must move. Ours.
const MIN_MOVING_FRAMES: usize = 5;
/// Radius of DBSCAN, on 1 - L. Original code: 0.2.
const EPSILON: f64 = 0.2;
/// Smallest number of neighbours of a DBSCAN core. Original code: 3.
const MIN_NEIGHBOURS: usize = 3;
/// Smallest number of tracks in a cluster. Original code: 3; ours: 5.
pub const MIN_CLUSTER: usize = 5;
/// Largest number of tracks that are compared in pairs, those with the most observations first; the
/// time grows with its square.
const MAX_TRACKS: usize = 2500;

/// Tracks of one rigidly moving thing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cluster {
    /// Indices of the tracks in the track set, ascending.
    pub tracks: Vec<usize>,
}

/// Clusters the tracks that move in the base frame; the largest cluster comes first.
pub fn segment(set: &TrackSet, base: &EgoMotion) -> Vec<Cluster> {
    let moving = longest_moving(base, MAX_TRACKS);
    let motion: Vec<Vec<bool>> =
        moving.par_iter().map(|&t| frames_of_motion(&base.tracks[t])).collect();
    let evidence = evidence(set, base, &moving, &motion);
    let neighbours: Vec<Vec<usize>> = (0..moving.len())
        .map(|i| (0..moving.len()).filter(|&j| evidence[(i, j)] == PairEvidence::Similar).collect())
        .collect();
    let mut clusters: Vec<Cluster> = dbscan(&neighbours, MIN_NEIGHBOURS)
        .into_iter()
        .flat_map(|members| split_chained_clusters(&evidence, members, MIN_CLUSTER))
        .map(|members| {
            let mut tracks: Vec<usize> = members.into_iter().map(|i| moving[i]).collect();
            tracks.sort_unstable();
            Cluster { tracks }
        })
        .collect();
    clusters.sort_by_key(|c| std::cmp::Reverse(c.tracks.len()));
    tracing::debug!(
        moving = moving.len(),
        linked = neighbours.iter().filter(|n| n.len() >= MIN_NEIGHBOURS).count(),
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

/// The evidence between each two of the `moving` tracks.
fn evidence(
    set: &TrackSet,
    base: &EgoMotion,
    moving: &[usize],
    motion: &[Vec<bool>],
) -> DMatrix<PairEvidence> {
    let n = moving.len();
    let rows: Vec<Vec<PairEvidence>> = (0..n)
        .into_par_iter()
        .map(|i| {
            (i + 1..n)
                .map(|j| {
                    let common = Common::of(base, (moving[i], &motion[i]), (moving[j], &motion[j]));
                    match similarity(set, base, &common) {
                        None => PairEvidence::None,
                        Some(l) if 1.0 - l <= EPSILON => PairEvidence::Similar,
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

/// The frames in which two tracks are compared.
struct Common {
    tracks: [usize; 2],
    /// Frames in which both tracks are seen and at least one of them moves.
    frames: Vec<usize>,
    /// Number of `frames` in which each of the two tracks moves.
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

/// Similarity of two tracks: Eq. 1 over distances (Eq. 2) times a factor from Eq. 1 over normals
/// (Eq. 3); `None` if the tracks are no evidence about each other.
fn similarity(set: &TrackSet, base: &EgoMotion, common: &Common) -> Option<f64> {
    if common.frames.len() < MIN_COMMON_FRAMES
        || common.moving.iter().any(|&m| m < MIN_MOVING_FRAMES)
    {
        return None;
    }
    let [a, b] = common.tracks;
    let way = |id: usize| {
        let track = &base.tracks[id];
        extent(common.frames.iter().filter_map(|&t| track.at(t)).map(|p| p.point.coords))
    };
    if way(a).min(way(b)) < MIN_COMMON_MOTION_M {
        return None;
    }
    let distances: Vec<f64> = common
        .frames
        .iter()
        .filter_map(|&t| Some((base.tracks[a].at(t)?.point - base.tracks[b].at(t)?.point).norm()))
        .collect();
    let by_distance = mean_kernel(&distances, DISTANCE_SIGMA_M);
    if 1.0 - by_distance > EPSILON {
        return Some(by_distance);
    }
    let normal =
        |id: usize, t: usize| -> Option<Vector3<f64>> { set.tracks[id].at(t)?.normal_in_camera };
    let angles: Vec<f64> = common
        .frames
        .iter()
        .filter_map(|&t| Some(1.0 - normal(a, t)?.dot(&normal(b, t)?)))
        .collect();
    if angles.len() < MIN_COMMON_FRAMES {
        return Some(by_distance);
    }
    let width = 1.0 - NORMAL_SIGMA_RAD.cos();
    // Normals of small patches are noisy: they multiply a similarity by 0.84 to 1, and never raise
    // it.
    Some(by_distance * mean_kernel(&angles, 4.0 * width).max(0.5).powf(0.25))
}

/// For each frame of a track's life: true if the track moves then.
fn frames_of_motion(track: &TrackInBase) -> Vec<bool> {
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
            before.zip(after).is_some_and(|(a, b)| (b - a).norm() > MIN_MOTION_M.max(3.0 * sigma))
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
