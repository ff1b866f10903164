//! Registration: depth seen by one camera as another, some centimetres beside it, would see it.

use crate::camera::PinholeCamera;
use crate::frame::DepthImage;
use nalgebra::Isometry3;

/// Where the depth camera is, seen from the colour camera.
#[derive(Debug, Clone)]
pub struct Registration {
    /// Intrinsics of the depth camera.
    pub depth_camera: PinholeCamera,
    /// Maps the depth camera's coordinates into the colour camera's frame.
    pub color_from_depth: Isometry3<f64>,
}

impl Registration {
    /// Depth in the colour camera's pixels; where several places fall on one pixel the nearest
    /// hides the others, where none does there is no reading.
    pub fn register(&self, depth: &DepthImage, color: &PinholeCamera) -> DepthImage {
        let mut metres = vec![f32::NAN; color.width * color.height];
        for v in 0..depth.height() {
            for u in 0..depth.width() {
                let Some(z) = depth.at(u, v) else { continue };
                let point = self.depth_camera.back_project(u as f64, v as f64, f64::from(z));
                let point = self.color_from_depth * point;
                let Some(pixel) = color.project(&point) else { continue };
                if !color.sees(&pixel, 0.0) {
                    continue;
                }
                let i = pixel.y.round() as usize * color.width + pixel.x.round() as usize;
                let z = point.z as f32;
                if metres[i].is_nan() || z < metres[i] {
                    metres[i] = z;
                }
            }
        }
        DepthImage::from_metres(color.width, color.height, metres)
            .expect("as many values as the camera has pixels")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_stays_a_wall_and_a_near_edge_moves_by_its_parallax() {
        // The two cameras of a Kinect.
        let registration = Registration {
            depth_camera: PinholeCamera { fx: 575.8, fy: 575.8, ..PinholeCamera::kinect() },
            color_from_depth: Isometry3::translation(-0.023, 0.0, 0.0),
        };
        let color = PinholeCamera::kinect();
        // A post one metre away, columns 300 to 340, before a wall three metres away.
        let metres: Vec<f32> = (0..640 * 480)
            .map(|i| if (300..340).contains(&(i % 640)) { 1.0 } else { 3.0 })
            .collect();
        let depth = DepthImage::from_metres(640, 480, metres).unwrap();
        let registered = registration.register(&depth, &color);
        let row: Vec<usize> =
            (0..640).filter(|&u| registered.at(u, 240).is_some_and(|z| z < 2.0)).collect();
        // u' = 525 ((u - 319.5) / 575.8 - 0.023 / z) + 319.5
        let expected = |u: f64| 525.0 * ((u - 319.5) / 575.8 - 0.023) + 319.5;
        assert!((row[0] as f64 - expected(300.0)).abs() <= 1.0, "{}", row[0]);
        assert!((row[row.len() - 1] as f64 - expected(339.0)).abs() <= 1.0);
        assert!(registered.at(600, 100).is_some_and(|z| (z - 3.0).abs() < 1e-5));
    }
}
