//! Surface normals from depth: a plane fitted in *inverse* depth, where a plane of the world
//! is a plane of the picture whatever its slant, so that box sums give the fit at any pixel
//! in constant time.

use super::depth_sigma;
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

/// Box sums over one depth picture, from which normals are read.
pub struct NormalMap {
    width: usize,
    height: usize,
    focal: [f64; 2],
    centre: [f64; 2],
    /// Integral pictures of 1, u, v, d, uu, uv, vv, ud, vd, dd with (u, v) relative to the
    /// principal point and d the inverse depth; one row and column of zeros in front.
    sums: Vec<[f64; 10]>,
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
        Self { width, height, focal: [camera.fx, camera.fy], centre: [camera.cx, camera.cy], sums }
    }

    /// The surface round column `u`, row `v`; `None` at borders, holes, edges and corners.
    pub fn at(&self, u: usize, v: usize) -> Option<SurfacePatch> {
        HALF_WINDOWS.iter().find_map(|&half| self.fit(u, v, half))
    }

    fn box_sum(&self, u: usize, v: usize, half: usize) -> [f64; 10] {
        let stride = self.width + 1;
        let (a, b) = ((v - half) * stride, (v + half + 1) * stride);
        let (l, r) = (u - half, u + half + 1);
        std::array::from_fn(|k| {
            self.sums[b + r][k] - self.sums[b + l][k] - self.sums[a + r][k] + self.sums[a + l][k]
        })
    }

    /// d = p + q x + r y over the window, by least squares.
    fn fit(&self, u: usize, v: usize, half: usize) -> Option<SurfacePatch> {
        if u < half || v < half || u + half >= self.width || v + half >= self.height {
            return None;
        }
        let [n, x, y, d, xx, xy, yy, xd, yd, dd] = self.box_sum(u, v, half);
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
        let here = [
            (u as f64 - self.centre[0]) / self.focal[0],
            (v as f64 - self.centre[1]) / self.focal[1],
        ];
        let inverse = p + q * here[0] + r * here[1];
        if inverse <= 0.0 {
            return None;
        }
        let z = 1.0 / inverse;
        let residual_m = ((cdd - q * cxd - r * cyd).max(0.0) / n).sqrt() * z * z;
        if residual_m > 2.0 * depth_sigma(z) + 0.002 {
            return None;
        }
        // The plane a X + b Y + c Z = 1 has inverse depth a x + b y + c.
        let normal = -Vector3::new(q, r, p).normalize();
        Some(SurfacePatch { normal, z })
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
        }
    }

    #[test]
    fn there_is_no_normal_across_a_step() {
        let camera =
            PinholeCamera { width: 64, height: 48, cx: 31.5, cy: 23.5, ..PinholeCamera::kinect() };
        let metres = (0..64 * 48).map(|i| if i % 64 < 32 { 1.0 } else { 1.5 }).collect();
        let depth = DepthImage::from_metres(64, 48, metres).unwrap();
        assert_eq!(NormalMap::new(&depth, &camera).at(32, 24), None);
    }
}
