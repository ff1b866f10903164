//! Tests whether a hinge is attached to something. The hinge of a door, a lid or a lever is held by
//! a surface near its line, or its line is hidden. A person who leans turns about a line in free
//! space, or about a line outside the images. A part around its line, like the seat of a swivel
//! chair with its backrest, is held at one end of the line.
//!
//! In: the line of a hinge, points of its part, and the keyframes; metres.
//! Out: the share (0 to 1) of the line, over all keyframes, that is in free space or outside the
//! image; for a part around its line, the share of that end which is held better.
//! From: measured on rendered demonstrations. At most 1 % of a true hinge's line had no surface
//! near it; a leaning trunk's line had none at all. Of a swivel chair's line 73 % was in the air,
//! between the armrests.

use super::free_space::{Probe, probe_point};
use super::recording::Recording;
use crate::math::rigid::{Pose, orthonormal_basis};
use crate::object::joint_geometry::JointGeometry;
use linkage_frames::RgbdFrame;
use nalgebra::{Point3, Vector3};
use std::f64::consts::{PI, TAU};

/// Largest share of a hinge's line that may be in free space or outside the images.
pub const MAX_UNATTACHED: f64 = 0.4;
/// Number of places on the line that are tested in each keyframe.
const PLACES: usize = 11;
/// Number of places at one end of the line; one end is enough to hold a part that lies around its line.
const END_PLACES: usize = 3;
/// Smallest distance from the line of a point that counts for the side on which the part lies, metres.
const ASIDE_M: f64 = 0.05;
/// Smallest share of a part's points in each half space beside a line that the part surrounds.
const SHARE_BESIDE: f64 = 0.05;
/// Number of half spaces beside a line that are tested.
const DIRECTIONS: usize = 16;
/// Largest difference in depth between a place on the line and a surface that supports it, metres:
/// half the thickness of furniture.
const NEAR_M: f64 = 0.12;
/// Distance beside a place, parallel to the image, at which a surface that rests in the frame of the
/// line supports it too, metres: the hinge of a thing that hangs at a wall is at the border of that
/// thing.
const BESIDE_M: f64 = 0.025;
/// Largest share of the keyframes that may see through a surface that rests.
const MAX_THROUGH: f64 = 0.1;

/// Share of the places on a hinge's line, over all keyframes, that are in free space or outside the
/// image; 0 without `points`. If the points surround the line, only its better held end counts. The
/// places lie along the part, from the 10th to the 90th percentile of `points`, which are on the
/// part in the frame of the line. `camera_from_line` is the pose of that frame at a frame of the
/// recording; what holds the line rests in it, as a seat does that carries its back along.
pub fn unattached_ratio(
    line: &JointGeometry,
    points: &[Point3<f64>],
    recording: &Recording,
    camera_from_line: impl Fn(usize) -> Pose,
) -> f64 {
    let mut along: Vec<f64> = points.iter().map(|p| line.axis.dot(&(p - line.origin))).collect();
    along.sort_by(f64::total_cmp);
    if along.is_empty() {
        return 0.0;
    }
    let [low, high] = [along[along.len() / 10], along[along.len() * 9 / 10]];
    let places: Vec<Point3<f64>> = (0..PLACES)
        .map(|k| low + (high - low) * k as f64 / (PLACES - 1) as f64)
        .map(|along| line.origin + line.axis.into_inner() * along)
        .collect();
    let views: Vec<(&RgbdFrame, Pose)> = recording
        .keyframes
        .iter()
        .map(|(frame, picture)| (picture, camera_from_line(frame)))
        .collect();
    // For each place, the number of keyframes in which it is unattached.
    let mut unattached = [0; PLACES];
    for (picture, pose) in &views {
        let stays = |p: &Point3<f64>| stays(&pose.inverse_transform_point(p), &views);
        for (count, place) in unattached.iter_mut().zip(&places) {
            *count += usize::from(is_unattached(picture, &(pose * place), stays));
        }
    }
    let keyframes = views.len().max(1);
    let share = |of: &[usize]| of.iter().sum::<usize>() as f64 / (of.len() * keyframes) as f64;
    if surrounds(points, line) {
        share(&unattached[..END_PLACES]).min(share(&unattached[PLACES - END_PLACES..]))
    } else {
        share(&unattached)
    }
}

/// True if points of a part lie on all sides of a line: each half space beside the line holds some of them.
fn surrounds(points: &[Point3<f64>], line: &JointGeometry) -> bool {
    let (x_axis, y_axis) = orthonormal_basis(&line.axis);
    let angles: Vec<f64> = points
        .iter()
        .map(|p| p - line.origin)
        .map(|d| [d.dot(&x_axis), d.dot(&y_axis)])
        .filter(|[x, y]| x.hypot(*y) > ASIDE_M)
        .map(|[x, y]| y.atan2(x))
        .collect();
    let beyond = |from: f64| {
        angles.iter().filter(|a| (0.0..PI).contains(&(**a - from).rem_euclid(TAU))).count()
    };
    let directions = (0..DIRECTIONS).map(|i| TAU * i as f64 / DIRECTIONS as f64);
    directions.map(beyond).all(|n| n as f64 > SHARE_BESIDE * points.len() as f64)
}

/// True if the place is outside the image, or if only free space is seen at it and no surface that
/// rests beside it.
fn is_unattached(
    picture: &RgbdFrame,
    in_camera: &Point3<f64>,
    stays: impl Fn(&Point3<f64>) -> bool,
) -> bool {
    let camera = &picture.camera;
    // The point that the image shows at the pixel of `p`: `None` outside the image, `Some(None)`
    // without a reading.
    let shown = |p: &Point3<f64>| {
        let px = camera.project(p).filter(|px| camera.sees(px, 3.0))?;
        let reading = |z: f32| camera.back_project(px.x, px.y, f64::from(z));
        Some(picture.depth.at_nearest(px.x, px.y).map(reading))
    };
    let Some(at_place) = shown(in_camera) else { return true };
    let beside = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
        .map(|(x, y)| in_camera + Vector3::new(x, y, 0.0) * BESIDE_M);
    let holds = |p: &Point3<f64>| {
        let is_near = |r: &Point3<f64>| (r.z - p.z).abs() <= NEAR_M;
        shown(p).flatten().filter(is_near).is_some_and(|r| stays(&r))
    };
    at_place.is_some_and(|r| r.z > in_camera.z + NEAR_M) && !beside.iter().any(holds)
}

/// True if at most `MAX_THROUGH` of the keyframes see through the point, which rests in the frame of
/// the line.
fn stays(in_line: &Point3<f64>, views: &[(&RgbdFrame, Pose)]) -> bool {
    let sees_through = |(picture, pose): &&(&RgbdFrame, Pose)| {
        probe_point(picture, &(pose * in_line)) == Probe::Through
    };
    views.iter().filter(sees_through).count() as f64 <= MAX_THROUGH * views.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::EgoMotion;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::tracking::TrackSet;
    use crate::test_data::{board, seen};
    use nalgebra::UnitVector3;

    /// A recording of these pictures by a camera that rests.
    fn recording_of(pictures: impl Iterator<Item = RgbdFrame>) -> Recording {
        let pictures: Vec<RgbdFrame> = pictures.collect();
        let mut keyframes = Keyframes::new(pictures.len());
        pictures.iter().enumerate().for_each(|(f, picture)| keyframes.offer(f, picture));
        let camera_from_base = vec![Pose::identity(); pictures.len()];
        let ego_motion = EgoMotion { camera_from_base, ..EgoMotion::default() };
        Recording { tracks: TrackSet::default(), ego_motion, keyframes }
    }

    /// Unattached share of an upright line at `x`, `z`, before a board with a side of half a metre
    /// at 2 m and a wall at 4 m.
    fn unattached_at(x: f64, z: f64) -> f64 {
        let recording = recording_of((0..3).map(|f| seen(f, board(0.25, 2.0, 4.0))));
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(x, 0.0, z));
        let points: Vec<Point3<f64>> =
            (0..10).map(|k| Point3::new(0.0, 0.02 * f64::from(k) - 0.1, 2.0)).collect();
        unattached_ratio(&line, &points, &recording, |_| Pose::identity())
    }

    #[test]
    fn a_line_on_a_surface_or_behind_it_is_attached() {
        assert_eq!(unattached_at(0.2, 2.05), 0.0);
        assert_eq!(unattached_at(0.2, 3.0), 0.0, "hidden: nothing is known");
    }

    #[test]
    fn a_line_at_the_border_of_what_stands_before_a_wall_is_attached() {
        assert_eq!(unattached_at(0.27, 2.0), 0.0);
        assert_eq!(unattached_at(0.29, 2.0), 1.0);
    }

    #[test]
    fn a_line_in_the_air_or_outside_the_pictures_is_not() {
        assert_eq!(unattached_at(0.0, 1.5), 1.0);
        assert_eq!(unattached_at(9.0, 2.0), 1.0);
    }

    #[test]
    fn a_line_at_the_border_of_what_carries_it_is_attached() {
        // A board with a line at its border moves 0.1 m to the left from each keyframe to the next.
        let moved = |f: usize| -0.1 * f as f64;
        let depth = board(0.25, 2.0, 4.0);
        let picture = |f: usize| seen(f as i64, |x, y| depth(x - 0.5 * moved(f), y));
        let recording = recording_of((0..5).map(picture));
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.27, 0.0, 2.0));
        let points: Vec<Point3<f64>> =
            (0..10).map(|k| Point3::new(0.0, 0.02 * f64::from(k) - 0.1, 2.0)).collect();
        let unattached = |camera_from_line: &dyn Fn(usize) -> Pose| {
            unattached_ratio(&line, &points, &recording, camera_from_line)
        };
        let carried = |f: usize| Pose::translation(moved(f), 0.0, 0.0);
        assert_eq!(unattached(&carried), 0.0);
        assert!(unattached(&|_| Pose::identity()) > MAX_UNATTACHED, "the board leaves the line");
    }

    #[test]
    fn a_part_around_its_line_is_held_at_one_end_of_it() {
        // A swivel chair: its seat lies 0.1 m below the middle of the line, its backrest behind the line.
        let line = JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.0, 0.0, 2.0));
        let seat = (0..40)
            .map(|k| 0.16 * f64::from(k))
            .map(|a| Point3::new(0.2 * a.cos(), 0.1, 2.0 + 0.2 * a.sin()));
        let backrest = (0..20).map(|k| Point3::new(0.02 * f64::from(k) - 0.2, -0.3, 2.2));
        let chair: Vec<Point3<f64>> = seat.chain(backrest).collect();
        assert!(surrounds(&chair, &line));
        let beside: Vec<Point3<f64>> = chair.iter().map(|p| p + Vector3::x() * 0.3).collect();
        assert!(!surrounds(&beside, &line), "a door lies on one side of its line");
        // Only the seat holds the line: above it is air.
        let picture = seen(0, |_, y| if y * 2.0 > 0.06 { 2.0 } else { 4.0 });
        let recording = recording_of(std::iter::once(picture));
        let unattached = |points: &[Point3<f64>]| {
            unattached_ratio(&line, points, &recording, |_| Pose::identity())
        };
        assert!(unattached(&chair) < MAX_UNATTACHED, "{}", unattached(&chair));
        assert!(unattached(&beside) > MAX_UNATTACHED, "{}", unattached(&beside));
    }

    #[test]
    fn a_part_without_points_says_nothing() {
        let recording = recording_of(std::iter::empty());
        let axis = UnitVector3::new_normalize(Vector3::y());
        let line = JointGeometry::hinge(axis, Point3::origin());
        assert_eq!(unattached_ratio(&line, &[], &recording, |_| Pose::identity()), 0.0);
    }
}
