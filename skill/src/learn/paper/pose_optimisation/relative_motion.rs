//! Estimates the motions of a cluster between pairs of frames, with outlier rejection.
//!
//! In: the cluster's tracks in the base frame, metres.
//! Out: relative motions about a fixed centre, in base axes, with standard deviations.
//! From: paper, section III-C; RANSAC (MSAC score).

use crate::learn::ego_motion::EgoMotion;
use crate::learn::paper::segmentation::Cluster;
use crate::math::ransac::{Correspondence, RansacOptions, ransac_rigid};
use crate::math::rigid::Pose;
use nalgebra::Point3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Gaps between the frames of a relative motion. Paper, III-C: 1 and 10.
const GAPS: [usize; 2] = [1, 10];
/// Inlier distance of RANSAC, metres. Paper, III-C: 1 cm.
pub const INLIER_M: f64 = 0.01;
/// Number of RANSAC samples. Original code: 50.
const RANSAC_ITERATIONS: usize = 50;
/// Smallest number of tracks that determine a relative motion.
const MIN_TRACKS: usize = 4;

/// Motion of a cluster between two frames, in base axes about a fixed centre.
#[derive(Debug, Clone)]
pub struct RelativeMotion {
    /// The earlier frame.
    pub from: usize,
    /// The later frame.
    pub to: usize,
    /// Maps places at `from` to places at `to`.
    pub motion: Pose,
    /// Standard deviation of the rotation, radians.
    pub sigma_rad: f64,
    /// Standard deviation of the translation, metres.
    pub sigma_m: f64,
}

/// Estimates the relative motions over all gaps (`t-1,t` and `t-10,t`); correspondences beyond the
/// inlier distance are rejected.
pub fn measure(
    base: &EgoMotion,
    cluster: &Cluster,
    centre: &Point3<f64>,
    seed: u64,
) -> Vec<RelativeMotion> {
    let frames = base.camera_from_base.len();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut motions = Vec::new();
    for to in 0..frames {
        for &gap in &GAPS {
            if let Some(from) = to.checked_sub(gap) {
                let pairs = correspondences(base, cluster, centre, (from, to));
                motions.extend(relative_motion(&pairs, (from, to), &mut rng));
            }
        }
    }
    motions
}

/// Places, about the centre, of the cluster's tracks that are seen in both of two frames.
fn correspondences(
    base: &EgoMotion,
    cluster: &Cluster,
    centre: &Point3<f64>,
    (from, to): (usize, usize),
) -> Vec<Correspondence> {
    cluster
        .tracks
        .iter()
        .filter_map(|&id| {
            let (a, b) = (base.tracks[id].at(from)?, base.tracks[id].at(to)?);
            Some(Correspondence {
                from: a.point - centre.coords,
                to: b.point - centre.coords,
                sigma: INLIER_M,
                weight: 1.0,
            })
        })
        .collect()
}

/// The motion that most correspondences between two frames follow; `None` with fewer than
/// `MIN_TRACKS` inliers.
fn relative_motion(
    pairs: &[Correspondence],
    (from, to): (usize, usize),
    rng: &mut ChaCha8Rng,
) -> Option<RelativeMotion> {
    if pairs.len() < MIN_TRACKS {
        return None;
    }
    let options = RansacOptions { cut: 1.0, iterations: RANSAC_ITERATIONS, locality: None };
    let found = ransac_rigid(pairs, &options, Some(&Pose::identity()), rng)?;
    if found.inliers.len() < MIN_TRACKS {
        return None;
    }
    let (spread, residual) = spread_and_residual(pairs, &found.inliers, &found.motion);
    let n = found.inliers.len() as f64;
    let point_sigma = residual.max(0.001);
    Some(RelativeMotion {
        from,
        to,
        motion: found.motion,
        sigma_rad: point_sigma / (spread.max(0.01) * n.sqrt()),
        sigma_m: point_sigma / n.sqrt(),
    })
}

/// Root mean square distance of the inliers from their mean, and root mean square residual, metres.
fn spread_and_residual(pairs: &[Correspondence], inliers: &[usize], motion: &Pose) -> (f64, f64) {
    let n = inliers.len() as f64;
    let mean = inliers.iter().map(|&i| pairs[i].to.coords).sum::<nalgebra::Vector3<f64>>() / n;
    let sum = |f: &dyn Fn(&Correspondence) -> f64| {
        (inliers.iter().map(|&i| f(&pairs[i])).sum::<f64>() / n).sqrt()
    };
    (
        sum(&|p| (p.to.coords - mean).norm_squared()),
        sum(&|p| (motion * p.from - p.to).norm_squared()),
    )
}

/// Frames of the largest set that relative motions connect, ascending.
pub fn largest_connected(motions: &[RelativeMotion], frames: usize) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..frames).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    let mut touched = vec![false; frames];
    for m in motions {
        let (a, b) = (root(&mut parent, m.from), root(&mut parent, m.to));
        parent[b] = a;
        touched[m.from] = true;
        touched[m.to] = true;
    }
    let mut groups = std::collections::BTreeMap::<usize, Vec<usize>>::new();
    for frame in (0..frames).filter(|&f| touched[f]) {
        groups.entry(root(&mut parent, frame)).or_default().push(frame);
    }
    groups.into_values().max_by_key(|g| (g.len(), std::cmp::Reverse(g[0]))).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trajectory_torn_in_two_keeps_its_longer_half() {
        let link = |from, to| RelativeMotion {
            from,
            to,
            motion: Pose::identity(),
            sigma_rad: 0.01,
            sigma_m: 0.01,
        };
        let motions = [link(0, 1), link(1, 2), link(10, 11), link(11, 12), link(12, 13)];
        assert_eq!(largest_connected(&motions, 20), vec![10, 11, 12, 13]);
    }
}
