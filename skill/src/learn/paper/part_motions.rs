//! Estimates the motions in a cluster of tracks, without outliers: tracks that do not belong to the
//! motion.
//!
//! In: a cluster of tracks in the base frame, and keyframes with depth; metres.
//! Out: the motions in the cluster, each with its tracks.
//! From: paper, section III-C. The removal of whole tracks is ours.

use super::pose_optimisation;
use super::pose_optimisation::PartMotion;
use super::segmentation::{Cluster, MIN_CLUSTER};
use crate::learn::free_space::{FreeSpaceCounts, count_free_space};
use crate::learn::recording::Recording;
use crate::math::robust::median_point;
use nalgebra::Point3;

/// The motions in a cluster, the clearest first. A hand and the part that it holds move as one for
/// a while, so that a cluster may hold several things: tracks that depart from its motion, or that
/// depth images contradict, are the cluster of the next round.
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

/// Largest number of motions that are sought in one cluster.
const MOTIONS_OF_A_CLUSTER: u64 = 5;

/// Removes tracks that depart from the motion, and tracks that depth images contradict (a hand
/// moves with the part that it holds, but comes and leaves); estimates the motion again from the
/// other tracks.
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

/// Largest number of rounds in which outliers are removed; the motion is clearer after each.
const OUTLIER_ROUNDS: u64 = 3;

/// Tracks whose place on the part is seen through in fewer than three keyframes, or in less than a
/// third of the keyframes that either see through it or show a surface there.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::{BaseObservation, EgoMotion, Information, TrackInBase};
    use crate::learn::keyframes::Keyframes;
    use crate::learn::tracking::TrackSet;
    use crate::math::rigid::Pose;
    use crate::test_data::seen;
    use nalgebra::Vector3;
    use std::sync::Arc;

    const FRAMES: usize = 40;
    /// Tracks of each thing.
    const TRACKS: usize = 12;

    /// A drawer that moves towards the camera by a centimetre per frame; the thing beside it moves
    /// to the left.
    fn place(track: usize, frame: usize) -> Point3<f64> {
        let i = track % TRACKS;
        let at = Vector3::new(0.06 * (i % 4) as f64, 0.06 * (i / 4) as f64, 1.5);
        let moved = 0.01 * frame as f64;
        let beside = Vector3::new(-moved - 0.4, 0.0, 0.0);
        Point3::from(at + if track < TRACKS { Vector3::new(0.0, 0.0, -moved) } else { beside })
    }

    /// Recording of the drawer and of what is beside it, before a wall at this depth; without
    /// keyframes for `None`.
    fn recording(wall: Option<f64>) -> Recording {
        let precision = Information::new(&Vector3::z(), 0.001, 0.001);
        let track = |track| {
            let seen = |f| Some(BaseObservation::new(place(track, f), precision, 0.001));
            let points = (0..FRAMES).map(seen).collect();
            Arc::new(TrackInBase { points, moves: true, ..TrackInBase::default() })
        };
        let mut keyframes = Keyframes::new(FRAMES);
        for f in (0..FRAMES).filter(|_| wall.is_some()) {
            keyframes.offer(f, &seen(f as i64, |_, _| wall.unwrap_or(0.0)));
        }
        Recording {
            tracks: TrackSet { frame_utimes: (0..FRAMES as i64).collect(), tracks: Vec::new() },
            ego_motion: EgoMotion {
                camera_from_base: vec![Pose::identity(); FRAMES],
                tracks: (0..2 * TRACKS).map(track).collect(),
                static_count: 0,
            },
            keyframes,
        }
    }

    fn motions(tracks: std::ops::Range<usize>) -> Vec<PartMotion> {
        motions_of(&recording(None), &Cluster { tracks: tracks.collect() }, 1)
    }

    #[test]
    fn tracks_that_move_as_one_have_one_motion_and_it_is_theirs() {
        let [drawer] = &motions(0..TRACKS)[..] else { panic!("one motion") };
        assert_eq!(drawer.tracks, (0..TRACKS).collect::<Vec<_>>());
        let [first, last] = [0, FRAMES - 1].map(|f| drawer.base_from_part[f].unwrap());
        let moved = last.translation.vector - first.translation.vector;
        assert!((moved - Vector3::new(0.0, 0.0, -0.39)).norm() < 0.005, "{moved}");
        assert!((last.rotation * first.rotation.inverse()).angle() < 0.01);
    }

    #[test]
    fn two_things_in_one_cluster_are_told_apart() {
        let found = motions(0..TRACKS + 7);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].tracks, (0..TRACKS).collect::<Vec<_>>(), "the clearest first");
        assert_eq!(found[1].tracks, (TRACKS..TRACKS + 7).collect::<Vec<_>>());
    }

    #[test]
    fn few_tracks_and_none_have_no_motion() {
        assert!(motions(0..3).is_empty());
        assert!(motions(0..0).is_empty());
    }

    #[test]
    fn tracks_that_the_pictures_see_through_are_contradicted() {
        let drawer = &motions(0..TRACKS)[0];
        let left = |wall| uncontradicted(&recording(wall), drawer, &drawer.tracks).len();
        assert_eq!(left(None), TRACKS, "nothing speaks against them");
        assert_eq!(left(Some(3.0)), 0);
    }
}
