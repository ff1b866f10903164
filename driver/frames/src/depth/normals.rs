//! Surface normals from depth: a plane fitted in *inverse* depth, where a plane of the world
//! is a plane of the picture whatever its slant, so that sums over a window give the fit.

use crate::camera::PinholeCamera;
use crate::frame::DepthImage;
use nalgebra::Vector3;

/// Half widths of the windows that are tried, large first: large windows average noise,
/// small ones fit where a surface ends.
const HALF_WINDOWS: [usize; 2] = [8, 4];
/// Share of a window that must hold readings.
const MIN_FILLED: f64 = 0.45;

/// The plane fitted round a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePatch {
    /// Unit normal in the camera frame, turned towards the camera.
    pub normal: Vector3<f64>,
    /// Depth of the fitted plane at the pixel, in metres: less noisy than the reading.
    pub z: f64,
}

impl SurfacePatch {
    /// The surface round column `u`, row `v`; `None` at borders, holes, edges and corners. For a
    /// few thousand pixels; [`NormalMap`] reads more of them sooner.
    pub fn at(depth: &DepthImage, camera: &PinholeCamera, u: usize, v: usize) -> Option<Self> {
        largest_window([depth.width(), depth.height()], u, v, |half| {
            fit(&window_sums(depth, camera, u, v, half), camera, u, v, half)
        })
    }
}

/// The result of the first window that fits.
fn largest_window(
    [width, height]: [usize; 2],
    u: usize,
    v: usize,
    fit: impl Fn(usize) -> Option<SurfacePatch>,
) -> Option<SurfacePatch> {
    let inside = |half: usize| half <= u && half <= v && u + half < width && v + half < height;
    HALF_WINDOWS.into_iter().filter(|&half| inside(half)).find_map(fit)
}

/// Sums over a window of 1, x, y, d, xx, xy, yy, xd, yd, dd with (x, y) the ray through a pixel
/// at unit depth and d the inverse depth.
type Sums = [f64; 10];

/// Columns of the largest window.
const COLUMNS: usize = 2 * HALF_WINDOWS[0] + 1;

/// Loops as wide as the processor allows, with the same results on all.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn window_sums(
    depth: &DepthImage,
    camera: &PinholeCamera,
    u: usize,
    v: usize,
    half: usize,
) -> Sums {
    let columns = 2 * half + 1;
    // Of each column 1, y, yy, d, yd, dd: the loop over columns has no sum to wait for.
    let mut sums = [[0.0_f64; COLUMNS]; 6];
    let [n, sy, syy, sd, syd, sdd] = &mut sums;
    for row in v - half..=v + half {
        let y = (row as f64 - camera.cy) / camera.fy;
        let start = row * depth.width() + u - half;
        let readings = &depth.as_metres()[start..start + columns];
        for (i, &z) in readings.iter().enumerate() {
            let (there, d) = if z.is_nan() { (0.0, 0.0) } else { (1.0, 1.0 / f64::from(z)) };
            n[i] += there;
            sy[i] += there * y;
            syy[i] += there * y * y;
            sd[i] += d;
            syd[i] += d * y;
            sdd[i] += d * d;
        }
    }
    let mut total = [0.0; 10];
    for i in 0..columns {
        let x = ((u - half + i) as f64 - camera.cx) / camera.fx;
        let terms = [
            n[i],
            x * n[i],
            sy[i],
            sd[i],
            x * x * n[i],
            x * sy[i],
            syy[i],
            x * sd[i],
            syd[i],
            sdd[i],
        ];
        for (sum, term) in total.iter_mut().zip(terms) {
            *sum += term;
        }
    }
    total
}

/// d = p + q x + r y over a window of half width `half`, by least squares.
fn fit(
    sums: &Sums,
    camera: &PinholeCamera,
    u: usize,
    v: usize,
    half: usize,
) -> Option<SurfacePatch> {
    let [n, x, y, d, xx, xy, yy, xd, yd, dd] = *sums;
    let area = ((2 * half + 1) * (2 * half + 1)) as f64;
    if n < MIN_FILLED * area {
        return None;
    }
    let (mx, my, md) = (x / n, y / n, d / n);
    let (cxx, cxy, cyy) = (xx - n * mx * mx, xy - n * mx * my, yy - n * my * my);
    let (cxd, cyd, cdd) = (xd - n * mx * md, yd - n * my * md, dd - n * md * md);
    let det = cxx * cyy - cxy * cxy;
    if det <= 1e-3 * cxx * cyy {
        return None;
    }
    let q = (cyy * cxd - cxy * cyd) / det;
    let r = (cxx * cyd - cxy * cxd) / det;
    let p = md - q * mx - r * my;
    let inverse =
        p + q * (u as f64 - camera.cx) / camera.fx + r * (v as f64 - camera.cy) / camera.fy;
    if inverse <= 0.0 {
        return None;
    }
    let z = 1.0 / inverse;
    let residual_m = ((cdd - q * cxd - r * cyd).max(0.0) / n).sqrt() * z * z;
    if residual_m > 2.0 * camera.depth_sensor.reading_sigma(z) + 0.002 {
        return None;
    }
    // The plane a X + b Y + c Z = 1 has inverse depth a x + b y + c.
    let normal = -Vector3::new(q, r, p).normalize();
    Some(SurfacePatch { normal, z })
}

/// Box sums over one depth picture, from which the normal of any pixel is read in constant time.
pub struct NormalMap {
    camera: PinholeCamera,
    size: [usize; 2],
    /// Integral pictures of what [`Sums`] holds; one row and column of zeros in front.
    sums: Vec<Sums>,
}

impl NormalMap {
    /// Sums one depth picture.
    pub fn new(depth: &DepthImage, camera: &PinholeCamera) -> Self {
        let (width, height) = (depth.width(), depth.height());
        let stride = width + 1;
        let mut sums = vec![[0.0; 10]; stride * (height + 1)];
        for v in 0..height {
            let mut row = [0.0; 10];
            let y = (v as f64 - camera.cy) / camera.fy;
            for u in 0..width {
                let z = depth.as_metres()[v * width + u];
                if !z.is_nan() {
                    let x = (u as f64 - camera.cx) / camera.fx;
                    let d = 1.0 / f64::from(z);
                    let terms = [1.0, x, y, d, x * x, x * y, y * y, x * d, y * d, d * d];
                    for (sum, term) in row.iter_mut().zip(terms) {
                        *sum += term;
                    }
                }
                let above = sums[v * stride + u + 1];
                let here = &mut sums[(v + 1) * stride + u + 1];
                for k in 0..10 {
                    here[k] = above[k] + row[k];
                }
            }
        }
        Self { camera: camera.clone(), size: [width, height], sums }
    }

    /// The surface round column `u`, row `v`; `None` at borders, holes, edges and corners.
    pub fn at(&self, u: usize, v: usize) -> Option<SurfacePatch> {
        largest_window(self.size, u, v, |half| {
            fit(&self.box_sum(u, v, half), &self.camera, u, v, half)
        })
    }

    fn box_sum(&self, u: usize, v: usize, half: usize) -> Sums {
        let stride = self.size[0] + 1;
        let (a, b) = ((v - half) * stride, (v + half + 1) * stride);
        let (l, r) = (u - half, u + half + 1);
        let [inner, left, above, corner] =
            [b + r, b + l, a + r, a + l].map(|corner| &self.sums[corner]);
        std::array::from_fn(|k| inner[k] - left[k] - above[k] + corner[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    fn plane(camera: &PinholeCamera, normal: Vector3<f64>, through: Point3<f64>) -> DepthImage {
        let metres = (0..camera.width * camera.height)
            .map(|i| {
                let ray =
                    camera.back_project((i % camera.width) as f64, (i / camera.width) as f64, 1.0);
                (normal.dot(&through.coords) / normal.dot(&ray.coords)) as f32
            })
            .collect();
        DepthImage::from_metres(camera.width, camera.height, metres).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn the_normal_of_a_plane_is_found(nx in -0.7..0.7, ny in -0.7..0.7) {
            let camera = PinholeCamera {
                width: 160, height: 120, fx: 131.0, fy: 131.0, cx: 79.5, cy: 59.5,
                ..PinholeCamera::kinect()
            };
            let normal = Vector3::new(nx, ny, -1.0).normalize();
            let depth = plane(&camera, normal, Point3::new(0.0, 0.0, 1.2));
            let patch = NormalMap::new(&depth, &camera).at(80, 60).unwrap();
            prop_assert!(patch.normal.dot(&normal) > 0.9999);
            let alone = SurfacePatch::at(&depth, &camera, 80, 60).unwrap();
            prop_assert!((alone.normal - patch.normal).norm() < 1e-9);
            prop_assert!((alone.z - patch.z).abs() < 1e-9);
        }
    }

    #[test]
    fn there_is_no_normal_across_a_step() {
        let camera =
            PinholeCamera { width: 64, height: 48, cx: 31.5, cy: 23.5, ..PinholeCamera::kinect() };
        let metres = (0..64 * 48).map(|i| if i % 64 < 32 { 1.0 } else { 1.5 }).collect();
        let depth = DepthImage::from_metres(64, 48, metres).unwrap();
        assert_eq!(NormalMap::new(&depth, &camera).at(32, 24), None);
        assert_eq!(SurfacePatch::at(&depth, &camera, 32, 24), None);
    }
}
