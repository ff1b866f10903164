//! Multi-rigid-body pose optimisation: the SE(3) trajectory of each cluster, from relative motions
//! between the frames t-1 and t, and between t-10 and t, smoothed in a factor graph.
//!
//! In: a cluster of tracks in the base frame, metres.
//! Out: poses of the part in the base frame. At its reference frame the part has the directions of
//! the base, and its origin is the mean of all observations of its tracks.
//! From: paper, section III-C.

mod factor_graph;
mod relative_motion;

use super::segmentation::Cluster;
use crate::learn::ego_motion::EgoMotion;
use crate::learn::tracking::Trajectory;
use crate::math::rigid::Pose;
use crate::math::robust::median_point;
use nalgebra::{Point3, Translation3};

/// The trajectory of a part, and its tracks.
#[derive(Debug, Clone)]
pub struct PartMotion {
    /// Pose of the part in the base frame; `None` in frames that do not show it.
    pub base_from_part: Trajectory,
    /// Indices of the tracks on the part.
    pub tracks: Vec<usize>,
}

/// Estimates the trajectory of a cluster; `None` if the cluster is seen too little.
pub fn estimate(base: &EgoMotion, cluster: &Cluster, seed: u64) -> Option<PartMotion> {
    let origin = centroid(base, cluster)?;
    let motions = relative_motion::measure(base, cluster, &origin, seed);
    let segment = relative_motion::largest_connected(&motions, base.camera_from_base.len());
    let reference_frame = best_seen(base, cluster, &segment)?;
    let poses = factor_graph::optimise(&motions, &segment, reference_frame)?;
    let shift = Pose::from_parts(Translation3::from(origin.coords), Default::default());
    let mut base_from_part: Trajectory = vec![None; base.camera_from_base.len()];
    for (&frame, pose) in segment.iter().zip(poses) {
        // `pose` is the motion about the centroid since the reference frame.
        base_from_part[frame] = Some(shift * pose);
    }
    Some(PartMotion { base_from_part, tracks: cluster.tracks.clone() })
}

/// The tracks that follow a motion: in at least 80 % of the frames in which both are known, they
/// are within twice the inlier distance of one place on the part.
pub fn followers(base: &EgoMotion, motion: &PartMotion) -> Vec<usize> {
    let follows = |id: usize| {
        let on_part: Vec<Point3<f64>> = base.tracks[id]
            .seen()
            .filter_map(|(t, p)| Some(motion.base_from_part[t]?.inverse_transform_point(&p.point)))
            .collect();
        let Some(place) = median_point(&on_part) else { return false };
        let near = on_part
            .iter()
            .filter(|p| (*p - place).norm() < 2.0 * relative_motion::INLIER_M)
            .count();
        10 * near >= 8 * on_part.len()
    };
    motion.tracks.iter().copied().filter(|&id| follows(id)).collect()
}

fn centroid(base: &EgoMotion, cluster: &Cluster) -> Option<Point3<f64>> {
    let mut sum = nalgebra::Vector3::zeros();
    let mut count = 0.0;
    for &id in &cluster.tracks {
        for (_, seen) in base.tracks[id].seen() {
            sum += seen.point.coords;
            count += 1.0;
        }
    }
    (count > 0.0).then(|| Point3::from(sum / count))
}

/// The earliest of the frames in which the most tracks of the cluster are seen.
fn best_seen(base: &EgoMotion, cluster: &Cluster, frames: &[usize]) -> Option<usize> {
    let seen =
        |t: usize| cluster.tracks.iter().filter(|&&id| base.tracks[id].at(t).is_some()).count();
    frames.iter().copied().max_by_key(|&t| (seen(t), std::cmp::Reverse(t)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::seen_along;
    use crate::math::rigid::rotation_about;
    use nalgebra::Vector3;

    const FRAMES: usize = 30;

    /// A lid's motion since the first frame: it turns about a hinge 40 cm beside it.
    fn motion(frame: usize) -> Pose {
        let hinge = Point3::new(-0.4, 0.0, 1.5);
        rotation_about(&hinge, &Vector3::y_axis(), 0.03 * frame as f64)
    }

    /// Paths of places on the lid.
    fn lid() -> Vec<Vec<Point3<f64>>> {
        let path = |i: usize| {
            let at = Point3::new(0.1 * (i % 4) as f64, 0.1 * (i / 4) as f64, 1.5);
            (0..FRAMES).map(|f| motion(f) * at).collect()
        };
        (0..12).map(path).collect()
    }

    fn all_of(base: &EgoMotion) -> Cluster {
        Cluster { tracks: (0..base.tracks.len()).collect() }
    }

    #[test]
    fn the_motion_of_a_part_is_that_of_its_places() {
        let (base, paths) = (seen_along(&lid()), lid());
        let found = estimate(&base, &all_of(&base), 1).unwrap();
        let [first, last] = [0, FRAMES - 1].map(|f| found.base_from_part[f].unwrap());
        for path in &paths {
            let led = last * first.inverse() * path[0];
            assert!((led - path[FRAMES - 1]).norm() < 0.006, "{led}");
        }
        assert_eq!(found.tracks.len(), paths.len());
    }

    #[test]
    fn in_its_reference_frame_a_part_has_the_directions_of_the_base_and_its_centroid_as_origin() {
        let base = seen_along(&lid());
        let found = estimate(&base, &all_of(&base), 1).unwrap();
        let reference = found.base_from_part[0].unwrap();
        let centroid = centroid(&base, &all_of(&base)).unwrap();
        assert!(reference.rotation.angle() < 1e-6);
        assert!((reference.translation.vector - centroid.coords).norm() < 1e-6);
    }

    #[test]
    fn few_tracks_and_none_have_no_trajectory() {
        let base = seen_along(&lid());
        assert!(estimate(&base, &Cluster { tracks: Vec::new() }, 1).is_none());
        assert!(estimate(&base, &Cluster { tracks: vec![0, 1] }, 1).is_none());
    }

    #[test]
    fn a_track_that_departs_from_the_motion_does_not_follow_it() {
        let mut paths = lid();
        let away = |f: usize| Point3::new(0.1 + 0.01 * f as f64, 0.1, 1.5);
        paths.push((0..FRAMES).map(away).collect());
        let base = seen_along(&paths);
        let base_from_part = (0..FRAMES).map(|f| Some(motion(f))).collect();
        let motion = PartMotion { base_from_part, tracks: all_of(&base).tracks };
        assert_eq!(followers(&base, &motion), (0..12).collect::<Vec<_>>());
    }

    #[test]
    fn nothing_follows_a_motion_that_is_never_known() {
        let base = seen_along(&lid());
        let motion = PartMotion { base_from_part: vec![None; FRAMES], tracks: vec![0, 1, 2] };
        assert!(followers(&base, &motion).is_empty());
    }
}
