//! Finds flat pieces of moving surface in each keyframe: places that other keyframes see through. A plane is divided
//! by the episode in which its samples move, because closed doors and drawers share one front.
//!
//! In: depth images of the keyframes and the pose of the camera.
//! Out: plane patches, base frame, metres.
//! From: sequential RANSAC; a hypothesis is one sample with its normal.

use crate::learn::ego_motion::EgoMotion;
use crate::learn::episodes::{AwayKeyframes, episodes};
use crate::learn::recording::Recording;
use crate::math::rigid::{distance_to_line, matrix_pose, plane_through};
use crate::object::joint_geometry::JointGeometry;
use linkage_frames::RgbdFrame;
use linkage_frames::depth::{DepthSensor, SurfacePatch};
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use rayon::prelude::*;

/// Distance between samples, pixels.
#[derive(Debug, Clone, Copy)]
pub enum Sampling {
    /// For a surface that faces the camera.
    Coarse = 8,
    /// For a surface seen at a grazing angle.
    Fine = 4,
}

/// Fewest samples of a plane.
const MIN_SAMPLES: usize = 40;
/// Most planes in one keyframe; each may be divided into several patches.
const MAX_PATCHES: usize = 4;
/// Fewest samples of a patch: the piece of a plane that moves in one episode.
const MIN_OF_EPISODE: usize = 20;
/// Most hypotheses that are tried for each plane.
const TRIES: usize = 40;
/// Most samples that vote for a hypothesis.
const VOTERS: usize = 400;
/// Smallest cosine of the angle between a sample's normal and its plane's.
const SAME_NORMAL: f64 = 0.97;
/// Largest sine of the angle between a line and a sample of a plane that could turn about it: the error of the plane
/// plus that of the sample's normal.
const MAX_TILT: f64 = 0.37;
/// Most keyframes that decide whether a place moves.
const MOST_ASKED: usize = 48;
/// Smallest share of the keyframes that must see through a moving place: a door that is opened for two seconds of a
/// demonstration of fifteen is in three of 37 keyframes.
const MOVING_SHARE: f64 = 0.08;
/// Fewest keyframes that must see through a moving place.
const FEWEST_THROUGH: usize = 3;
/// Fewest of the eight neighbours of a moving sample that must move as well: noise of a wall far away is scattered.
const MOVING_NEIGHBOURS: usize = 3;

/// A flat piece of moving surface in one keyframe, base frame.
#[derive(Debug, Clone)]
pub struct PlanePatch {
    /// Frame number.
    pub frame: usize,
    /// Unit normal, towards the camera.
    pub normal: Vector3<f64>,
    /// Distance of the plane from the origin along the normal, metres.
    pub offset: f64,
    /// Samples on the plane, metres.
    pub points: Vec<Point3<f64>>,
}

#[derive(Clone, Copy)]
struct Sample {
    point: Point3<f64>,
    normal: Vector3<f64>,
}

/// Cylinder in which planes about a line may lie.
pub struct Cylinder {
    /// Axis of the cylinder, base frame.
    pub line: JointGeometry,
    /// Radius of the cylinder, metres.
    pub radius: f64,
}

impl Cylinder {
    fn holds(&self, point: &Point3<f64>) -> bool {
        distance_to_line(&self.line.origin, &self.line.axis, point) < self.radius
    }

    fn may_turn(&self, normal: &Vector3<f64>) -> bool {
        normal.dot(&self.line.axis).abs() < MAX_TILT
    }
}

/// Flat pieces of surface that are elsewhere in other keyframes. If a cylinder is given, only those in it that could
/// turn about its line.
pub fn moving_patches(
    recording: &Recording,
    sampling: Sampling,
    cylinder: Option<&Cylinder>,
) -> Vec<PlanePatch> {
    let pictures: Vec<(usize, &RgbdFrame)> = recording.keyframes.iter().collect();
    let base = &recording.ego_motion;
    let stride = pictures.len().div_ceil(MOST_ASKED).max(1);
    let asked: Vec<(usize, &RgbdFrame)> = pictures.iter().copied().step_by(stride).collect();
    pictures
        .par_iter()
        .flat_map_iter(|&(frame, picture)| {
            let others = seen_from(frame, &asked, base);
            let is_wanted = |in_camera: &Point3<f64>, in_base: &Point3<f64>| {
                cylinder.is_none_or(|c| c.holds(in_base)) && moves(in_camera, &others)
            };
            let mut samples = samples(picture, base, frame, sampling, is_wanted);
            samples.retain(|s| cylinder.is_none_or(|c| c.may_turn(&s.normal)));
            let camera_from_base = matrix_pose(&base.camera_from_base[frame]);
            let away = |s: &Sample| away_keyframes(&(camera_from_base * s.point), &others);
            let episodes =
                |of_plane: &[Sample]| episodes(&of_plane.iter().map(away).collect::<Vec<_>>());
            patches(samples, frame, picture.camera.depth_sensor, episodes)
        })
        .collect()
}

fn samples(
    picture: &RgbdFrame,
    base: &EgoMotion,
    frame: usize,
    sampling: Sampling,
    is_wanted: impl Fn(&Point3<f64>, &Point3<f64>) -> bool,
) -> Vec<Sample> {
    let (depth, camera) = (&picture.depth, &picture.camera);
    let base_from_camera = base.camera_from_base[frame].inverse();
    let stride = sampling as usize;
    let (columns, rows) = (depth.width().div_ceil(stride), depth.height().div_ceil(stride));
    let pixel = |i: usize| (i % columns * stride, i / columns * stride);
    let wanted: Vec<bool> = (0..columns * rows)
        .map(|i| {
            let (u, v) = pixel(i);
            let reading = f64::from(depth.as_metres()[v * depth.width() + u]);
            let in_camera = camera.back_project(u as f64, v as f64, reading);
            !reading.is_nan() && is_wanted(&in_camera, &(base_from_camera * in_camera))
        })
        .collect();
    (0..columns * rows)
        .filter(|&i| wanted[i] && neighbours(&wanted, columns, i) >= MOVING_NEIGHBOURS)
        .filter_map(|i| {
            let (u, v) = pixel(i);
            let surface = SurfacePatch::at(depth, camera, u, v)?;
            let point = base_from_camera * camera.back_project(u as f64, v as f64, surface.z);
            Some(Sample { point, normal: base_from_camera * surface.normal })
        })
        .collect()
}

/// Number of a grid cell's eight neighbours that are set.
fn neighbours(grid: &[bool], columns: usize, cell: usize) -> usize {
    let (column, row) = (cell % columns, cell / columns);
    let rows = row.saturating_sub(1)..(row + 2).min(grid.len() / columns);
    let set = |r: usize| {
        let from = r * columns + column.saturating_sub(1);
        let to = r * columns + (column + 2).min(columns);
        grid[from..to].iter().filter(|set| **set).count()
    };
    rows.map(set).sum::<usize>() - usize::from(grid[cell])
}

/// Another keyframe, relative to the current one.
struct Other<'k> {
    picture: &'k RgbdFrame,
    /// Maps points from the current camera frame to that of the other keyframe.
    other_from_camera: IsometryMatrix3<f64>,
}

fn seen_from<'k>(
    frame: usize,
    pictures: &[(usize, &'k RgbdFrame)],
    base: &EgoMotion,
) -> Vec<Other<'k>> {
    let base_from_camera = base.camera_from_base[frame].inverse();
    pictures
        .iter()
        .map(|&(other, picture)| {
            let other_from_camera = matrix_pose(&(base.camera_from_base[other] * base_from_camera));
            Other { picture, other_from_camera }
        })
        .collect()
}

/// True if enough other keyframes see something behind the place.
fn moves(in_camera: &Point3<f64>, others: &[Other]) -> bool {
    let mut needed = ((MOVING_SHARE * others.len() as f64).ceil() as usize).max(FEWEST_THROUGH);
    for (i, Other { picture, other_from_camera }) in others.iter().enumerate() {
        if needed > others.len() - i {
            return false;
        }
        needed -= usize::from(sees_through(picture, &(other_from_camera * in_camera)));
        if needed == 0 {
            return true;
        }
    }
    false
}

/// The other keyframes that see something behind the place, as bits.
fn away_keyframes(in_camera: &Point3<f64>, others: &[Other]) -> AwayKeyframes {
    let through = |(bit, other): (usize, &Other)| {
        AwayKeyframes::from(sees_through(other.picture, &(other.other_from_camera * in_camera)))
            << bit
    };
    others.iter().enumerate().map(through).sum()
}

/// True if an image shows something behind a place in its camera frame.
fn sees_through(picture: &RgbdFrame, p: &Point3<f64>) -> bool {
    let camera = &picture.camera;
    let shown = camera.project(p).filter(|px| camera.sees(px, 1.0));
    let reading = shown.and_then(|px| picture.depth.at_nearest(px.x, px.y));
    let behind = p.z + 0.03 + 2.0 * camera.depth_sensor.feature_sigma(p.z);
    reading.is_some_and(|z| f64::from(z) > behind)
}

/// Removes planes from the samples, the largest first. `episodes` determines in which episode each sample of a plane
/// moves.
fn patches(
    mut samples: Vec<Sample>,
    frame: usize,
    sensor: DepthSensor,
    episodes: impl Fn(&[Sample]) -> Vec<usize>,
) -> Vec<PlanePatch> {
    let mut found = Vec::new();
    for _ in 0..MAX_PATCHES {
        let on = |s: &Sample, plane: &Sample| {
            plane.normal.dot(&s.normal) > SAME_NORMAL
                && plane.normal.dot(&(s.point - plane.point)).abs()
                    < 0.01 + sensor.feature_sigma(s.point.coords.norm())
        };
        let votes = |plane: &Sample| some_of(&samples, VOTERS).filter(|s| on(s, plane)).count();
        let Some(&plane) = some_of(&samples, TRIES).max_by_key(|plane| votes(plane)) else { break };
        let (of_plane, rest): (Vec<Sample>, Vec<Sample>) =
            samples.into_iter().partition(|s| on(s, &plane));
        if of_plane.len() < MIN_SAMPLES {
            break;
        }
        samples = rest;
        found.extend(pieces(&of_plane, &episodes(&of_plane), frame));
    }
    found
}

/// The pieces of a plane whose samples move in different episodes.
fn pieces(
    samples: &[Sample],
    episodes: &[usize],
    frame: usize,
) -> impl Iterator<Item = PlanePatch> {
    let last = episodes.iter().copied().max().unwrap_or(0);
    (0..=last).filter_map(move |episode| {
        let of_it = samples.iter().zip(episodes).filter(|(_, e)| **e == episode);
        let of_it: Vec<Sample> = of_it.map(|(s, _)| *s).collect();
        (of_it.len() >= MIN_OF_EPISODE).then(|| fitted(frame, &of_it))
    })
}

/// At most `most` of the samples, evenly spread.
fn some_of(samples: &[Sample], most: usize) -> impl Iterator<Item = &Sample> {
    samples.iter().step_by(samples.len().div_ceil(most).max(1))
}

fn fitted(frame: usize, samples: &[Sample]) -> PlanePatch {
    PlanePatch::through(samples.iter().map(|s| s.point).collect(), frame, &samples[0].normal)
}

impl PlanePatch {
    /// The least-squares plane through some points, with its normal on the side of `towards`.
    pub fn through(points: Vec<Point3<f64>>, frame: usize, towards: &Vector3<f64>) -> Self {
        let (mean, mut normal) = plane_through(&points);
        if normal.dot(towards) < 0.0 {
            normal = -normal;
        }
        Self { frame, normal, offset: normal.dot(&mean.coords), points }
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{HINGE_M, door_recording, turn};
    use super::*;

    /// Samples of a square piece of surface, `side` samples to a side, 2 cm apart.
    fn square(side: usize, centre: Point3<f64>, normal: Vector3<f64>) -> Vec<Sample> {
        let (u, v) = crate::math::rigid::orthonormal_basis(&normal);
        let off = |i: usize| 0.02 * (i as f64 - 0.5 * (side as f64 - 1.0));
        let at =
            |i: usize| Sample { point: centre + u * off(i % side) + v * off(i / side), normal };
        (0..side * side).map(at).collect()
    }

    fn patches_of(samples: Vec<Sample>) -> Vec<PlanePatch> {
        patches(samples, 3, DepthSensor::default(), |of_plane| vec![0; of_plane.len()])
    }

    #[test]
    fn a_box_gives_a_plane_for_each_of_its_faces_the_largest_first() {
        let (front, side) = (-Vector3::z(), Vector3::x());
        let mut samples = square(8, Point3::new(0.5, 0.0, 2.2), side);
        samples.extend(square(14, Point3::new(0.0, 0.0, 2.0), front));
        let found = patches_of(samples);
        assert_eq!(found.iter().map(|p| p.points.len()).collect::<Vec<_>>(), [196, 64]);
        assert!((found[0].normal - front).norm() < 1e-6 && (found[0].offset + 2.0).abs() < 1e-6);
        assert!((found[1].normal - side).norm() < 1e-6 && (found[1].offset - 0.5).abs() < 1e-6);
        assert!(found.iter().all(|p| p.frame == 3));
    }

    #[test]
    fn the_door_and_the_drawer_of_one_front_are_two_pieces_where_they_open_one_after_the_other() {
        let front = square(16, Point3::new(0.0, 0.0, 2.0), -Vector3::z());
        let episode = |s: &Sample| usize::from(s.point.y > 0.04);
        let episodes = |of_plane: &[Sample]| of_plane.iter().map(episode).collect();
        let found = patches(front, 3, DepthSensor::default(), episodes);
        assert_eq!(found.len(), 2);
        let [door, drawer] = [0, 1].map(|k| &found[k].points);
        assert_eq!(door.len() + drawer.len(), 256);
        assert!(door.iter().all(|p| p.y < 0.04) && drawer.iter().all(|p| p.y > 0.04));
    }

    #[test]
    fn faces_that_are_parallel_at_two_depths_are_two_planes() {
        let at = |z| square(8, Point3::new(0.0, 0.0, z), -Vector3::z());
        assert_eq!(patches_of(at(1.0).into_iter().chain(at(1.3)).collect()).len(), 2);
    }

    #[test]
    fn what_has_few_samples_is_no_plane() {
        let few = square(6, Point3::new(0.0, 0.0, 2.0), -Vector3::z());
        assert!(few.len() < MIN_SAMPLES && patches_of(few).is_empty());
        assert!(patches_of(Vec::new()).is_empty());
    }

    #[test]
    fn a_plane_faces_the_side_that_it_is_told() {
        let points = || {
            square(5, Point3::new(0.0, 0.0, 2.0), Vector3::z()).iter().map(|s| s.point).collect()
        };
        for side in [1.0, -1.0] {
            let plane = PlanePatch::through(points(), 0, &Vector3::new(0.2, 0.0, side));
            assert!((plane.normal - Vector3::z() * side).norm() < 1e-9);
            assert!((plane.offset - 2.0 * side).abs() < 1e-9);
        }
    }

    #[test]
    fn the_planes_of_a_door_that_opens_are_found_with_its_turn() {
        let found = moving_patches(&door_recording(24, turn), Sampling::Coarse, None);
        let of_door = |frame: usize| {
            let normal = Vector3::new(-turn(frame).sin(), 0.0, -turn(frame).cos());
            let hinge = Vector3::new(HINGE_M[0], 0.0, HINGE_M[1]);
            found.iter().any(|p| {
                p.frame == frame
                    && p.normal.dot(&normal) > 0.998
                    && (p.offset - normal.dot(&hinge)).abs() < 0.02
            })
        };
        // Beyond, the door is seen from its edge.
        let frames: Vec<usize> = (0..24).filter(|f| (0.3..1.0).contains(&turn(*f))).collect();
        let missed: Vec<&usize> = frames.iter().filter(|f| !of_door(**f)).collect();
        assert!(frames.len() > 4 && missed.is_empty(), "{missed:?}");
    }

    #[test]
    fn nothing_is_found_of_a_door_that_stands_still() {
        let still = door_recording(24, |_| 0.7);
        assert!(moving_patches(&still, Sampling::Coarse, None).is_empty());
    }

    #[test]
    fn about_a_line_only_what_is_near_it_and_could_turn_about_it_counts() {
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(1.0, 0.0, 2.0));
        let cylinder = Cylinder { line, radius: 0.3 };
        assert!(cylinder.holds(&Point3::new(1.2, 5.0, 2.0)), "however far along the line");
        assert!(!cylinder.holds(&Point3::new(1.2, 0.0, 2.3)));
        assert!(cylinder.may_turn(&Vector3::x()) && !cylinder.may_turn(&Vector3::y()));
        let far = Cylinder { line, radius: 0.01 };
        let door = door_recording(24, turn);
        assert!(moving_patches(&door, Sampling::Coarse, Some(&far)).is_empty());
    }

    #[test]
    fn a_cell_has_as_many_neighbours_as_are_set_around_it() {
        let all = [true; 9];
        assert_eq!(
            [neighbours(&all, 3, 4), neighbours(&all, 3, 0), neighbours(&all, 3, 5)],
            [8, 3, 5]
        );
        assert_eq!(neighbours(&[true], 1, 0), 0);
        let mut alone = [false; 9];
        alone[4] = true;
        assert_eq!([neighbours(&alone, 3, 4), neighbours(&alone, 3, 0)], [0, 1]);
    }

    #[test]
    fn some_are_taken_evenly_and_never_more_than_asked_for() {
        let all = square(10, Point3::origin(), Vector3::z());
        for most in [1, 7, 40, 1000] {
            let taken = some_of(&all, most).count();
            assert!(taken <= most && taken > 0 && taken >= most.min(100) / 2);
        }
        assert_eq!(some_of(&[], 5).count(), 0);
    }

    #[test]
    fn a_place_that_no_other_keyframe_shows_does_not_move() {
        assert!(!moves(&Point3::new(0.0, 0.0, 1.0), &[]));
    }
}
