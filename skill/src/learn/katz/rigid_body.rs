//! Groups moving features into rigid bodies, and estimates the motion of each body.
//!
//! In: tracks in the base frame, metres.
//! Out: bodies, each with its tracks and its motion in the base frame.
//! From: Katz et al. 2013, as the paper describes it.

use crate::learn::ego_motion::{EgoMotion, TrackInBase};
use crate::learn::tracking::Trajectory;
use crate::math::rigid::{Pose, rigid_fit};
use nalgebra::Point3;

/// Largest change of the distance between two features of one body over their common frames,
/// metres.
const MAX_DISTANCE_CHANGE_M: f64 = 0.025;
/// Smallest number of frames that two features, or two bodies, must share.
pub const MIN_COMMON_FRAMES: usize = 10;
/// Smallest number of features of a body.
const MIN_FEATURES: usize = 10;
/// Smallest extent of the path of a body's feature, metres; what moves less is background.
const MIN_MOTION_M: f64 = 0.05;

/// A rigid body.
pub struct Body {
    /// Indices of the tracks on the body.
    pub tracks: Vec<usize>,
    /// Motion of the body in the base frame since the first frame in which it is known.
    pub base_from_body: Trajectory,
    /// Features of the body, carried back to the first frame in which it is known; base frame,
    /// metres.
    pub points: Vec<Point3<f64>>,
}

/// Groups moving features, starting with the one that is seen in the most frames: each takes all
/// features that keep their distance to it. The largest group comes first.
pub fn cluster(base: &EgoMotion) -> Vec<Vec<usize>> {
    let seen = |t: usize| base.tracks[t].points.iter().flatten().count();
    let mut left: Vec<usize> = (0..base.tracks.len())
        .filter(|&t| base.tracks[t].moves && extent(&base.tracks[t]) > MIN_MOTION_M)
        .collect();
    left.sort_by_key(|&t| std::cmp::Reverse(seen(t)));
    let mut bodies = Vec::new();
    while let Some(&seed) = left.first() {
        let (body, rest): (Vec<usize>, Vec<usize>) = left
            .into_iter()
            .partition(|&t| t == seed || keep_distance(&base.tracks[seed], &base.tracks[t]));
        left = rest;
        if body.len() >= MIN_FEATURES {
            bodies.push(body);
        }
    }
    bodies.sort_by_key(|b| std::cmp::Reverse(b.len()));
    bodies
}

fn extent(track: &TrackInBase) -> f64 {
    crate::math::robust::extent(track.points.iter().flatten().map(|p| p.point.coords))
}

fn at(track: &TrackInBase, frame: usize) -> Option<Point3<f64>> {
    let point = track.points.get(frame.checked_sub(track.first_frame)?)?;
    Some(point.as_ref()?.point)
}

fn keep_distance(a: &TrackInBase, b: &TrackInBase) -> bool {
    let from = a.first_frame.max(b.first_frame);
    let to = (a.first_frame + a.points.len()).min(b.first_frame + b.points.len());
    let distances: Vec<f64> =
        (from..to).filter_map(|f| Some((at(a, f)? - at(b, f)?).norm())).collect();
    let low = distances.iter().copied().fold(f64::INFINITY, f64::min);
    let high = distances.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    distances.len() >= MIN_COMMON_FRAMES && high - low < MAX_DISTANCE_CHANGE_M
}

impl Body {
    /// Estimates the motion of a body from frame to frame by least squares over its features;
    /// `None` if fewer than three are seen together in enough frames. The motion ends at its first
    /// gap.
    pub fn follow(base: &EgoMotion, tracks: Vec<usize>) -> Option<Self> {
        let frames = base.camera_from_base.len();
        let mut base_from_body: Trajectory = vec![None; frames];
        let mut pose: Option<Pose> = None;
        for f in 1..frames {
            let (before, now): (Vec<_>, Vec<_>) = tracks
                .iter()
                .filter_map(|&t| Some((at(&base.tracks[t], f - 1)?, at(&base.tracks[t], f)?)))
                .unzip();
            let step = (before.len() >= 3)
                .then(|| rigid_fit(&before, &now, &vec![1.0; before.len()]))
                .flatten();
            match (pose, step) {
                (None, Some(step)) => {
                    base_from_body[f - 1] = Some(Pose::identity());
                    pose = Some(step);
                }
                (Some(since), Some(step)) => pose = Some(step * since),
                (Some(_), None) => break,
                (None, None) => continue,
            }
            base_from_body[f] = pose;
        }
        let first = base_from_body.iter().position(Option::is_some)?;
        let points: Vec<Point3<f64>> = tracks
            .iter()
            .filter_map(|&t| {
                let track = &base.tracks[t];
                let frame = track.first_frame.max(first);
                Some(
                    base_from_body
                        .get(frame)?
                        .as_ref()?
                        .inverse_transform_point(&at(track, frame)?),
                )
            })
            .collect();
        let known = base_from_body.iter().flatten().count();
        (known >= MIN_COMMON_FRAMES && points.len() >= 3).then_some(Self {
            tracks,
            base_from_body,
            points,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::{BaseObservation, Information};
    use nalgebra::Vector3;
    use std::sync::Arc;

    const FRAMES: usize = 30;

    /// This many features in a row, each where `place` says in each frame.
    fn features(
        count: usize,
        place: impl Fn(usize, usize) -> Point3<f64>,
    ) -> Vec<Arc<TrackInBase>> {
        let information = Information::new(&Vector3::z(), 0.001, 0.001);
        let seen = |p| Some(BaseObservation::new(p, information, 0.001));
        let track = |i: usize| {
            let points = (0..FRAMES).map(|f| seen(place(i, f))).collect();
            Arc::new(TrackInBase { points, moves: true, ..TrackInBase::default() })
        };
        (0..count).map(track).collect()
    }

    fn motion(tracks: Vec<Arc<TrackInBase>>) -> EgoMotion {
        EgoMotion { camera_from_base: vec![Pose::identity(); FRAMES], tracks, static_count: 0 }
    }

    fn row(i: usize) -> f64 {
        0.02 * i as f64
    }

    #[test]
    fn features_that_keep_their_distance_are_a_body() {
        let right = |i, f| Point3::new(row(i) + 0.01 * f as f64, 0.0, 1.0);
        let up = |i, f| Point3::new(row(i), 0.5 + 0.01 * f as f64, 1.0);
        let all = [features(14, right), features(12, up)].concat();
        let bodies = cluster(&motion(all));
        assert_eq!(bodies, [(0..14).collect::<Vec<_>>(), (14..26).collect::<Vec<_>>()]);
    }

    #[test]
    fn few_features_and_what_stays_are_no_body() {
        let moves = |i, f| Point3::new(row(i) + 0.01 * f as f64, 0.0, 1.0);
        let stays = |i, _| Point3::new(row(i), 0.7, 1.0);
        let all = [features(MIN_FEATURES - 1, moves), features(20, stays)].concat();
        assert!(cluster(&motion(all)).is_empty());
    }

    #[test]
    fn a_body_is_followed_by_the_motion_of_its_features() {
        let hinge = Pose::new(Vector3::new(0.002, 0.0, 0.0), Vector3::y() * 0.01);
        let place = |i: usize, f: usize| {
            let start = Point3::new(row(i), 0.03 * (i % 3) as f64, 1.0);
            (0..f).fold(start, |p, _| hinge * p)
        };
        let base = motion(features(12, place));
        let body = Body::follow(&base, (0..12).collect()).unwrap();
        let last = body.base_from_body[FRAMES - 1].unwrap();
        let expected = (1..FRAMES).fold(Pose::identity(), |pose, _| hinge * pose);
        assert!((last.inverse() * expected).translation.vector.norm() < 1e-9);
        assert_eq!(body.points.len(), 12);
    }
}
