//! The pinhole camera with Brown's distortion.

use crate::source::SourceError;
use nalgebra::{Point2, Point3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A camera that cannot be one.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The description could not be read or holds keys that are not known.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: String,
        /// What is wrong, with what would be right.
        reason: String,
    },
    /// A value that no camera has.
    #[error("camera {key} is {value}: it must be {needed}")]
    Value {
        /// The key in camera.toml.
        key: &'static str,
        /// The value found.
        value: f64,
        /// What it must be.
        needed: &'static str,
    },
}

/// Intrinsics in pixels; the centre of the top-left pixel is (0, 0).
///
/// Distortion is Brown's `[k1, k2, p1, p2, k3]` on normalised coordinates, as OpenCV has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PinholeCamera {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
    /// Raw depth units in a metre (5000 in the TUM layout, 1000 for millimetres).
    pub depth_units_per_metre: f64,
    /// `[k1, k2, p1, p2, k3]`, all zero when absent.
    #[serde(default)]
    pub distortion: [f64; 5],
}

impl PinholeCamera {
    /// The usual values of a Kinect registered to its colour camera (DESIGN 4.1).
    pub fn kinect() -> Self {
        Self {
            width: 640,
            height: 480,
            fx: 525.0,
            fy: 525.0,
            cx: 319.5,
            cy: 239.5,
            depth_units_per_metre: 5000.0,
            distortion: [0.0; 5],
        }
    }

    /// Reads `camera.toml`.
    ///
    /// # Errors
    /// [`CameraError::File`] when it cannot be read, is no TOML or has unknown keys;
    /// [`CameraError::Value`] when a value makes no camera.
    pub fn read(path: &Path) -> Result<Self, CameraError> {
        let file = |reason: String| CameraError::File { path: path.display().to_string(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| file(e.to_string()))?;
        Self::parse(&text).map_err(file)
    }

    /// Reads the text of a `camera.toml`.
    ///
    /// # Errors
    /// What is wrong with it, in a line.
    pub fn parse(text: &str) -> Result<Self, String> {
        let camera: Self = toml::from_str(text).map_err(|e| one_line(&e.to_string()))?;
        camera.check().map_err(|e| e.to_string())?;
        Ok(camera)
    }

    /// Reads `camera.toml`, with the keys that it may hold in the error.
    ///
    /// # Errors
    /// [`SourceError::Recording`].
    pub fn read_or_explain(path: &Path) -> Result<Self, SourceError> {
        Self::read(path).map_err(|e| SourceError::Recording {
            path: e.to_string(),
            reason: "known keys: width height fx fy cx cy depth_units_per_metre distortion"
                .to_owned(),
        })
    }

    /// Refuses values that make no camera.
    ///
    /// # Errors
    /// [`CameraError::Value`] names the key, its value and what it must be.
    pub fn check(&self) -> Result<(), CameraError> {
        let positive = "finite and above 0";
        for (key, value) in [
            ("width", self.width as f64),
            ("height", self.height as f64),
            ("fx", self.fx),
            ("fy", self.fy),
            ("depth_units_per_metre", self.depth_units_per_metre),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(CameraError::Value { key, value, needed: positive });
            }
        }
        for (key, value, extent) in
            [("cx", self.cx, self.width as f64), ("cy", self.cy, self.height as f64)]
        {
            if !(value > 0.0 && value < extent) {
                return Err(CameraError::Value { key, value, needed: "inside the picture" });
            }
        }
        match self.distortion.iter().find(|k| !k.is_finite()) {
            Some(&value) => Err(CameraError::Value { key: "distortion", value, needed: "finite" }),
            None => Ok(()),
        }
    }

    /// Pixel at which a point of the camera frame appears; `None` behind the camera.
    #[inline]
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Point2<f64>> {
        if point_in_camera.z <= 1e-6 {
            return None;
        }
        let x = point_in_camera.x / point_in_camera.z;
        let y = point_in_camera.y / point_in_camera.z;
        let (x, y) = self.distort(x, y);
        Some(Point2::new(self.fx * x + self.cx, self.fy * y + self.cy))
    }

    /// The point of the camera frame at depth `z` metres seen at pixel (`u`, `v`).
    #[inline]
    pub fn back_project(&self, u: f64, v: f64, z: f64) -> Point3<f64> {
        let (x, y) = self.undistort((u - self.cx) / self.fx, (v - self.cy) / self.fy);
        Point3::new(x * z, y * z, z)
    }

    /// True when the pixel lies inside the picture by `margin` pixels.
    #[inline]
    pub fn sees(&self, pixel: &Point2<f64>, margin: f64) -> bool {
        pixel.x >= margin
            && pixel.y >= margin
            && pixel.x <= self.width as f64 - 1.0 - margin
            && pixel.y <= self.height as f64 - 1.0 - margin
    }

    #[inline]
    fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        if self.distortion == [0.0; 5] {
            return (x, y);
        }
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    #[inline]
    fn undistort(&self, xd: f64, yd: f64) -> (f64, f64) {
        if self.distortion == [0.0; 5] {
            return (xd, yd);
        }
        let (mut x, mut y) = (xd, yd);
        for _ in 0..20 {
            let (ex, ey) = self.distort(x, y);
            x += xd - ex;
            y += yd - ey;
        }
        (x, y)
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn projecting_what_was_back_projected_gives_the_same_pixel(
            u in 5.0..635.0, v in 5.0..475.0, z in 0.4..6.0,
            k1 in -0.1..0.1, p1 in -0.005..0.005,
        ) {
            let camera = PinholeCamera {
                distortion: [k1, 0.02, p1, -0.001, 0.0],
                ..PinholeCamera::kinect()
            };
            let point = camera.back_project(u, v, z);
            let pixel = camera.project(&point).unwrap();
            prop_assert!((pixel.x - u).abs() < 1e-4 && (pixel.y - v).abs() < 1e-4);
            prop_assert!((point.z - z).abs() < 1e-12);
        }
    }

    #[test]
    fn a_point_behind_the_camera_has_no_pixel() {
        assert_eq!(PinholeCamera::kinect().project(&Point3::new(0.0, 0.0, -1.0)), None);
    }

    #[test]
    fn a_focal_length_of_zero_is_refused_by_name() {
        let camera = PinholeCamera { fx: 0.0, ..PinholeCamera::kinect() };
        assert_eq!(
            camera.check().unwrap_err().to_string(),
            "camera fx is 0: it must be finite and above 0"
        );
    }
}
