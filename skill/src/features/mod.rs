//! Features of one frame, spread over the picture. Each is described twice: by a patch of the
//! picture, and by a patch of metric size on the tangent plane of the surface; each patch is turned
//! to the main direction of its gradients. Depth makes viewpoint and scale known, so they are used:
//! large surfaces that are seen from the side are rectified to a frontal view. The vertical is not
//! used: horizontal surfaces have no upward direction, and a camera rolls.
//!
//! In: an RGB-D frame and its normals. Out: features with their place and normal in the camera frame,
//! metres, and a RootSIFT descriptor. Keypoints are extrema of the difference of Gaussians (Lowe 2004).

#[cfg(test)]
mod against_opencv;
mod blurred_plane;
mod dog_keypoints;
mod orientation;
pub(crate) mod quantised;
mod rectified_views;
mod sift_descriptor;

pub use sift_descriptor::DESCRIPTOR_LENGTH;

use crate::image::gray::Gray;
use dog_keypoints::{Keypoint, ScaleSpace};
use linkage_frames::depth::NormalMap;
use linkage_frames::{PinholeCamera, RgbdFrame};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rectified_views::{LEAST_COSINE, RectifiedViews};
use serde::{Deserialize, Serialize};
use sift_descriptor::{Patch, Pyramid, directions, gradients};
use std::collections::{BTreeMap, HashSet};

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

/// How many features a cell of the picture may hold, and how small they may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureDensity {
    /// For an encounter.
    Query,
    /// For a model: more, views of one point are merged later.
    Model,
}

impl FeatureDensity {
    /// Features that a cell of the picture may hold.
    fn per_cell(self) -> usize {
        match self {
            Self::Query => 22,
            Self::Model => 50,
        }
    }

    /// Keypoints of a view of the picture: the smallest cost most, and are looked for once, when
    /// a model is learned.
    fn keypoints_of_view(self, view: &Gray) -> opencv::Result<Vec<Keypoint>> {
        let space = match self {
            Self::Query => ScaleSpace::new(view)?,
            Self::Model => ScaleSpace::doubled(view)?,
        };
        Ok(space.keypoints(CONTRAST))
    }
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

/// Keypoints of a frame, before depth is used.
pub struct Keypoints<W> {
    gray: Gray,
    found: Vec<Spot>,
    density: FeatureDensity,
    wanted: W,
}

/// A keypoint with one of its directions.
#[derive(Clone, Copy)]
struct Spot {
    pixel: [f32; 2],
    /// Diameter, pixels.
    size: f32,
    /// From right towards down, radians.
    angle: f32,
}

impl<W: Fn(usize, usize) -> bool + Sync> Keypoints<W> {
    /// Finds them where `wanted` says so (by pixel).
    ///
    /// # Errors
    /// The error of the vision library.
    pub fn new(frame: &RgbdFrame, density: FeatureDensity, wanted: W) -> opencv::Result<Self> {
        let gray = Gray::from_color(&frame.color)?;
        let found = detect(&gray, density, &wanted)?;
        Ok(Self { gray, found, density, wanted })
    }

    /// Describes them, both ways, and those of slanted surfaces as from the front.
    ///
    /// # Errors
    /// The error of the vision library.
    pub fn describe(
        &self,
        frame: &RgbdFrame,
        normals: &NormalMap,
    ) -> opencv::Result<Vec<DescribedFeature>> {
        let pyramid = Pyramid::new(&self.gray, LEVELS)?;
        let surfaces: Vec<(&Spot, Surface)> =
            self.found.par_iter().map(|s| (s, Surface::at(frame, normals, s.pixel))).collect();
        let focal = frame.camera.fx;
        let in_picture: Vec<Asked> =
            surfaces.iter().map(|(spot, surface)| in_picture(spot, surface, focal)).collect();
        let views = RectifiedViews::new(&frame.camera, normals, &self.wanted);
        let is_model = self.density == FeatureDensity::Model;
        let mut seen = HashSet::new();
        let upright = surfaces
            .iter()
            // One place and size may carry several orientations: once is enough here.
            .filter(|(s, _)| {
                seen.insert([s.pixel[0], s.pixel[1], s.size].map(|x| (x * 4.0) as i32))
            })
            // A model keeps both views of a surface, an encounter's time is short.
            .filter(|(_, surface)| is_model || !surface.is_rectified(&views))
            .filter_map(|(spot, surface)| {
                let size_m = surface.diameter(spot.size, focal)?;
                upright(spot.pixel, size_m, surface, &frame.camera)
            });
        let in_views = self.in_rectified_views(&views, &frame.camera, normals)?;
        let upright: Vec<Asked> = upright.chain(in_views).collect();
        let rectified = upright.par_iter().flat_map_iter(|asked| {
            let angles = directions(&pyramid, &asked.patch).into_iter();
            angles.map(|angle| Asked { patch: asked.patch.turned(angle), ..asked.clone() })
        });
        let described = |asked: Asked| DescribedFeature {
            descriptor: gradients(&pyramid, &asked.patch),
            ..asked.feature
        };
        Ok(in_picture.into_par_iter().chain(rectified).map(described).collect())
    }

    /// Patches about keypoints of the views that face slanted surfaces.
    fn in_rectified_views(
        &self,
        views: &RectifiedViews,
        camera: &PinholeCamera,
        normals: &NormalMap,
    ) -> opencv::Result<Vec<Asked>> {
        let detect = |view: &Gray| self.density.keypoints_of_view(view);
        let found = views.keypoints(&self.gray, camera, normals, detect)?;
        let spread = found.into_iter().flat_map(|of_view| {
            strongest(of_view, |f| (f.pixel, f.response), self.density.per_cell()).concat()
        });
        let asked = spread.filter_map(|f| {
            let surface = Surface { point: Some(f.point), normal: Some(f.normal) };
            upright(f.pixel, f.size_m, &surface, camera)
        });
        Ok(asked.collect())
    }
}

/// Keypoints of a picture where `wanted` says so, each with its directions, spread over the cells.
fn detect(
    gray: &Gray,
    density: FeatureDensity,
    wanted: impl Fn(usize, usize) -> bool,
) -> opencv::Result<Vec<Spot>> {
    let space = ScaleSpace::doubled(gray)?;
    let mut found = space.keypoints(CONTRAST);
    found.retain(|k| {
        let [u, v] = k.pixel.map(|x| x.round() as usize);
        wanted(u.min(gray.width() - 1), v.min(gray.height() - 1))
    });
    let spots_of = |cell: Vec<Keypoint>| -> Vec<Spot> {
        let spots = cell.iter().flat_map(|k| {
            let Keypoint { pixel, size, .. } = *k;
            space.directions(k).into_iter().map(move |angle| Spot { pixel, size, angle })
        });
        spots.take(density.per_cell()).collect()
    };
    let cells = strongest(found, |k| (k.pixel, k.response), density.per_cell());
    Ok(cells.into_par_iter().map(spots_of).collect::<Vec<_>>().concat())
}

/// Those of the highest response in each cell of the picture, cell by cell.
fn strongest<T>(
    found: Vec<T>,
    place_and_response: impl Fn(&T) -> ([f32; 2], f32),
    per_cell: usize,
) -> Vec<Vec<T>> {
    let mut cells: BTreeMap<[i32; 2], Vec<T>> = BTreeMap::new();
    for item in found {
        let ([x, y], _) = place_and_response(&item);
        cells.entry([y, x].map(|x| (x / CELL_PX) as i32)).or_default().push(item);
    }
    let mut cells: Vec<Vec<T>> = cells.into_values().collect();
    for cell in &mut cells {
        let response = |item: &T| place_and_response(item).1;
        cell.sort_by(|a, b| response(b).total_cmp(&response(a)));
        cell.truncate(per_cell);
    }
    cells
}

/// A feature except for its descriptor, and the patch of the picture that this is of.
#[derive(Clone)]
struct Asked {
    feature: DescribedFeature,
    patch: Patch,
}

/// The patch about a feature as it lies in the picture, turned to its orientation.
fn in_picture(spot: &Spot, surface: &Surface, focal: f64) -> Asked {
    let size = f64::from(spot.size);
    let half_width = PATCH_SIGMAS * 0.5 * size;
    let (sin, cos) = f64::from(spot.angle).sin_cos();
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
    /// The surface at a pixel.
    fn at(frame: &RgbdFrame, normals: &NormalMap, pixel: [f32; 2]) -> Self {
        let (u, v) = (f64::from(pixel[0]), f64::from(pixel[1]));
        let patch = normals.at(u.round() as usize, v.round() as usize);
        let z = patch.map(|p| p.z).or_else(|| frame.depth.at_nearest(u, v).map(f64::from));
        Self {
            point: z.map(|z| frame.camera.back_project(u, v, z)),
            normal: patch.map(|p| p.normal),
        }
    }

    /// Metres on the surface of a diameter in pixels that is the mean of a round spot's.
    fn diameter(&self, pixels: f32, focal: f64) -> Option<f64> {
        let (point, normal) = (self.point?, self.normal?);
        let slant = -normal.dot(&point.coords.normalize());
        Some(f64::from(pixels) * point.z / focal / slant.max(LEAST_COSINE).sqrt())
    }

    /// It is shown in one of the rectified views.
    fn is_rectified(&self, views: &RectifiedViews) -> bool {
        self.point.zip(self.normal).is_some_and(|(point, normal)| views.shows(&point, &normal))
    }
}

/// The patch about a feature on the tangent plane of its surface, upright; `None` without a
/// surface, or where it is seen from the side.
fn upright(
    pixel: [f32; 2],
    size_m: f64,
    surface: &Surface,
    camera: &PinholeCamera,
) -> Option<Asked> {
    let (point, normal) = (surface.point?, surface.normal?);
    if -normal.dot(&point.coords.normalize()) < LEAST_COSINE {
        return None;
    }
    let across = (Vector3::x() - normal * normal.x).try_normalize(1e-6)?;
    let mut down = normal.cross(&across);
    if down.y < 0.0 {
        down = -down;
    }
    let sigma_m = snapped(size_m / 2.0);
    // Pixels that half the patch spans along a tangent.
    let in_pixels = |e: &Vector3<f64>| {
        let e = e * (PATCH_SIGMAS * sigma_m / point.z);
        [camera.fx * (e.x - point.x / point.z * e.z), camera.fy * (e.y - point.y / point.z * e.z)]
    };
    Some(Asked {
        patch: Patch {
            centre: pixel.map(f64::from),
            right: in_pixels(&across),
            down: in_pixels(&down),
        },
        feature: DescribedFeature {
            kind: FeatureKind::Rectified,
            pixel,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cell_of_the_picture_keeps_its_strongest() {
        let found =
            vec![([1.0, 1.0], 3.0), ([2.0, 2.0], 5.0), ([90.0, 1.0], 1.0), ([3.0, 3.0], 4.0)];
        let responses: Vec<Vec<f32>> = strongest(found, |item| *item, 2)
            .into_iter()
            .map(|cell| cell.into_iter().map(|(_, response)| response).collect())
            .collect();
        assert_eq!(responses, [vec![5.0, 4.0], vec![1.0]]);
    }

    #[test]
    fn sizes_are_steps_of_half_an_octave() {
        assert_eq!(snapped(0.004), 0.004);
        assert_eq!(snapped(0.0083), 0.008);
        assert!((snapped(0.0056) - 0.004 * 2_f64.sqrt()).abs() < 1e-12);
        assert_eq!((snapped(1e-4), snapped(1.0)), (0.004, 0.064));
    }
}
