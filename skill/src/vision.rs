//! The narrow bridge to OpenCV: pictures in, pictures out.

use linkage_driver::ColorImage;
use opencv::core::{self, CV_8U, DataType, Mat, Size, Vec2f, Vec3b, Vector};
use opencv::imgproc;
use opencv::prelude::*;

/// An 8-bit grey picture that OpenCV can read.
pub struct Gray(Mat);

impl Gray {
    /// Takes `width * height` bytes, top row first.
    pub fn new(width: usize, height: usize, bytes: &[u8]) -> opencv::Result<Self> {
        debug_assert_eq!(bytes.len(), width * height);
        let rows = Mat::new_rows_cols_with_data(height as i32, width as i32, bytes)?;
        Ok(Self(rows.try_clone()?))
    }

    /// Luma of a colour picture.
    pub fn from_color(color: &ColorImage) -> opencv::Result<Self> {
        Self::new(color.width(), color.height(), &color.to_gray())
    }

    /// Slightly blurred: less noise for gradients.
    pub fn blurred(&self, sigma_px: f64) -> opencv::Result<Self> {
        let mut out = Mat::default();
        imgproc::gaussian_blur(
            &self.0,
            &mut out,
            Size::new(0, 0),
            sigma_px,
            sigma_px,
            core::BORDER_DEFAULT,
        )?;
        Ok(Self(out))
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.0.cols() as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.0.rows() as usize
    }

    /// The picture for OpenCV.
    pub fn mat(&self) -> &Mat {
        &self.0
    }

    /// All bytes, top row first.
    pub fn bytes(&self) -> opencv::Result<&[u8]> {
        self.0.data_typed::<u8>()
    }
}

/// A mask of zeros.
pub fn empty_mask(width: usize, height: usize, value: f64) -> opencv::Result<Mat> {
    Mat::new_rows_cols_with_default(height as i32, width as i32, CV_8U, core::Scalar::all(value))
}

/// 5x5 median of each flow component (Wang et al. 2011, as the paper cites it).
pub fn median_blur_flow(flow: &Mat) -> opencv::Result<Mat> {
    let mut components: Vector<Mat> = Vector::new();
    core::split(flow, &mut components)?;
    let mut smoothed: Vector<Mat> = Vector::new();
    for component in &components {
        let mut out = Mat::default();
        imgproc::median_blur(&component, &mut out, 5)?;
        smoothed.push(out);
    }
    let mut merged = Mat::default();
    core::merge(&smoothed, &mut merged)?;
    debug_assert_eq!(merged.typ(), Vec2f::opencv_type());
    Ok(merged)
}

/// A picture in CIE L*a*b*, slightly blurred, L* from 0 to 100.
pub struct LabPicture {
    width: usize,
    values: Vec<Vec3b>,
}

impl LabPicture {
    /// Lightness between pixels; `None` outside.
    pub fn lightness(&self, u: f64, v: f64) -> Option<f64> {
        let (left, top) = (u.floor(), v.floor());
        let height = self.values.len() / self.width.max(1);
        let inside = left >= 0.0
            && top >= 0.0
            && left + 1.0 < self.width as f64
            && top + 1.0 < height as f64;
        if !inside {
            return None;
        }
        let first = top as usize * self.width + left as usize;
        let (a, b) = (u - left, v - top);
        let at = |i: usize| f64::from(self.values[i].0[0]);
        let above = at(first) * (1.0 - a) + at(first + 1) * a;
        let below = at(first + self.width) * (1.0 - a) + at(first + self.width + 1) * a;
        Some((above * (1.0 - b) + below * b) * (100.0 / 255.0))
    }

    /// The colour at a pixel inside the picture.
    pub fn at(&self, u: usize, v: usize) -> [f32; 3] {
        let [l, a, b] = self.values[v * self.width + u].0.map(f32::from);
        [l * (100.0 / 255.0), a - 128.0, b - 128.0]
    }
}

/// Converts a colour picture.
pub fn lab_picture(color: &ColorImage) -> opencv::Result<LabPicture> {
    let rgb = Mat::from_slice(color.as_rgb())?;
    let rgb = rgb.reshape(3, color.height() as i32)?;
    let (mut lab, mut blurred) = (Mat::default(), Mat::default());
    let kernel = Size::new(0, 0);
    imgproc::gaussian_blur(&rgb, &mut blurred, kernel, 1.2, 1.2, core::BORDER_DEFAULT)?;
    imgproc::cvt_color(&blurred, &mut lab, imgproc::COLOR_RGB2Lab, 0)?;
    Ok(LabPicture { width: color.width(), values: lab.data_typed::<Vec3b>()?.to_vec() })
}
