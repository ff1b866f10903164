//! One RGB-D frame: colour and depth of the same instant, in the same pixels.

use crate::camera::PinholeCamera;
use crate::depth_bounds::DepthBounds;
use crate::frame_error::FrameError;
use nalgebra::Point3;
use std::sync::{Arc, OnceLock};

/// Refuses a picture whose columns and rows are not the camera's; asked before memory is taken
/// for its pixels.
///
/// # Errors
/// [`FrameError::SizeMismatch`].
pub fn same_size(
    what: &'static str,
    (found_width, found_height): (usize, usize),
    (width, height): (usize, usize),
) -> Result<(), FrameError> {
    if (found_width, found_height) == (width, height) {
        return Ok(());
    }
    Err(FrameError::SizeMismatch { what, found_width, found_height, width, height })
}

/// An 8-bit RGB picture, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColorImage {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl ColorImage {
    /// Takes `width * height` RGB triples, top row first.
    ///
    /// # Errors
    /// [`FrameError::BufferSize`] when the buffer does not hold exactly that many.
    pub fn new(width: usize, height: usize, rgb: Vec<u8>) -> Result<Self, FrameError> {
        let needed = width.saturating_mul(height).saturating_mul(3);
        if rgb.len() != needed {
            return Err(FrameError::BufferSize {
                what: "colour",
                width,
                height,
                needed,
                found: rgb.len(),
            });
        }
        Ok(Self { width, height, rgb })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, RGB interleaved, top row first.
    pub fn as_rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// The pixel at column `u`, row `v`; `None` outside.
    pub fn at(&self, u: usize, v: usize) -> Option<[u8; 3]> {
        if u >= self.width || v >= self.height {
            return None;
        }
        let i = (v * self.width + u) * 3;
        Some([self.rgb[i], self.rgb[i + 1], self.rgb[i + 2]])
    }

    /// Luma (ITU-R BT.601) at column `u`, row `v`; `None` outside.
    #[inline]
    pub fn luma_at(&self, u: usize, v: usize) -> Option<u8> {
        self.at(u, v).map(luma)
    }

    /// Luma (ITU-R BT.601), one byte a pixel.
    pub fn to_gray(&self) -> Vec<u8> {
        self.rgb.chunks_exact(3).map(|p| luma([p[0], p[1], p[2]])).collect()
    }
}

fn luma([r, g, b]: [u8; 3]) -> u8 {
    ((u32::from(r) * 299 + u32::from(g) * 587 + u32::from(b) * 114 + 500) / 1000) as u8
}

/// Depth along the optical axis in metres. "No reading" is `None` in the interface and NaN in
/// memory, so that a sum over it is NaN and does not count it as a distance of zero.
#[derive(Debug, Clone)]
pub struct DepthImage {
    width: usize,
    height: usize,
    metres: Vec<f32>,
    bounds: OnceLock<DepthBounds>,
}

impl DepthImage {
    /// Takes metres; anything that is not finite and above zero becomes "no reading".
    ///
    /// # Errors
    /// [`FrameError::BufferSize`] when the buffer is not `width * height` long.
    pub fn from_metres(
        width: usize,
        height: usize,
        mut metres: Vec<f32>,
    ) -> Result<Self, FrameError> {
        let needed = width.saturating_mul(height);
        if metres.len() != needed {
            return Err(FrameError::BufferSize {
                what: "depth",
                width,
                height,
                needed,
                found: metres.len(),
            });
        }
        for z in &mut metres {
            if !(z.is_finite() && *z > 0.0) {
                *z = f32::NAN;
            }
        }
        Ok(Self { width, height, metres, bounds: OnceLock::new() })
    }

    /// Takes raw sensor units, 0 meaning "no reading".
    ///
    /// # Errors
    /// [`FrameError::BufferSize`] when the buffer is not `width * height` long.
    pub fn from_raw(
        width: usize,
        height: usize,
        raw: &[u16],
        units_per_metre: f64,
    ) -> Result<Self, FrameError> {
        let scale = (1.0 / units_per_metre) as f32;
        Self::from_metres(width, height, raw.iter().map(|&r| f32::from(r) * scale).collect())
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Depth in metres at column `u`, row `v`; `None` outside and where the sensor saw nothing.
    #[inline]
    pub fn at(&self, u: usize, v: usize) -> Option<f32> {
        if u >= self.width || v >= self.height {
            return None;
        }
        let z = self.metres[v * self.width + u];
        (!z.is_nan()).then_some(z)
    }

    /// Depth at the pixel nearest to a sub-pixel position.
    #[inline]
    pub fn at_nearest(&self, u: f64, v: f64) -> Option<f32> {
        let (u, v) = (u + 0.5, v + 0.5);
        if !(u > 0.0 && v > 0.0) {
            return None;
        }
        self.at(u as usize, v as usize)
    }

    /// All values in metres, NaN where the sensor saw nothing; top row first.
    pub fn as_metres(&self) -> &[f32] {
        &self.metres
    }

    /// The readings around each place; computed when they are asked for first, and kept: half as much memory again.
    pub fn bounds(&self) -> &DepthBounds {
        self.bounds.get_or_init(|| DepthBounds::of(self.width, self.height, &self.metres))
    }

    /// Raw sensor units, 0 where there is no reading or more than 16 bits can say.
    pub fn to_raw(&self, units_per_metre: f64) -> Vec<u16> {
        let scale = units_per_metre as f32;
        self.metres
            .iter()
            .map(|z| (z * scale).round())
            .map(|r| if r <= f32::from(u16::MAX) { r as u16 } else { 0 })
            .collect()
    }

    /// Share of pixels without a reading, 0 to 1.
    pub fn invalid_share(&self) -> f64 {
        self.metres.iter().filter(|z| z.is_nan()).count() as f64 / self.metres.len().max(1) as f64
    }
}

/// Colour and depth of one instant, registered to one camera.
#[derive(Debug, Clone)]
pub struct RgbdFrame {
    /// Time of the colour exposure in microseconds.
    pub utime: i64,
    /// The camera that both images belong to.
    pub camera: Arc<PinholeCamera>,
    /// Colour.
    pub color: ColorImage,
    /// Depth, registered to colour.
    pub depth: DepthImage,
}

impl RgbdFrame {
    /// Puts a frame together.
    ///
    /// # Errors
    /// [`FrameError::SizeMismatch`] unless camera, colour and depth have one size.
    pub fn new(
        utime: i64,
        camera: Arc<PinholeCamera>,
        color: ColorImage,
        depth: DepthImage,
    ) -> Result<Self, FrameError> {
        let wanted = (camera.width, camera.height);
        same_size("colour", (color.width, color.height), wanted)?;
        same_size("depth", (depth.width, depth.height), wanted)?;
        Ok(Self { utime, camera, color, depth })
    }

    /// Time in seconds.
    pub fn seconds(&self) -> f64 {
        self.utime as f64 * 1e-6
    }

    /// The surface point seen at column `u`, row `v`, in the camera frame.
    pub fn point_at(&self, u: usize, v: usize) -> Option<Point3<f64>> {
        let z = f64::from(self.depth.at(u, v)?);
        Some(self.camera.back_project(u as f64, v as f64, z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_depth_of_zero_or_nan_is_no_reading() {
        let depth = DepthImage::from_metres(4, 1, vec![0.0, f32::NAN, -1.0, 1.5]).unwrap();
        assert_eq!([0, 1, 2, 3].map(|u| depth.at(u, 0)), [None, None, None, Some(1.5)]);
        assert_eq!(depth.at(4, 0), None);
        assert_eq!(depth.invalid_share(), 0.75);
    }

    #[test]
    fn depth_of_another_size_than_colour_is_refused() {
        let camera = Arc::new(PinholeCamera::kinect());
        let color = ColorImage::new(640, 480, vec![0; 640 * 480 * 3]).unwrap();
        let depth = DepthImage::from_raw(320, 240, &vec![1; 320 * 240], 1000.0).unwrap();
        let error = RgbdFrame::new(0, camera, color, depth).unwrap_err();
        assert!(error.to_string().contains("depth is 320x240"), "{error}");
    }
}
