//! What distinguishes a part of an object from a hand: it rests, and where the model says
//! that it is, nothing behind it is seen.

use super::ego_motion::{EgoMotion, coarse_sigma, rest_length};
use super::keyframes::Keyframes;
use super::paper::pose_optimisation::PartMotion;
use crate::math::rigid::{Pose, matrix_pose};
use crate::object::joint_geometry::JointGeometry;
use linkage_driver::RgbdFrame;
use nalgebra::Point3;

/// Share of tracks that rest for `frames` observations at the start or the end of their life.
pub fn rests(base: &EgoMotion, tracks: &[usize], frames: usize) -> f64 {
    let resting = tracks
        .iter()
        .filter(|&&id| {
            let path: Vec<_> = base.tracks[id].seen().map(|(_, p)| (p.point, p.sigma())).collect();
            rest_length(path.iter().copied()) >= frames
                || rest_length(path.iter().rev().copied()) >= frames
        })
        .count();
    resting as f64 / tracks.len().max(1) as f64
}

/// What a depth picture says about a point.
#[derive(Clone, Copy, PartialEq)]
enum Probe {
    /// Something behind it was seen.
    Through,
    /// Its surface was seen.
    Agrees,
    /// Hidden, outside, or no reading.
    Unknown,
}

/// Share of a part's points, 0 to 1, that keyframes see *through*: there the claim about where
/// the part is is false. Asked at the known configuration, or else at the one that fits best,
/// which must exist somewhere in the range.
pub fn seen_through(
    base: &EgoMotion,
    keyframes: &Keyframes,
    motion: &PartMotion,
    geometry: &JointGeometry,
    frames: &[usize],
    configuration: &[f64],
) -> f64 {
    let points_at_rest = rest_points(base, motion, geometry, frames, configuration);
    let low = configuration.iter().copied().fold(f64::INFINITY, f64::min);
    let high = configuration.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let pad = 0.25 * (high - low);
    let mut all = FreeSpaceCounts::default();
    for (frame, picture) in keyframes.iter() {
        let probe = |q: f64| {
            count_free_space(
                picture,
                &points_at_rest,
                &(base.camera_from_base[frame] * geometry.motion(q)),
            )
        };
        all.add(match frames.binary_search(&frame) {
            Ok(i) => probe(configuration[i]),
            Err(_) => (0..33)
                .map(|i| probe(low - pad + (high - low + 2.0 * pad) * f64::from(i) / 32.0))
                .max_by_key(|found| found.margin())
                .unwrap_or_default(),
        });
    }
    all.share_through()
}

/// A part's tracked points carried back to configuration 0.
fn rest_points(
    base: &EgoMotion,
    motion: &PartMotion,
    geometry: &JointGeometry,
    frames: &[usize],
    configuration: &[f64],
) -> Vec<Point3<f64>> {
    let stride = (motion.tracks.len() / 120).max(1);
    motion
        .tracks
        .iter()
        .step_by(stride)
        .filter_map(|&id| {
            let at_rest: Vec<Point3<f64>> = base.tracks[id]
                .seen()
                .filter_map(|(t, p)| {
                    let i = frames.binary_search(&t).ok()?;
                    Some(geometry.motion(-configuration[i]) * p.point)
                })
                .collect();
            crate::math::robust::median_point(&at_rest)
        })
        .collect()
}

/// Points of a part that a picture sees through, and those that it finds in their places.
#[derive(Debug, Clone, Copy, Default)]
pub struct FreeSpaceCounts {
    /// Something behind them is seen.
    pub through: usize,
    /// Their surface is seen.
    pub agrees: usize,
}

impl FreeSpaceCounts {
    /// Counts what was found elsewhere, too.
    pub fn add(&mut self, other: Self) {
        self.through += other.through;
        self.agrees += other.agrees;
    }

    /// Points that the pictures tell of.
    pub fn count(self) -> usize {
        self.through + self.agrees
    }

    /// How many more are found than seen through.
    pub fn margin(self) -> i64 {
        self.agrees as i64 - self.through as i64
    }

    /// Share that is seen through.
    pub fn share_through(self) -> f64 {
        self.through as f64 / self.count().max(1) as f64
    }

    /// Hardly ever seen through, of one point in many pictures.
    pub fn mostly_agrees(self) -> bool {
        self.through < 3 || 3 * self.through < self.count()
    }
}

/// What a picture tells of points of a part.
pub fn count_free_space(
    picture: &RgbdFrame,
    points: &[Point3<f64>],
    camera_from_part: &Pose,
) -> FreeSpaceCounts {
    let camera_from_part = matrix_pose(camera_from_part);
    let mut found = FreeSpaceCounts::default();
    for p in points {
        match probe_point(picture, &(camera_from_part * p)) {
            Probe::Through => found.through += 1,
            Probe::Agrees => found.agrees += 1,
            Probe::Unknown => {}
        }
    }
    found
}

fn probe_point(picture: &RgbdFrame, in_camera: &Point3<f64>) -> Probe {
    let Some(pixel) = picture.camera.project(in_camera) else { return Probe::Unknown };
    if !picture.camera.sees(&pixel, 3.0) {
        return Probe::Unknown;
    }
    let (u, v) = ((pixel.x + 0.5) as usize, (pixel.y + 0.5) as usize);
    let (mut nearest, mut farthest) = (f64::INFINITY, 0.0_f64);
    for y in [v - 2, v, v + 2] {
        for x in [u - 2, u, u + 2] {
            if let Some(z) = picture.depth.at(x, y) {
                nearest = nearest.min(f64::from(z));
                farthest = farthest.max(f64::from(z));
            }
        }
    }
    if farthest == 0.0 {
        return Probe::Unknown;
    }
    let margin = 0.02 + 1.5 * coarse_sigma(in_camera.z);
    if nearest > in_camera.z + margin {
        Probe::Through
    } else if farthest < in_camera.z - margin {
        Probe::Unknown
    } else {
        Probe::Agrees
    }
}
