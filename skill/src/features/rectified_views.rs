//! Keypoints on surfaces that are seen from the side. What is round on a surface is a narrow
//! ellipse in a slanted view of it, which no extremum over place and scale finds again. The camera
//! turned about its centre until it faces the surface would see it as from the front, and a
//! homography makes that picture of this one, however far the surface is (Koeser & Koch 2007).
//! Distortion by the lens is left out: it changes a keypoint's size a little, not its place.

use super::dog_keypoints::Keypoint;
use crate::image::gray::Gray;
use crate::math::robust::median;
use linkage_frames::PinholeCamera;
use linkage_frames::depth::NormalMap;
use nalgebra::{Matrix3, Point2, Point3, Rotation3, Vector2, Vector3};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Least cosine of the angle at which a surface is seen: the picture shows too little of others.
pub const LEAST_COSINE: f64 = 0.2;
/// Cosines at which a surface needs a view of its own.
const SLANTED: RangeInclusive<f64> = LEAST_COSINE..=0.75;
/// Least cosine between a direction and the normals of the surface that faces it.
const ALIKE: f64 = 0.95;
/// Pixels between the normals that are used.
const STRIDE_PX: usize = 8;
/// Fewest normals of a direction: the surface must have some size.
const LEAST: usize = 40;
/// Largest number of views.
const MOST_VIEWS: usize = 3;
/// Normals that are tried as directions.
const TRIED: usize = 100;
/// Largest share of a picture's pixels that a view of it has.
const MOST_PIXELS: f64 = 0.6;
/// Pixels about the surface that a view shows.
const MARGIN_PX: f64 = 16.0;

/// Views that face the large slanted surfaces of a picture.
pub struct RectifiedViews(Vec<View>);

/// A keypoint of a view.
#[derive(Debug, Clone, Copy)]
pub struct RectifiedKeypoint {
    /// Pixel of the picture.
    pub pixel: [f32; 2],
    /// Place in the camera frame, metres.
    pub point: Point3<f64>,
    /// Unit normal there.
    pub normal: Vector3<f64>,
    /// Diameter on the surface, metres.
    pub size_m: f64,
    /// Contrast, grey levels.
    pub response: f32,
}

impl RectifiedViews {
    /// Views of slanted surfaces where `wanted` says so (by pixel).
    pub fn new(
        camera: &PinholeCamera,
        normals: &NormalMap,
        wanted: impl Fn(usize, usize) -> bool + Sync,
    ) -> Self {
        let seen = slanted(camera, normals, wanted);
        let directions = directions(&seen);
        Self(directions.iter().filter_map(|d| View::new(camera, &seen, d)).collect())
    }

    /// True where a view faces the surface.
    pub fn shows(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> bool {
        self.0.iter().any(|view| view.shows(point, normal))
    }

    /// Keypoints on the surfaces that are faced, by view; `detect` finds them in a picture.
    ///
    /// # Errors
    /// The error of the vision library.
    pub fn keypoints(
        &self,
        gray: &Gray,
        camera: &PinholeCamera,
        normals: &NormalMap,
        detect: impl Fn(&Gray) -> opencv::Result<Vec<Keypoint>> + Sync,
    ) -> opencv::Result<Vec<Vec<RectifiedKeypoint>>> {
        let of_view = |view: &View| {
            let picture = gray.warped(&view.picture_from_view, view.width, view.height)?;
            let found = detect(&picture)?;
            Ok(found.iter().filter_map(|k| view.faced(camera, normals, k)).collect())
        };
        self.0.par_iter().map(of_view).collect()
    }
}

/// A pixel of slanted surface.
struct Slanted {
    /// Towards it, at depth 1.
    ray: Vector3<f64>,
    normal: Vector3<f64>,
}

fn is_slanted(towards: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
    SLANTED.contains(&-normal.dot(&towards.normalize()))
}

fn slanted(
    camera: &PinholeCamera,
    normals: &NormalMap,
    wanted: impl Fn(usize, usize) -> bool + Sync,
) -> Vec<Slanted> {
    let at = |u: usize, v: usize| {
        let patch = normals.at(u, v).filter(|_| wanted(u, v))?;
        let ray = camera.back_project(u as f64, v as f64, 1.0).coords;
        is_slanted(&ray, &patch.normal).then_some(Slanted { ray, normal: patch.normal })
    };
    let along = |length: usize| (STRIDE_PX / 2..length).step_by(STRIDE_PX);
    let rows: Vec<usize> = along(camera.height).collect();
    rows.into_par_iter()
        .flat_map_iter(|v| along(camera.width).filter_map(move |u| at(u, v)))
        .collect()
}

/// Normals of large surfaces, the largest first.
fn directions(seen: &[Slanted]) -> Vec<Vector3<f64>> {
    let mut left: Vec<Vector3<f64>> = seen.iter().map(|s| s.normal).collect();
    let mut directions = Vec::new();
    while directions.len() < MOST_VIEWS {
        let alike = |a: &Vector3<f64>| left.iter().filter(|b| a.dot(b) > ALIKE).count();
        let tried = left.iter().step_by(left.len().div_ceil(TRIED).max(1));
        let Some((count, most)) = tried.map(|n| (alike(n), *n)).max_by_key(|(count, _)| *count)
        else {
            break;
        };
        if count < LEAST {
            break;
        }
        let mean: Vector3<f64> = left.iter().filter(|n| n.dot(&most) > ALIKE).sum();
        let mean = mean.normalize();
        left.retain(|n| n.dot(&mean) <= ALIKE && n.dot(&most) <= ALIKE);
        directions.push(mean);
    }
    directions
}

/// What the camera would see if it faced a surface.
struct View {
    /// Its unit normal.
    normal: Vector3<f64>,
    picture_from_view: Matrix3<f64>,
    focal_px: f64,
    width: usize,
    height: usize,
}

impl View {
    /// Faces surface with this normal; `None` where there is none ahead.
    fn new(camera: &PinholeCamera, seen: &[Slanted], normal: &Vector3<f64>) -> Option<Self> {
        let view_from_camera = Rotation3::rotation_between(&-normal, &Vector3::z())?;
        let own: Vec<Vector3<f64>> = seen
            .iter()
            .filter(|s| s.normal.dot(normal) > ALIKE)
            .map(|s| view_from_camera * s.ray)
            .filter(|ray| ray.z > LEAST_COSINE * ray.norm())
            .collect();
        let places = || own.iter().map(|ray| ray.xy() / ray.z);
        let low = places().reduce(|a, b| a.inf(&b))?;
        let extent = places().reduce(|a, b| a.sup(&b))? - low;
        // A pixel of the picture becomes 1 / z^3 as large: turned, the surface keeps its pixels.
        let shrinking = median(&mut own.iter().map(|ray| ray.z.powi(3)).collect::<Vec<_>>())?;
        let most = MOST_PIXELS * (camera.width * camera.height) as f64;
        let focal_px = (camera.fx * camera.fy * shrinking).min(most / (extent.x * extent.y)).sqrt();
        let corner = low - Vector2::repeat(MARGIN_PX / focal_px);
        let ray_of_pixel = Matrix3::new_translation(&corner) * Matrix3::new_scaling(1.0 / focal_px);
        let pixel_of_ray =
            Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
        let side = |extent: f64| (extent * focal_px + 2.0 * MARGIN_PX).ceil() as usize;
        Some(Self {
            normal: *normal,
            picture_from_view: pixel_of_ray * view_from_camera.inverse().matrix() * ray_of_pixel,
            focal_px,
            width: side(extent.x),
            height: side(extent.y),
        })
    }

    fn shows(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> bool {
        normal.dot(&self.normal) > ALIKE && is_slanted(&point.coords, normal)
    }

    /// A keypoint of this view, if it lies on the surface that is faced.
    fn faced(
        &self,
        camera: &PinholeCamera,
        normals: &NormalMap,
        keypoint: &Keypoint,
    ) -> Option<RectifiedKeypoint> {
        let [x, y] = keypoint.pixel.map(f64::from);
        let place = Point2::from_homogeneous(self.picture_from_view * Vector3::new(x, y, 1.0))?;
        let (u, v) = (place.x.round(), place.y.round());
        let is_inside = u >= 0.0 && v >= 0.0 && u < camera.width as f64 && v < camera.height as f64;
        let patch = is_inside.then(|| normals.at(u as usize, v as usize))??;
        let point = camera.back_project(place.x, place.y, patch.z);
        let depth_in_view = -self.normal.dot(&point.coords);
        self.shows(&point, &patch.normal).then(|| RectifiedKeypoint {
            pixel: [place.x as f32, place.y as f32],
            point,
            normal: patch.normal,
            size_m: f64::from(keypoint.size) * depth_in_view / self.focal_px,
            response: keypoint.response,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::dog_keypoints::ScaleSpace;
    use linkage_frames::{ColorImage, DepthImage, RgbdFrame};
    use std::sync::Arc;

    /// A grey board one metre away with bright dots every 0.1 m, turned about the vertical.
    struct Board {
        /// Radians.
        turn: f64,
    }

    const DOT_SIGMA_M: f64 = 0.012;
    const DOT_PITCH_M: f64 = 0.1;

    impl Board {
        fn across(&self) -> Vector3<f64> {
            Vector3::new(self.turn.cos(), 0.0, self.turn.sin())
        }

        /// Where a ray meets it.
        fn hit(&self, ray: &Vector3<f64>) -> Point3<f64> {
            let normal = self.across().cross(&Vector3::y());
            Point3::from(ray * (normal.z / normal.dot(ray)))
        }

        /// The dot nearest to a place, and how far that is.
        fn nearest_dot(&self, place: &Point3<f64>) -> (Point3<f64>, f64) {
            let on_grid = |x: f64| DOT_PITCH_M * (x / DOT_PITCH_M).round();
            let from_middle = place - Point3::new(0.0, 0.0, 1.0);
            let dot = Point3::new(0.0, 0.0, 1.0)
                + self.across() * on_grid(from_middle.dot(&self.across()))
                + Vector3::y() * on_grid(from_middle.y);
            (dot, (place - dot).norm())
        }

        fn frame(&self) -> RgbdFrame {
            let camera = PinholeCamera::kinect();
            let hits: Vec<Point3<f64>> = (0..camera.width * camera.height)
                .map(|i| {
                    let (u, v) = ((i % camera.width) as f64, (i / camera.width) as f64);
                    self.hit(&camera.back_project(u, v, 1.0).coords)
                })
                .collect();
            let value = |p: &Point3<f64>| {
                let apart = self.nearest_dot(p).1 / DOT_SIGMA_M;
                (80.0 + 120.0 * (-0.5 * apart * apart).exp()) as u8
            };
            let is_seen = |p: &&Point3<f64>| p.z > 0.4 && p.z < 2.0;
            let rgb = hits.iter().flat_map(|p| [value(p); 3]).collect();
            let metres = hits
                .iter()
                .map(|p| Some(p).filter(is_seen).map_or(f32::NAN, |p| p.z as f32))
                .collect();
            let color = ColorImage::new(camera.width, camera.height, rgb).unwrap();
            let depth = DepthImage::from_metres(camera.width, camera.height, metres).unwrap();
            RgbdFrame::new(1, Arc::new(camera), color, depth).unwrap()
        }
    }

    fn faced(frame: &RgbdFrame, wanted: bool) -> Vec<RectifiedKeypoint> {
        let normals = NormalMap::new(&frame.depth, &frame.camera);
        let gray = Gray::from_color(&frame.color).unwrap();
        let facing = RectifiedViews::new(&frame.camera, &normals, |_, _| wanted);
        let detect = |view: &Gray| Ok(ScaleSpace::new(view)?.keypoints(2.0));
        facing.keypoints(&gray, &frame.camera, &normals, detect).unwrap().concat()
    }

    #[test]
    fn dots_on_a_board_seen_from_the_side_are_found_where_they_are_and_as_large_as_they_are() {
        for degrees in [-68.0_f64, 50.0, 65.0] {
            let board = Board { turn: degrees.to_radians() };
            let frame = board.frame();
            let found = faced(&frame, true);
            let of_dots: Vec<&RectifiedKeypoint> = found
                .iter()
                .filter(|f| (0.7..1.4).contains(&(0.5 * f.size_m / DOT_SIGMA_M)))
                .collect();
            let on_dots = of_dots.iter().filter(|f| {
                let [u, v] = f.pixel.map(f64::from);
                let place = board.hit(&frame.camera.back_project(u, v, 1.0).coords);
                board.nearest_dot(&place).1 < 0.003
            });
            assert!(of_dots.len() > 30, "{degrees}: {} of {}", of_dots.len(), found.len());
            assert!(on_dots.count() * 20 > of_dots.len() * 19, "{degrees}");
        }
    }

    #[test]
    fn what_is_seen_from_the_front_or_not_wanted_has_no_view() {
        assert!(faced(&Board { turn: 0.0 }.frame(), true).is_empty());
        assert!(faced(&Board { turn: 1.0 }.frame(), false).is_empty());
    }
}
