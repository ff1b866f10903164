//! Finds planes of the room in which the demonstration took place: floor, table, wall. They extend far from the
//! moving parts, and do not belong to the object.
//!
//! In: the first keyframe, of a camera that is held upright, with its pose, and the swept volume of the moving parts
//! (object frame).
//! Out: planes in the object frame, metres.
//! From: sequential RANSAC; a hypothesis is one point with its normal.

use super::occupancy::Occupancy;
use super::part_labels::PosedFrame;
use crate::learn::free_space::{Probe, probe_point};
use crate::math::rigid::{Pose, plane_through};
use linkage_frames::RgbdFrame;
use linkage_frames::depth::{DepthSensor, NormalMap};
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Distance from the swept volume beyond which more than two fifths of a room plane's samples lie, metres.
const ROOM_CLEARANCE_M: f64 = 0.2;
/// Distance from the swept volume beyond which more than a tenth of a table's samples lie, metres, if it is within
/// the image: a table is large, a foot under a seat is not.
const ROOM_REACH_M: f64 = 0.5;
/// Smallest cosine between the normal of a table and the upward direction of the image, for cameras that look down by
/// less than 60 degrees. The front of a tall cabinet is as large as a table, but faces forwards.
const FACES_UPWARDS: f64 = 0.5;
/// Smallest area of a support beyond [`ROOM_CLEARANCE_M`] of the swept volume, square metres. A support faces upwards
/// and lies below all that moved: the table on which a safe stands. A quarter of a table of 0.8 m by 0.6 m.
const SUPPORT_AREA_M2: f64 = 0.12;
/// How far the swept volume may reach below a support, metres: one cell of the swept volume.
const BELOW_SUPPORT_M: f64 = 0.04;
/// Largest share of the swept volume that may lie farther below a support; a hand passes below a table's edge.
const SHARE_BELOW_SUPPORT: f64 = 0.05;
/// How far a room plane extends beyond its samples, metres: samples are some centimetres apart, and more at a distance.
const EXTENT_M: f64 = 0.12;
/// Fewest samples among which a plane is searched for.
const MIN_SAMPLES: usize = 150;
/// Fewest samples of a plane.
const MIN_ON_PLANE: usize = 120;
/// Number of hypotheses that are tried for each plane.
const HYPOTHESES: usize = 80;
/// Fewest samples at the image border of a plane that leaves the image.
const MIN_BORDER_SAMPLES: usize = 4;
/// Distance between samples, pixels.
const SAMPLE_STEP: usize = 6;
/// Smallest cosine between a normal and the direction of view by which the area of a sample is computed; at a flatter
/// angle depth has no normal that can be trusted.
const LEAST_FACING: f64 = 0.2;
/// Width of the strip along the image border whose samples lie at the border, pixels.
const BORDER_PX: usize = 16;

/// Planes of the room, in the object frame.
#[derive(Default)]
pub struct Room {
    /// Planes, each with the cells near its samples.
    planes: Vec<(Plane, Occupancy)>,
    /// The keyframe that shows the planes, and its pose (camera_from_object).
    view: Option<(RgbdFrame, Pose)>,
}

impl Room {
    /// True if a point in the object frame, seen at depth `z`, metres, lies on a plane of the room. Where the keyframe
    /// shows a point, the plane must have samples near it: the plane of a box's front that stands askew crosses the
    /// front of a cabinet.
    pub fn holds(&self, p: &Point3<f64>, z: f64) -> bool {
        let mut on = self.planes.iter().filter(|(plane, _)| plane.holds(p, z)).peekable();
        on.peek().is_some() && (!self.shows(p) || on.any(|(_, extent)| extent.holds(p)))
    }

    /// True if the keyframe shows surface or free space at a point. False behind a person, and outside the image.
    fn shows(&self, p: &Point3<f64>) -> bool {
        self.view.as_ref().is_some_and(|(frame, camera_from_object)| {
            probe_point(frame, &camera_from_object.transform_point(p)) != Probe::Unknown
        })
    }
}

/// A plane in the object frame.
struct Plane {
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

/// A surface sample in the object frame.
struct Sample {
    point: Point3<f64>,
    normal: Vector3<f64>,
    /// Depth at which the sample was measured, metres.
    z: f64,
    /// Area that the sample stands for, square metres.
    area: f64,
    /// True if the sample lies at the image border.
    at_border: bool,
}

/// Surface samples of a keyframe.
fn surface_samples(frame: &RgbdFrame, camera_from_object: &Pose) -> Vec<Sample> {
    let normals = NormalMap::new(&frame.depth, &frame.camera);
    let mut samples = Vec::new();
    let (width, height) = (frame.camera.width, frame.camera.height);
    let near_border = |x: usize, side: usize| x < BORDER_PX || x + BORDER_PX >= side;
    for v in (0..height).step_by(SAMPLE_STEP) {
        for u in (0..width).step_by(SAMPLE_STEP) {
            let (Some(p), Some(n)) = (frame.point_at(u, v), normals.at(u, v)) else { continue };
            if p.z < 3.5 {
                let facing = n.normal.dot(&p.coords.normalize()).abs().max(LEAST_FACING);
                let side = SAMPLE_STEP as f64 * p.z / frame.camera.fx;
                samples.push(Sample {
                    area: side * side / facing,
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
pub fn room_planes(first: Option<&PosedFrame>, swept: &Occupancy) -> Room {
    let Some((first, camera_from_object)) =
        first.and_then(|first| Some((first, first.camera_from_part[0]?)))
    else {
        return Room::default();
    };
    let camera = &first.frame.camera;
    let up = camera_from_object.inverse_transform_vector(&-Vector3::y());
    let mut left = surface_samples(first.frame, &camera_from_object);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut planes = Vec::new();
    for _ in 0..8 {
        let Some(plane) = largest_plane(&left, camera.depth_sensor, &mut rng) else { break };
        let (on, off): (Vec<_>, Vec<_>) = left.into_iter().partition(|s| plane.carries(s));
        left = off;
        let faces_upwards = plane.normal.dot(&up) > FACES_UPWARDS;
        if leads_away(&on, swept, faces_upwards) || faces_upwards && supports(&plane, &on, swept) {
            let extent = Occupancy::new(on.iter().map(|s| s.point)).grown(EXTENT_M);
            planes.push((plane, extent));
        }
    }
    Room { planes, view: Some((first.frame.clone(), camera_from_object)) }
}

/// The plane with most of the samples; `None` if few samples lie on one plane.
fn largest_plane(left: &[Sample], sensor: DepthSensor, rng: &mut ChaCha8Rng) -> Option<Plane> {
    if left.len() < MIN_SAMPLES {
        return None;
    }
    let mut best: (usize, Option<Plane>) = (0, None);
    let mut order: Vec<usize> = (0..left.len()).collect();
    order.partial_shuffle(rng, HYPOTHESES);
    for &i in order.iter().rev().take(HYPOTHESES) {
        let plane = Plane { normal: left[i].normal, through: left[i].point, sensor };
        let count = left.iter().filter(|s| plane.carries(s)).count();
        if count > best.0 {
            best = (count, Some(plane));
        }
    }
    let (count, plane) = best;
    // The normal of one pixel is noisy, so the plane is fitted to its inliers, twice.
    plane.filter(|_| count >= MIN_ON_PLANE).map(|p| refitted(&refitted(&p, left), left))
}

/// True if a plane is the room's: many of its samples are far from the swept volume, and the plane leaves the image,
/// or faces upwards and reaches very far.
fn leads_away(plane: &[Sample], swept: &Occupancy, faces_upwards: bool) -> bool {
    let beyond = |distance: f64| {
        plane.iter().filter(|s| swept.is_far_from(&s.point, distance)).count() as f64
            / plane.len() as f64
    };
    let leaves = plane.iter().filter(|s| s.at_border).count() >= MIN_BORDER_SAMPLES;
    beyond(ROOM_CLEARANCE_M) > 0.4 && (leaves || faces_upwards && beyond(ROOM_REACH_M) > 0.1)
}

/// True if a plane that faces upwards supports the object: it lies below all that moved, and a large area of it is far
/// from there. [`leads_away`] does not find a table most of which is near what moved.
fn supports(plane: &Plane, on: &[Sample], swept: &Occupancy) -> bool {
    let beyond = on.iter().filter(|s| swept.is_far_from(&s.point, ROOM_CLEARANCE_M));
    let is_below = |c: &Point3<f64>| plane.normal.dot(&(c - plane.through)) < -BELOW_SUPPORT_M;
    let below = swept.centres().filter(is_below).count();
    beyond.map(|s| s.area).sum::<f64>() > SUPPORT_AREA_M2
        && below as f64 <= SHARE_BELOW_SUPPORT * swept.0.len() as f64
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
    use crate::test_data::{board, seen};

    /// What moved, 10 cm around this depth in the middle of the picture.
    fn moved_at(z: f64) -> Occupancy {
        let side = || (-2..=2).map(|i| 0.05 * f64::from(i));
        Occupancy::new(side().flat_map(move |x| side().map(move |y| Point3::new(x, y, z))))
    }

    fn planes(frame: &RgbdFrame, pose: Option<Pose>, swept: &Occupancy) -> Room {
        let posed = PosedFrame { frame, number: 0, camera_from_part: vec![pose] };
        room_planes(Some(&posed), swept)
    }

    #[test]
    fn a_wall_that_leaves_the_picture_is_the_rooms_however_near_what_moved_is() {
        let wall = seen(0, |_, _| 2.0);
        for near in [1.0, 1.9] {
            let room = planes(&wall, Some(Pose::identity()), &moved_at(near));
            assert_eq!(room.planes.len(), 1);
            assert!(room.holds(&Point3::new(0.5, -0.3, 2.0), 2.0));
            assert!(!room.holds(&Point3::new(0.5, -0.3, 1.8), 1.8));
        }
    }

    #[test]
    fn a_plate_near_what_moved_is_the_objects() {
        let plate = seen(0, board(0.2, 1.0, 4.0));
        assert!(planes(&plate, Some(Pose::identity()), &moved_at(0.98)).planes.is_empty());
    }

    #[test]
    fn the_front_of_a_tall_cabinet_within_the_picture_is_the_objects_and_a_table_is_the_rooms() {
        // What moved lies 0.6 m beside the middle of a plate that is 1.2 m wide.
        let aside = |z: f64| Occupancy::new(std::iter::once(Point3::new(-0.55, 0.0, z)));
        let front = seen(0, board(0.6, 1.6, 4.0));
        assert!(planes(&front, Some(Pose::identity()), &aside(1.6)).planes.is_empty());
        // A table 0.5 m below the camera, from 1.3 to 2.2 m away and within the image.
        let table = seen(0, |x, y| {
            let z = 0.5 / y;
            if (1.3..2.2).contains(&z) && (z * x).abs() < 0.6 { z } else { f64::NAN }
        });
        let on_table = Occupancy::new(std::iter::once(Point3::new(0.0, 0.45, 1.4)));
        assert_eq!(planes(&table, Some(Pose::identity()), &on_table).planes.len(), 1);
    }

    #[test]
    fn the_table_below_what_moved_is_the_rooms_though_most_of_it_is_near() {
        // A table 0.5 m below the camera, from 1.0 to 1.9 m away and within the image.
        let table = seen(0, |x, y| {
            let z = 0.5 / y;
            if (1.0..1.9).contains(&z) && (z * x).abs() < 0.7 { z } else { f64::NAN }
        });
        let moved_down_to = |lowest: f64| {
            let places = |from: f64, to: f64| {
                (0..).map(move |i| from + 0.04 * f64::from(i)).take_while(move |p| *p < to)
            };
            let above = places(-0.35, 0.35).flat_map(|x| places(1.2, 1.7).map(move |z| [x, z]));
            Occupancy::new(
                above.flat_map(|[x, z]| places(0.3, lowest).map(move |y| Point3::new(x, y, z))),
            )
        };
        let planes_with =
            |lowest| planes(&table, Some(Pose::identity()), &moved_down_to(lowest)).planes.len();
        assert_eq!(planes_with(0.48), 1);
        assert_eq!(planes_with(0.8), 0, "what moves below a plane does not stand on it");
    }

    #[test]
    fn the_planes_of_a_corner_are_told_apart() {
        // A wall 2 m away, and a floor 0.6 m below the camera.
        let corner = seen(0, |_, y| if y > 0.3 { 0.6 / y } else { 2.0 });
        let room = planes(&corner, Some(Pose::identity()), &moved_at(1.0));
        assert_eq!(room.planes.len(), 2);
        assert!(room.holds(&Point3::new(0.2, 0.6, 1.5), 1.5), "floor");
        assert!(room.holds(&Point3::new(0.2, 0.1, 2.0), 2.0), "wall");
        assert!(!room.holds(&Point3::new(0.2, 0.3, 1.5), 1.5), "between");
    }

    #[test]
    fn a_plane_ends_where_its_samples_end_unless_it_is_hidden_there() {
        // A wall in the left half of the image with a board before it; the right half shows something farther away.
        let half = seen(0, |x, y| match x {
            x if (-0.4..-0.2).contains(&x) && y.abs() < 0.2 => 1.2,
            x if x < 0.0 => 2.0,
            _ => 3.6,
        });
        let room = planes(&half, Some(Pose::identity()), &moved_at(1.0));
        assert!(room.holds(&Point3::new(-0.2, 0.0, 2.0), 2.0));
        assert!(!room.holds(&Point3::new(0.5, 0.0, 2.0), 2.0), "in its plane, and free space");
        assert!(room.holds(&Point3::new(-0.6, 0.0, 2.0), 2.0), "behind the board");
        assert!(room.holds(&Point3::new(1.5, 0.0, 2.0), 2.0), "outside the image");
    }

    #[test]
    fn planes_are_in_the_object_frame() {
        let camera_from_object = Pose::translation(0.0, 0.0, 0.5);
        let wall = seen(0, |_, _| 2.0);
        let room = planes(&wall, Some(camera_from_object), &moved_at(0.5));
        assert!(room.holds(&Point3::new(0.0, 0.0, 1.5), 2.0));
        assert!(!room.holds(&Point3::new(0.0, 0.0, 2.0), 2.0));
    }

    #[test]
    fn without_a_keyframe_a_pose_or_a_reading_there_is_no_room() {
        let swept = moved_at(1.0);
        assert!(room_planes(None, &swept).planes.is_empty());
        assert!(planes(&seen(0, |_, _| 2.0), None, &swept).planes.is_empty());
        assert!(
            planes(&seen(0, |_, _| f64::NAN), Some(Pose::identity()), &swept).planes.is_empty()
        );
        assert!(!Room::default().holds(&Point3::origin(), 1.0));
    }
}
