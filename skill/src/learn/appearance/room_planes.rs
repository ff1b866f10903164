//! Finds planes of the room in which the demonstration took place: floor, table, wall. They extend far from the
//! moving parts, and do not belong to the object.
//!
//! In: the first keyframe with the camera's pose, and the swept volume of the moving parts (object frame).
//! Out: planes in the object frame, metres.
//! From: sequential RANSAC; a hypothesis is one point with its normal.

use super::occupancy::Occupancy;
use super::part_labels::PosedFrame;
use crate::math::rigid::plane_through;
use linkage_frames::depth::{DepthSensor, NormalMap};
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Distance from the swept volume beyond which more than two fifths of a room plane's samples lie, metres.
const ROOM_CLEARANCE_M: f64 = 0.2;
/// Distance from the swept volume beyond which more than a tenth of a room plane's samples lie, metres, unless the
/// plane leaves the image: floor, table and wall are large, a foot under a seat is not.
const ROOM_REACH_M: f64 = 0.5;
/// Fewest samples at the image border of a plane that leaves the image.
const MIN_BORDER_SAMPLES: usize = 4;
/// Width of the strip along the image border whose samples lie at the border, pixels.
const BORDER_PX: usize = 16;

/// A plane of the room, in the object frame.
pub struct Plane {
    normal: Vector3<f64>,
    through: Point3<f64>,
    sensor: DepthSensor,
}

impl Plane {
    fn holds(&self, p: &Point3<f64>, z: f64) -> bool {
        self.normal.dot(&(p - self.through)).abs() < 0.012 + 3.0 * self.sensor.reading_sigma(z)
    }

    fn carries(&self, s: &Sample) -> bool {
        self.holds(&s.point, s.z) && s.normal.dot(&self.normal) > 0.93
    }
}

/// True if a point in the object frame, seen at depth `z`, metres, lies on a plane of the room.
pub fn is_room(room: &[Plane], p: &Point3<f64>, z: f64) -> bool {
    room.iter().any(|plane| plane.holds(p, z))
}

/// A surface sample in the object frame.
struct Sample {
    point: Point3<f64>,
    normal: Vector3<f64>,
    /// Depth at which the sample was measured, metres.
    z: f64,
    /// True if the sample lies at the image border.
    at_border: bool,
}

/// Surface samples of a keyframe; none if the camera's pose is not known.
fn surface_samples(posed: &PosedFrame) -> Vec<Sample> {
    let (frame, Some(camera_from_object)) = (posed.frame, posed.camera_from_part[0]) else {
        return Vec::new();
    };
    let normals = NormalMap::new(&frame.depth, &frame.camera);
    let mut samples = Vec::new();
    let (width, height) = (frame.camera.width, frame.camera.height);
    let near_border = |x: usize, side: usize| x < BORDER_PX || x + BORDER_PX >= side;
    for v in (0..height).step_by(6) {
        for u in (0..width).step_by(6) {
            let (Some(p), Some(n)) = (frame.point_at(u, v), normals.at(u, v)) else { continue };
            if p.z < 3.5 {
                samples.push(Sample {
                    point: camera_from_object.inverse_transform_point(&p),
                    normal: camera_from_object.inverse_transform_vector(&n.normal),
                    z: p.z,
                    at_border: near_border(u, width) || near_border(v, height),
                });
            }
        }
    }
    samples
}

/// Planes of the first keyframe that extend far from the swept volume: floor, table, wall.
pub fn room_planes(first: Option<&PosedFrame>, swept: &Occupancy) -> Vec<Plane> {
    let mut left = first.map(surface_samples).unwrap_or_default();
    let sensor = first.map(|posed| posed.frame.camera.depth_sensor).unwrap_or_default();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut planes = Vec::new();
    for _ in 0..8 {
        if left.len() < 150 {
            break;
        }
        let mut best: (usize, Option<Plane>) = (0, None);
        let mut order: Vec<usize> = (0..left.len()).collect();
        order.partial_shuffle(&mut rng, 80);
        for &i in order.iter().rev().take(80) {
            let plane = Plane { normal: left[i].normal, through: left[i].point, sensor };
            let count = left.iter().filter(|s| plane.carries(s)).count();
            if count > best.0 {
                best = (count, Some(plane));
            }
        }
        let (count, Some(plane)) = best else { break };
        if count < 120 {
            break;
        }
        // The normal of one pixel is noisy, so the plane is fitted to its inliers, twice.
        let plane = refitted(&refitted(&plane, &left), &left);
        let (on, off): (Vec<_>, Vec<_>) = left.into_iter().partition(|s| plane.carries(s));
        left = off;
        if leads_away(&on, swept) {
            planes.push(plane);
        }
    }
    planes
}

/// True if a plane is the room's: many of its samples are far from the swept volume, and the plane leaves the image
/// or reaches very far.
fn leads_away(plane: &[Sample], swept: &Occupancy) -> bool {
    let beyond = |distance: f64| {
        plane.iter().filter(|s| swept.is_far_from(&s.point, distance)).count() as f64
            / plane.len() as f64
    };
    let leaves = plane.iter().filter(|s| s.at_border).count() >= MIN_BORDER_SAMPLES;
    beyond(ROOM_CLEARANCE_M) > 0.4 && (leaves || beyond(ROOM_REACH_M) > 0.1)
}

/// The least-squares plane through all samples that lie on the given plane.
fn refitted(plane: &Plane, samples: &[Sample]) -> Plane {
    let on: Vec<Point3<f64>> =
        samples.iter().filter(|s| plane.carries(s)).map(|s| s.point).collect();
    let (through, normal) = plane_through(&on);
    let facing = normal.dot(&plane.normal).signum();
    Plane { normal: normal * facing, through, ..*plane }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::test_data::{board, seen};
    use linkage_frames::RgbdFrame;

    /// What moved, 10 cm around this depth in the middle of the picture.
    fn moved_at(z: f64) -> Occupancy {
        let side = || (-2..=2).map(|i| 0.05 * f64::from(i));
        Occupancy::new(side().flat_map(move |x| side().map(move |y| Point3::new(x, y, z))))
    }

    fn planes(frame: &RgbdFrame, pose: Option<Pose>, swept: &Occupancy) -> Vec<Plane> {
        let posed = PosedFrame { frame, number: 0, camera_from_part: vec![pose] };
        room_planes(Some(&posed), swept)
    }

    #[test]
    fn a_wall_that_leaves_the_picture_is_the_rooms_however_near_what_moved_is() {
        let wall = seen(0, |_, _| 2.0);
        for near in [1.0, 1.9] {
            let room = planes(&wall, Some(Pose::identity()), &moved_at(near));
            assert_eq!(room.len(), 1);
            assert!(is_room(&room, &Point3::new(0.5, -0.3, 2.0), 2.0));
            assert!(!is_room(&room, &Point3::new(0.5, -0.3, 1.8), 1.8));
        }
    }

    #[test]
    fn a_plate_near_what_moved_is_the_objects() {
        let plate = seen(0, board(0.2, 1.0, 4.0));
        assert!(planes(&plate, Some(Pose::identity()), &moved_at(0.98)).is_empty());
    }

    #[test]
    fn the_planes_of_a_corner_are_told_apart() {
        // A wall 2 m away, and a floor 0.6 m below the camera.
        let corner = seen(0, |_, y| if y > 0.3 { 0.6 / y } else { 2.0 });
        let room = planes(&corner, Some(Pose::identity()), &moved_at(1.0));
        assert_eq!(room.len(), 2);
        assert!(is_room(&room, &Point3::new(0.2, 0.6, 1.5), 1.5), "floor");
        assert!(is_room(&room, &Point3::new(0.2, 0.1, 2.0), 2.0), "wall");
        assert!(!is_room(&room, &Point3::new(0.2, 0.3, 1.5), 1.5), "between");
    }

    #[test]
    fn planes_are_in_the_object_frame() {
        let camera_from_object = Pose::translation(0.0, 0.0, 0.5);
        let wall = seen(0, |_, _| 2.0);
        let room = planes(&wall, Some(camera_from_object), &moved_at(0.5));
        assert!(is_room(&room, &Point3::new(0.0, 0.0, 1.5), 2.0));
        assert!(!is_room(&room, &Point3::new(0.0, 0.0, 2.0), 2.0));
    }

    #[test]
    fn without_a_keyframe_a_pose_or_a_reading_there_is_no_room() {
        let swept = moved_at(1.0);
        assert!(room_planes(None, &swept).is_empty());
        assert!(planes(&seen(0, |_, _| 2.0), None, &swept).is_empty());
        assert!(planes(&seen(0, |_, _| f64::NAN), Some(Pose::identity()), &swept).is_empty());
        assert!(!is_room(&[], &Point3::origin(), 1.0));
    }
}
