//! Flat pieces of what moves, keyframe by keyframe.

use crate::learn::ego_motion::EgoMotion;
use crate::learn::recording::Recording;
use crate::math::rigid::{distance_to_line, matrix_pose, plane_through};
use crate::object::joint_geometry::JointGeometry;
use linkage_frames::RgbdFrame;
use linkage_frames::depth::{DepthSensor, SurfacePatch};
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use rayon::prelude::*;

/// Pixels between samples.
#[derive(Debug, Clone, Copy)]
pub enum Sampling {
    /// Enough for what faces the camera.
    Coarse = 8,
    /// For what is seen at a grazing angle.
    Fine = 4,
}

/// Fewest samples of a patch.
const MIN_SAMPLES: usize = 40;
/// Patches in one keyframe, at most.
const MAX_PATCHES: usize = 4;
/// Planes that are tried for each patch.
const TRIES: usize = 40;
/// Samples that vote for one of these planes.
const VOTERS: usize = 400;
/// Cosine of the largest angle between a sample's normal and its patch's.
const SAME_NORMAL: f64 = 0.97;
/// Sine of the largest angle between a line and a sample of a plane that could turn about it:
/// what the plane may be off, and the sample from its plane.
const MAX_TILT: f64 = 0.37;
/// Keyframes that are asked what moves.
const MOST_ASKED: usize = 48;
/// Share of them that must see through a place for it to count as moving, and the fewest: a door that is
/// opened for two seconds of a demonstration of fifteen is in three of 37 keyframes.
const MOVING_SHARE: f64 = 0.08;
const FEWEST_THROUGH: usize = 3;
/// Of the eight neighbours of a moving sample so many must move as well: noise of a wall far away is
/// scattered.
const MOVING_NEIGHBOURS: usize = 3;

/// A flat piece in the base frame.
#[derive(Debug, Clone)]
pub struct PlanePatch {
    /// Frame number.
    pub frame: usize,
    /// Unit normal, towards the camera.
    pub normal: Vector3<f64>,
    /// Distance of the plane from the origin along the normal.
    pub offset: f64,
    /// Samples on it.
    pub points: Vec<Point3<f64>>,
}

#[derive(Clone, Copy)]
struct Sample {
    point: Point3<f64>,
    normal: Vector3<f64>,
}

/// Where planes about a line can be.
pub struct Cylinder {
    /// Its middle, base frame.
    pub line: JointGeometry,
    /// Metres.
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

/// Flat pieces of surfaces that are elsewhere in other keyframes; in a cylinder only those that
/// could turn about its line.
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
            patches(samples, frame, picture.camera.depth_sensor)
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

/// How many of the eight neighbours of a cell of a grid are set.
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

/// Another keyframe, as seen from one.
struct Other<'k> {
    picture: &'k RgbdFrame,
    /// From the one's camera to its own.
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

/// Enough others see something behind the place.
fn moves(in_camera: &Point3<f64>, others: &[Other]) -> bool {
    let mut needed = ((MOVING_SHARE * others.len() as f64).ceil() as usize).max(FEWEST_THROUGH);
    for (i, Other { picture, other_from_camera }) in others.iter().enumerate() {
        if needed > others.len() - i {
            return false;
        }
        let p = other_from_camera * in_camera;
        let through = picture
            .camera
            .project(&p)
            .filter(|px| picture.camera.sees(px, 1.0))
            .and_then(|px| picture.depth.at_nearest(px.x, px.y))
            .is_some_and(|z| {
                f64::from(z) > p.z + 0.03 + 2.0 * picture.camera.depth_sensor.feature_sigma(p.z)
            });
        needed -= usize::from(through);
        if needed == 0 {
            return true;
        }
    }
    false
}

/// Takes planes out of the samples, the largest first.
fn patches(mut samples: Vec<Sample>, frame: usize, sensor: DepthSensor) -> Vec<PlanePatch> {
    let mut found = Vec::new();
    while found.len() < MAX_PATCHES && samples.len() >= MIN_SAMPLES {
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
        found.push(fitted(frame, &of_plane));
    }
    found
}

/// At most so many of them, evenly spread.
fn some_of(samples: &[Sample], most: usize) -> impl Iterator<Item = &Sample> {
    samples.iter().step_by(samples.len().div_ceil(most).max(1))
}

fn fitted(frame: usize, samples: &[Sample]) -> PlanePatch {
    PlanePatch::through(samples.iter().map(|s| s.point).collect(), frame, &samples[0].normal)
}

impl PlanePatch {
    /// The plane through some points, its normal to the side of another.
    pub fn through(points: Vec<Point3<f64>>, frame: usize, towards: &Vector3<f64>) -> Self {
        let (mean, mut normal) = plane_through(&points);
        if normal.dot(towards) < 0.0 {
            normal = -normal;
        }
        Self { frame, normal, offset: normal.dot(&mean.coords), points }
    }
}
