//! The narrow bridge to OpenCV: pictures in, pictures out.

use linkage_frames::ColorImage;
use nalgebra::Matrix3;
use opencv::core::{self, CV_8U, Mat, Size};
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

    /// Another view of the same: `picture_from_view` maps its pixels to those of this one.
    pub fn warped(
        &self,
        picture_from_view: &Matrix3<f64>,
        width: usize,
        height: usize,
    ) -> opencv::Result<Self> {
        let rows = [0, 1, 2].map(|r| [0, 1, 2].map(|c| picture_from_view[(r, c)]));
        let rows = Mat::from_slice_2d(&rows)?;
        let mut out = Mat::default();
        imgproc::warp_perspective(
            &self.0,
            &mut out,
            &rows,
            Size::new(width as i32, height as i32),
            imgproc::INTER_LINEAR | imgproc::WARP_INVERSE_MAP,
            core::BORDER_REPLICATE,
            core::Scalar::default(),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp that brightens by two grey levels a column.
    fn ramp() -> Gray {
        let bytes: Vec<u8> = (0..40 * 30).map(|i| (2 * (i % 40)) as u8).collect();
        Gray::new(40, 30, &bytes).unwrap()
    }

    #[test]
    fn a_picture_keeps_its_size_and_its_bytes() {
        let gray = ramp();
        assert_eq!((gray.width(), gray.height()), (40, 30));
        assert_eq!(gray.bytes().unwrap()[40 * 7 + 5], 10);
    }

    #[test]
    fn a_blur_leaves_a_ramp_and_lowers_a_spike() {
        let mut bytes = vec![0_u8; 40 * 30];
        bytes[40 * 15 + 20] = 200;
        let spike = Gray::new(40, 30, &bytes).unwrap().blurred(1.0).unwrap();
        let at = |gray: &Gray, u: usize| gray.bytes().unwrap()[40 * 15 + u];
        assert!((20..60).contains(&at(&spike, 20)) && at(&spike, 22) > 0);
        assert_eq!(at(&ramp().blurred(1.0).unwrap(), 20), 40);
    }

    #[test]
    fn a_warped_view_shows_what_its_pixels_map_to() {
        let mut picture_from_view = Matrix3::identity();
        picture_from_view[(0, 2)] = 10.0;
        let view = ramp().warped(&picture_from_view, 20, 10).unwrap();
        assert_eq!((view.width(), view.height()), (20, 10));
        assert_eq!(view.bytes().unwrap()[3], 26, "column 13 of the ramp");
    }

    #[test]
    fn a_mask_holds_one_value() {
        let mask = empty_mask(4, 3, 255.0).unwrap();
        assert!(mask.data_typed::<u8>().unwrap().iter().all(|m| *m == 255));
        assert_eq!((mask.cols(), mask.rows()), (4, 3));
    }
}
