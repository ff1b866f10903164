//! Where the moving parts are: their points at rest, and the volume that they sweep.

use super::occupancy::Occupancy;
use super::part_labels::{PosedFrame, belongs};
use crate::learn::demonstration::Demonstration;
use crate::math::robust::without_isolated;
use nalgebra::Point3;

/// A point is an outlier unless `STRAY_NEIGHBOURS` others lie this near, metres.
const STRAY_M: f64 = 0.08;
const STRAY_NEIGHBOURS: usize = 4;

/// Points of a part at configuration 0: of its tracks from their first posed observation, and of its
/// plane where it is a plain part. The hand that moves the part moves with it, so points that the
/// keyframes contradict are left out.
pub fn tracked_points(
    demonstration: &Demonstration,
    posed: &[PosedFrame],
    part: usize,
) -> Vec<Point3<f64>> {
    let poses = &demonstration.camera_from_part;
    let points = demonstration
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
        .filter(|(at_rest, in_base)| belongs(posed, part, at_rest, in_base))
        .map(|(at_rest, _)| at_rest)
        .chain(demonstration.plain_surface[part].iter().copied())
        .collect::<Vec<_>>();
    // One outlier would make the room around it part of the object.
    without_isolated(&points, STRAY_M, STRAY_NEIGHBOURS)
}

/// Median depth of the moving parts' features and plain surfaces, metres.
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

/// All that the moving parts passed through, in the object frame; `tracked`: points of each part at
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
