//! Computes where the moving parts are: their points at rest, and the volume that they sweep.
//!
//! In: a demonstration with the pose of each part (camera_from_part), and keyframes.
//! Out: points in the object frame at configuration 0, metres; occupied cells of the object frame.
//! From: radius outlier removal for the points.

use super::occupancy::Occupancy;
use super::part_labels::{PosedFrame, belongs};
use crate::learn::demonstration::Demonstration;
use crate::math::robust::without_isolated;
use nalgebra::Point3;

/// Radius in which an inlier has at least `STRAY_NEIGHBOURS` other points, metres.
const STRAY_M: f64 = 0.08;
/// Fewest other points near an inlier, if there are many points.
const STRAY_NEIGHBOURS: usize = 4;
/// Of few points, an inlier has one near neighbour per this many points: with four neighbours, all seven features
/// along a mini oven's handle were outliers.
const STRAY_SHARE: usize = 4;

/// Points of a part at configuration 0, object frame: the first posed observation of each track, and the plane of a
/// plain part. The hand that moves the part moves with it, so track points that the keyframes contradict are left
/// out.
pub fn tracked_points(
    demonstration: &Demonstration,
    posed: &[PosedFrame],
    part: usize,
) -> Vec<Point3<f64>> {
    let poses = &demonstration.camera_from_part;
    let of_tracks = demonstration
        .tracks
        .tracks
        .iter()
        .zip(&demonstration.track_parts)
        .filter(|(_, p)| **p == Some(part))
        .filter_map(|(track, _)| {
            track.lifted().find_map(|(f, p)| {
                let at_rest = poses[part][f]?.inverse_transform_point(&p);
                Some((at_rest, poses[0][f]?.inverse_transform_point(&p)))
            })
        })
        .collect::<Vec<_>>();
    let belonging = of_tracks
        .iter()
        .filter(|(at_rest, in_base)| belongs(posed, part, at_rest, in_base))
        .map(|(at_rest, _)| *at_rest)
        .chain(demonstration.plain_surface[part].iter().copied())
        .collect::<Vec<_>>();
    // One outlier would make the room around it part of the object.
    let neighbours = STRAY_NEIGHBOURS.min(belonging.len() / STRAY_SHARE);
    let kept = without_isolated(&belonging, STRAY_M, neighbours);
    let (tracks, belong, keep) = (of_tracks.len(), belonging.len(), kept.len());
    tracing::debug!(part, tracks, belong, keep, "points of a moving part");
    kept
}

/// Median depth of the moving parts' features and plain surfaces when first seen, metres; 1 if there are none.
pub fn object_distance(demonstration: &Demonstration) -> f64 {
    let plain = demonstration.camera_from_part.iter().zip(&demonstration.plain_surface);
    let of_plain = plain.filter_map(|(poses, places)| {
        let pose = poses.iter().flatten().next()?;
        Some(places.iter().map(move |p| (pose * p).z))
    });
    let mut depths: Vec<f64> = demonstration
        .tracks
        .tracks
        .iter()
        .zip(&demonstration.track_parts)
        .filter(|(_, p)| p.is_some_and(|p| p > 0))
        .filter_map(|(track, _)| track.lifted().next().map(|(_, p)| p.z))
        .chain(of_plain.flatten())
        .collect();
    crate::math::robust::median(&mut depths).unwrap_or(1.0)
}

/// The volume that the moving parts passed through, in the object frame; `tracked`: points of each part at
/// configuration 0.
pub fn swept_volume(demonstration: &Demonstration, tracked: &[Vec<Point3<f64>>]) -> Occupancy {
    let frames = demonstration.frame_utimes.len();
    let mut points = Vec::new();
    for f in (0..frames).step_by(4) {
        let Some(camera_from_object) = demonstration.camera_from_part[0][f] else { continue };
        for (part, at_rest) in tracked.iter().enumerate().skip(1) {
            if let Some(pose) = demonstration.camera_from_part[part][f] {
                let object_from_part = camera_from_object.inverse() * pose;
                points.extend(at_rest.iter().map(|p| object_from_part * p));
            }
        }
    }
    Occupancy::new(points.into_iter())
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{FRAMES, demonstration, front, part_poses, picture};
    use super::*;
    use linkage_frames::RgbdFrame;

    fn tracked(demonstration: &Demonstration) -> Vec<Point3<f64>> {
        let frames: Vec<RgbdFrame> = (0..FRAMES).map(picture).collect();
        let poses = part_poses();
        let posed: Vec<PosedFrame> = frames
            .iter()
            .enumerate()
            .map(|(f, frame)| PosedFrame {
                frame,
                number: f,
                camera_from_part: vec![poses[0][f], poses[1][f]],
            })
            .collect();
        tracked_points(demonstration, &posed, 1)
    }

    #[test]
    fn the_points_of_a_part_are_those_of_its_tracks_at_rest() {
        let mut places = front();
        places.push((Point3::new(0.1, 0.1, 1.5), None));
        places.push((Point3::new(0.1, 0.05, 1.5), Some(0)));
        let points = tracked(&demonstration(&places));
        assert_eq!(points.len(), 12, "neither the base's nor nobody's");
        assert!(points.iter().all(|p| (p.z - 1.5).abs() < 1e-9));
    }

    #[test]
    fn the_hand_that_pulls_it_and_what_is_far_from_all_others_are_none_of_it() {
        let mut places = front();
        // The pictures show no surface where the hand would be, and a lone point on the front.
        places.push((Point3::new(0.05, 0.05, 1.3), Some(1)));
        places.push((Point3::new(-0.19, -0.19, 1.5), Some(1)));
        assert_eq!(tracked(&demonstration(&places)).len(), 12);
    }

    #[test]
    fn few_points_along_a_handle_are_kept() {
        let along = |k: i32| Point3::new(-0.18 + 0.06 * f64::from(k), 0.0, 1.5);
        let places: Vec<_> = (0..7).map(|k| (along(k), Some(1))).collect();
        assert_eq!(tracked(&demonstration(&places)).len(), 7);
    }

    #[test]
    fn a_plain_part_has_the_points_of_its_plane() {
        let mut plain = demonstration(&[]);
        plain.plain_surface[1] = front().iter().map(|(p, _)| *p).collect();
        assert_eq!(tracked(&plain).len(), 12);
        assert!((object_distance(&plain) - 1.5).abs() < 1e-9);
    }

    #[test]
    fn an_object_is_as_far_as_the_middle_one_of_its_parts_points_when_first_seen() {
        let mut places = front();
        places.push((Point3::new(0.0, 0.0, 9.0), Some(0)));
        places.push((Point3::new(0.0, 0.0, 9.0), None));
        assert!((object_distance(&demonstration(&places)) - 1.5).abs() < 1e-9);
        assert_eq!(object_distance(&demonstration(&[])), 1.0, "of nothing");
    }

    #[test]
    fn a_drawer_sweeps_what_lies_on_its_way_and_nothing_else() {
        let points: Vec<Point3<f64>> = front().iter().map(|(p, _)| *p).collect();
        let swept = swept_volume(&demonstration(&[]), &[vec![Point3::new(9.0, 0.0, 0.0)], points]);
        for way in [0.0, 0.08, 0.24] {
            assert!(swept.holds(&Point3::new(0.03, 0.03, 1.5 - way)), "{way} m on its way");
        }
        assert!(
            !swept.holds(&Point3::new(0.03, 0.03, 1.0))
                && !swept.holds(&Point3::new(0.4, 0.0, 1.5))
        );
        assert!(!swept.holds(&Point3::new(9.0, 0.0, 0.0)), "the base does not move");
    }
}
