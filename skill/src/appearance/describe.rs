//! Features of one frame, spread over the picture, described twice: as oriented RootSIFT in
//! the picture, and as a patch resampled on the surface's tangent plane at metric size,
//! upright. Depth makes viewpoint and scale known, so they are used.

use crate::vision::Gray;
use linkage_driver::RgbdFrame;
use linkage_driver::depth::NormalMap;
use nalgebra::{Point3, Vector3};
use opencv::core::{CV_8U, KeyPoint, KeyPointTraitConst, Mat, Size, Vec2f, Vector};
use opencv::features2d::SIFT;
use opencv::imgproc;
use opencv::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Values in a descriptor.
pub const DESCRIPTOR_LENGTH: usize = 128;

/// How a feature was described; only equal kinds are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FeatureKind {
    /// Oriented RootSIFT in the picture.
    Picture,
    /// Upright RootSIFT of the patch rectified to the surface.
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
/// Lowest SIFT contrast: weak features where nothing else is.
const CONTRAST: f64 = 0.008;
/// Side of a rectified patch, pixels.
const PATCH: usize = 40;
/// Half width of a patch in sigmas of its size.
const PATCH_SIGMAS: f64 = 3.2;
/// Size at which the patch's centre is described, patch pixels.
const PATCH_KEYPOINT: f32 = 5.5;

/// Where features of a frame are, before depth is asked.
pub struct Keypoints {
    gray: Gray,
    found: Vec<Spot>,
}

/// A keypoint as threads may share it.
#[derive(Clone, Copy)]
struct Spot {
    pixel: [f32; 2],
    /// Diameter, pixels.
    size: f32,
    /// Degrees.
    angle: f32,
    response: f32,
    octave: i32,
}

impl Spot {
    fn new(k: &KeyPoint) -> Self {
        let p = k.pt();
        Self {
            pixel: [p.x, p.y],
            size: k.size(),
            angle: k.angle(),
            response: k.response(),
            octave: k.octave(),
        }
    }

    fn keypoint(&self, number: usize) -> opencv::Result<KeyPoint> {
        let [x, y] = self.pixel;
        KeyPoint::new_coords(x, y, self.size, self.angle, self.response, self.octave, number as i32)
    }
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
        let (in_picture, rectified) = rayon::join(
            || in_picture(frame, normals, &self.gray, &self.found),
            || rectified(frame, normals, &self.gray, &self.found),
        );
        let mut features = in_picture?;
        features.extend(rectified?);
        Ok(features)
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
    let mut keypoints: Vector<KeyPoint> = Vector::new();
    SIFT::create(0, 3, CONTRAST, 12.0, 1.6)?.detect(
        gray.mat(),
        &mut keypoints,
        &opencv::core::no_array(),
    )?;
    let mut cells: BTreeMap<(i32, i32), Vec<Spot>> = BTreeMap::new();
    for spot in keypoints.iter().map(|k| Spot::new(&k)) {
        let [x, y] = spot.pixel;
        let (u, v) = (x.round() as usize, y.round() as usize);
        if wanted(u.min(gray.width() - 1), v.min(gray.height() - 1)) {
            let cell = ((y / CELL_PX) as i32, (x / CELL_PX) as i32);
            cells.entry(cell).or_default().push(spot);
        }
    }
    Ok(cells
        .into_values()
        .flat_map(|mut cell| {
            cell.sort_by(|a, b| b.response.total_cmp(&a.response));
            cell.truncate(per_cell);
            cell
        })
        .collect())
}

fn in_picture(
    frame: &RgbdFrame,
    normals: &NormalMap,
    gray: &Gray,
    spots: &[Spot],
) -> opencv::Result<Vec<DescribedFeature>> {
    let mut asked: Vector<KeyPoint> = Vector::new();
    for (i, spot) in spots.iter().enumerate() {
        asked.push(spot.keypoint(i)?);
    }
    let rows = compute(gray.mat(), &mut asked)?;
    let mut features = Vec::with_capacity(asked.len());
    for (i, k) in asked.iter().enumerate() {
        let pixel = [k.pt().x, k.pt().y];
        let surface = Surface::at(frame, normals, pixel);
        let size = f64::from(k.size());
        features.push(DescribedFeature {
            kind: FeatureKind::Picture,
            pixel,
            size: surface.point.map_or(size, |p| size * p.z / frame.camera.fx),
            point: surface.point,
            normal: surface.normal.unwrap_or_default(),
            descriptor: root_sift(rows.at_row::<f32>(i as i32)?),
        });
    }
    Ok(features)
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

fn compute(picture: &Mat, keypoints: &mut Vector<KeyPoint>) -> opencv::Result<Mat> {
    let mut rows = Mat::default();
    if !keypoints.is_empty() {
        SIFT::create_def()?.compute(picture, keypoints, &mut rows)?;
    }
    Ok(rows)
}

/// Square root of the L1-normalised descriptor (Arandjelović & Zisserman 2012).
fn root_sift(row: &[f32]) -> [f32; DESCRIPTOR_LENGTH] {
    let sum: f32 = row.iter().sum::<f32>().max(1e-6);
    std::array::from_fn(|i| (row[i] / sum).max(0.0).sqrt())
}

/// A feature about to be rectified.
struct Patch {
    pixel: [f32; 2],
    point: Point3<f64>,
    normal: Vector3<f64>,
    /// Metric sigma, snapped to the ladder.
    sigma_m: f64,
    /// Pixels that a metre along each tangent spans, about the feature.
    tangents_px: [[f64; 2]; 2],
}

fn rectified(
    frame: &RgbdFrame,
    normals: &NormalMap,
    gray: &Gray,
    spots: &[Spot],
) -> opencv::Result<Vec<DescribedFeature>> {
    let mut seen = std::collections::HashSet::new();
    let patches: Vec<Patch> = spots
        .iter()
        // One place and size may carry several orientations: once is enough here.
        .filter(|k| seen.insert([k.pixel[0], k.pixel[1], k.size].map(|x| (x * 4.0) as i32)))
        .filter_map(|k| patch_of(frame, normals, k))
        .collect();
    if patches.is_empty() {
        return Ok(Vec::new());
    }
    let mosaic = mosaic_of(gray, &patches)?;
    let mut asked: Vector<KeyPoint> = Vector::new();
    let centre = 0.5 * (PATCH as f32 - 1.0);
    for i in 0..patches.len() {
        let (column, row) = (i % MOSAIC, i / MOSAIC);
        asked.push(KeyPoint::new_coords(
            (column * PATCH) as f32 + centre,
            (row * PATCH) as f32 + centre,
            PATCH_KEYPOINT,
            0.0,
            0.0,
            0,
            i as i32,
        )?);
    }
    let rows = compute(&mosaic, &mut asked)?;
    let mut features = Vec::with_capacity(asked.len());
    for (row, k) in asked.iter().enumerate() {
        let patch = &patches[k.class_id() as usize];
        features.push(DescribedFeature {
            kind: FeatureKind::Rectified,
            pixel: patch.pixel,
            point: Some(patch.point),
            normal: patch.normal,
            size: 2.0 * patch.sigma_m,
            descriptor: root_sift(rows.at_row::<f32>(row as i32)?),
        });
    }
    Ok(features)
}

/// Patches in a row of the mosaic.
const MOSAIC: usize = 40;

fn patch_of(frame: &RgbdFrame, normals: &NormalMap, k: &Spot) -> Option<Patch> {
    let pixel = k.pixel;
    let surface = Surface::at(frame, normals, pixel);
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
    let tangent_px = |e: &Vector3<f64>| {
        let z = point.z;
        [
            camera.fx * (e.x / z - point.x * e.z / (z * z)),
            camera.fy * (e.y / z - point.y * e.z / (z * z)),
        ]
    };
    let size_m = f64::from(k.size) * point.z / camera.fx / slant.sqrt();
    Some(Patch {
        pixel,
        point,
        normal,
        sigma_m: snapped(size_m / 2.0),
        tangents_px: [tangent_px(&across), tangent_px(&down)],
    })
}

/// The nearest step of a half-octave ladder from 4 mm.
fn snapped(sigma_m: f64) -> f64 {
    let step = (2.0 * (sigma_m / 0.004).log2()).round().clamp(0.0, 8.0);
    0.004 * 2_f64.powf(step / 2.0)
}

/// All patches in one picture, each sampled from the pyramid level that avoids aliasing.
fn mosaic_of(gray: &Gray, patches: &[Patch]) -> opencv::Result<Mat> {
    let rows = patches.len().div_ceil(MOSAIC);
    let size = (rows * PATCH, MOSAIC * PATCH);
    let mut mosaic = Mat::new_rows_cols_with_default(
        size.0 as i32,
        size.1 as i32,
        CV_8U,
        opencv::core::Scalar::all(0.0),
    )?;
    let mut level = gray.mat().try_clone()?;
    for l in 0..4 {
        let scale = 0.5_f64.powi(l);
        let mut any = false;
        let outside = Vec2f::from([-1e4, -1e4]);
        let mut map = vec![outside; size.0 * size.1];
        for (i, patch) in patches.iter().enumerate() {
            if level_of(patch) == l {
                any = true;
                fill_map(&mut map, i, patch, scale);
            }
        }
        if any {
            let map = Mat::new_rows_cols_with_data(size.0 as i32, size.1 as i32, &map)?;
            let mut sampled = Mat::default();
            imgproc::remap(
                &level,
                &mut sampled,
                &map,
                &opencv::core::no_array(),
                imgproc::INTER_LINEAR,
                opencv::core::BORDER_CONSTANT,
                opencv::core::Scalar::all(0.0),
            )?;
            let mut sum = Mat::default();
            opencv::core::add(&mosaic, &sampled, &mut sum, &opencv::core::no_array(), -1)?;
            mosaic = sum;
        }
        let mut smaller = Mat::default();
        imgproc::pyr_down(&level, &mut smaller, Size::default(), 4)?;
        level = smaller;
    }
    Ok(mosaic)
}

fn level_of(patch: &Patch) -> i32 {
    let [a, b] = patch.tangents_px;
    let area = (a[0] * b[1] - a[1] * b[0]).abs();
    let step_px = patch.sigma_m * PATCH_SIGMAS / (PATCH as f64 / 2.0) * area.sqrt();
    ((step_px.max(1.0).log2() + 0.3).floor() as i32).clamp(0, 3)
}

fn fill_map(map: &mut [Vec2f], index: usize, patch: &Patch, scale: f64) {
    let radius = patch.sigma_m * PATCH_SIGMAS;
    let (left, top) = ((index % MOSAIC) * PATCH, (index / MOSAIC) * PATCH);
    let half = PATCH as f64 / 2.0;
    let [a, b] = patch.tangents_px;
    for y in 0..PATCH {
        for x in 0..PATCH {
            let gx = radius * (x as f64 - half + 0.5) / half;
            let gy = radius * (y as f64 - half + 0.5) / half;
            let u = f64::from(patch.pixel[0]) + gx * a[0] + gy * b[0];
            let v = f64::from(patch.pixel[1]) + gx * a[1] + gy * b[1];
            map[(top + y) * MOSAIC * PATCH + left + x] =
                Vec2f::from([((u + 0.5) * scale - 0.5) as f32, ((v + 0.5) * scale - 0.5) as f32]);
        }
    }
}
