//! Features of one frame, spread over the picture, described twice: by a patch of the picture, and
//! by one of metric size on the surface's tangent plane, each turned to its own direction. Depth
//! makes viewpoint and scale known, so they are used. What is up is not: on what lies level no
//! direction is, and a camera rolls.

use super::gradients::{Patch, Pyramid, directions, gradients};
use super::keypoints::{Keypoint, ScaleSpace};
use crate::vision::Gray;
use linkage_driver::RgbdFrame;
use linkage_driver::depth::NormalMap;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};

/// Values in a descriptor.
pub const DESCRIPTOR_LENGTH: usize = 128;

/// How a feature was described; only equal kinds are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FeatureKind {
    /// Oriented RootSIFT in the picture.
    Picture,
    /// Upright RootSIFT of the patch rectified to the surface: in stores of earlier versions, no
    /// longer compared.
    Upright,
    /// Oriented RootSIFT of the patch rectified to the surface.
    Rectified,
}

/// How many features a cell of the picture may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureSpread {
    /// For an encounter.
    Query,
    /// For a model: more, views of one point are merged later.
    Model,
}

/// A described feature in the camera frame.
#[derive(Debug, Clone)]
pub struct DescribedFeature {
    /// How it was described.
    pub kind: FeatureKind,
    /// Pixel.
    pub pixel: [f32; 2],
    /// Place in the camera frame; `None` without depth.
    pub point: Option<Point3<f64>>,
    /// Unit normal; zero where unknown.
    pub normal: Vector3<f64>,
    /// Diameter in metres; in pixels where there is no depth.
    pub size: f64,
    /// RootSIFT, a unit vector.
    pub descriptor: [f32; DESCRIPTOR_LENGTH],
}

/// Side of a cell, pixels.
const CELL_PX: f32 = 40.0;
/// Lowest contrast, grey levels: weak features where nothing else is.
const CONTRAST: f32 = 0.68;
/// Half width of a patch in sigmas of its feature.
const PATCH_SIGMAS: f64 = 3.2;
/// Levels of the picture from which patches are sampled, each half as large as the last.
const LEVELS: usize = 5;

/// Where features of a frame are, before depth is asked.
pub struct Keypoints {
    gray: Gray,
    found: Vec<Spot>,
}

/// A keypoint with one of its directions.
#[derive(Clone, Copy)]
struct Spot {
    pixel: [f32; 2],
    /// Diameter, pixels.
    size: f32,
    /// Degrees from right to down.
    angle: f32,
}

impl Keypoints {
    /// Finds them where `wanted` says so (by pixel).
    ///
    /// # Errors
    /// Whatever the vision library says.
    pub fn new(
        frame: &RgbdFrame,
        spread: FeatureSpread,
        wanted: impl Fn(usize, usize) -> bool,
    ) -> opencv::Result<Self> {
        let gray = Gray::from_color(&frame.color)?;
        let found = detect(&gray, spread, wanted)?;
        Ok(Self { gray, found })
    }

    /// Describes them, both ways.
    ///
    /// # Errors
    /// Whatever the vision library says.
    pub fn describe(
        &self,
        frame: &RgbdFrame,
        normals: &NormalMap,
    ) -> opencv::Result<Vec<DescribedFeature>> {
        let pyramid = Pyramid::new(&self.gray, LEVELS)?;
        let surfaces: Vec<(&Spot, Surface)> =
            self.found.iter().map(|s| (s, Surface::at(frame, normals, s.pixel))).collect();
        let focal = frame.camera.fx;
        let in_picture: Vec<Asked> =
            surfaces.iter().map(|(spot, surface)| in_picture(spot, surface, focal)).collect();
        let mut seen = HashSet::new();
        let upright: Vec<Asked> = surfaces
            .iter()
            // One place and size may carry several orientations: once is enough here.
            .filter(|(s, _)| {
                seen.insert([s.pixel[0], s.pixel[1], s.size].map(|x| (x * 4.0) as i32))
            })
            .filter_map(|(spot, surface)| upright(spot, surface, frame))
            .collect();
        let rectified = upright.par_iter().flat_map_iter(|asked| {
            let angles = directions(&pyramid, &asked.patch);
            angles.map(|angle| Asked { patch: asked.patch.turned(angle), ..asked.clone() })
        });
        let described = |asked: Asked| DescribedFeature {
            descriptor: gradients(&pyramid, &asked.patch),
            ..asked.feature
        };
        Ok(in_picture.into_par_iter().chain(rectified).map(described).collect())
    }
}

fn detect(
    gray: &Gray,
    spread: FeatureSpread,
    wanted: impl Fn(usize, usize) -> bool,
) -> opencv::Result<Vec<Spot>> {
    let per_cell = match spread {
        FeatureSpread::Query => 22,
        FeatureSpread::Model => 50,
    };
    let space = ScaleSpace::new(gray)?;
    let mut cells: BTreeMap<(i32, i32), Vec<Keypoint>> = BTreeMap::new();
    for keypoint in space.keypoints(CONTRAST) {
        let [x, y] = keypoint.pixel;
        let (u, v) = (x.round() as usize, y.round() as usize);
        if wanted(u.min(gray.width() - 1), v.min(gray.height() - 1)) {
            let cell = ((y / CELL_PX) as i32, (x / CELL_PX) as i32);
            cells.entry(cell).or_default().push(keypoint);
        }
    }
    let cells: Vec<Vec<Keypoint>> = cells.into_values().collect();
    let spots_of = |mut cell: Vec<Keypoint>| -> Vec<Spot> {
        cell.sort_by(|a, b| b.response.total_cmp(&a.response));
        cell.truncate(per_cell);
        let spots = cell.iter().flat_map(|k| {
            let Keypoint { pixel, size, .. } = *k;
            space.directions(k).into_iter().map(move |angle| Spot { pixel, size, angle })
        });
        spots.take(per_cell).collect()
    };
    Ok(cells.into_par_iter().map(spots_of).collect::<Vec<_>>().concat())
}

/// A feature but for its descriptor, and the patch of the picture that this is of.
#[derive(Clone)]
struct Asked {
    feature: DescribedFeature,
    patch: Patch,
}

/// The patch about a feature as it lies in the picture, turned to its orientation.
fn in_picture(spot: &Spot, surface: &Surface, focal: f64) -> Asked {
    let size = f64::from(spot.size);
    let half_width = PATCH_SIGMAS * 0.5 * size;
    let (sin, cos) = f64::from(spot.angle).to_radians().sin_cos();
    Asked {
        patch: Patch {
            centre: spot.pixel.map(f64::from),
            right: [half_width * cos, half_width * sin],
            down: [-half_width * sin, half_width * cos],
        },
        feature: DescribedFeature {
            kind: FeatureKind::Picture,
            pixel: spot.pixel,
            size: surface.point.map_or(size, |p| size * p.z / focal),
            point: surface.point,
            normal: surface.normal.unwrap_or_default(),
            descriptor: [0.0; DESCRIPTOR_LENGTH],
        },
    }
}

/// What depth says of a pixel.
struct Surface {
    point: Option<Point3<f64>>,
    normal: Option<Vector3<f64>>,
}

impl Surface {
    fn at(frame: &RgbdFrame, normals: &NormalMap, pixel: [f32; 2]) -> Self {
        let (u, v) = (f64::from(pixel[0]), f64::from(pixel[1]));
        let patch = normals.at(u.round() as usize, v.round() as usize);
        let z = patch.map(|p| p.z).or_else(|| frame.depth.at_nearest(u, v).map(f64::from));
        Self {
            point: z.map(|z| frame.camera.back_project(u, v, z)),
            normal: patch.map(|p| p.normal),
        }
    }
}

/// The patch about a feature on the tangent plane of its surface, upright; `None` without a
/// surface, or where it is seen from the side.
fn upright(spot: &Spot, surface: &Surface, frame: &RgbdFrame) -> Option<Asked> {
    let (point, normal) = (surface.point?, surface.normal?);
    let slant = -normal.dot(&point.coords.normalize());
    if slant < 0.2 {
        return None;
    }
    let across = (Vector3::x() - normal * normal.x).try_normalize(1e-6)?;
    let mut down = normal.cross(&across);
    if down.y < 0.0 {
        down = -down;
    }
    let camera = &frame.camera;
    let size_m = f64::from(spot.size) * point.z / camera.fx / slant.sqrt();
    let sigma_m = snapped(size_m / 2.0);
    // Pixels that half the patch spans along a tangent.
    let in_pixels = |e: &Vector3<f64>| {
        let e = e * (PATCH_SIGMAS * sigma_m / point.z);
        [camera.fx * (e.x - point.x / point.z * e.z), camera.fy * (e.y - point.y / point.z * e.z)]
    };
    Some(Asked {
        patch: Patch {
            centre: spot.pixel.map(f64::from),
            right: in_pixels(&across),
            down: in_pixels(&down),
        },
        feature: DescribedFeature {
            kind: FeatureKind::Rectified,
            pixel: spot.pixel,
            point: Some(point),
            normal,
            size: 2.0 * sigma_m,
            descriptor: [0.0; DESCRIPTOR_LENGTH],
        },
    })
}

/// The nearest step of a half-octave ladder from 4 mm.
fn snapped(sigma_m: f64) -> f64 {
    let step = (2.0 * (sigma_m / 0.004).log2()).round().clamp(0.0, 8.0);
    0.004 * 2_f64.powf(step / 2.0)
}
