//! Pictures in CIE L*a*b*, from sRGB under daylight (D65). OpenCV's conversion fills tables for a
//! tenth of a second before the first picture.

use linkage_driver::ColorImage;
use opencv::core::{BORDER_DEFAULT, Mat, Size};
use opencv::imgproc;
use opencv::prelude::*;
use rayon::prelude::*;
use std::sync::LazyLock;

/// Blur that takes the noise of single pixels, pixels.
const BLUR_PX: f64 = 1.2;

/// A slightly blurred picture, L* from 0 to 100.
pub struct LabPicture {
    width: usize,
    /// L* of 100 as 255, a* and b* from -128.
    values: Vec<[u8; 3]>,
}

impl LabPicture {
    /// Of a colour picture.
    ///
    /// # Errors
    /// Whatever the vision library says.
    pub fn new(color: &ColorImage) -> opencv::Result<Self> {
        let rgb = Mat::from_slice(color.as_rgb())?;
        let rgb = rgb.reshape(3, color.height() as i32)?;
        let mut blurred = Mat::default();
        let kernel = Size::new(0, 0);
        imgproc::gaussian_blur(&rgb, &mut blurred, kernel, BLUR_PX, BLUR_PX, BORDER_DEFAULT)?;
        let (pixels, _) = blurred.data_bytes()?.as_chunks::<3>();
        let values = pixels.par_iter().with_min_len(1 << 14).map(|rgb| TABLES.lab(*rgb)).collect();
        Ok(Self { width: color.width(), values })
    }

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
        let at = |i: usize| f64::from(self.values[i][0]);
        let above = at(first) * (1.0 - a) + at(first + 1) * a;
        let below = at(first + self.width) * (1.0 - a) + at(first + self.width + 1) * a;
        Some((above * (1.0 - b) + below * b) * (100.0 / 255.0))
    }

    /// The colour at a pixel inside the picture.
    pub fn at(&self, u: usize, v: usize) -> [f32; 3] {
        let [l, a, b] = self.values[v * self.width + u].map(f32::from);
        [l * (100.0 / 255.0), a - 128.0, b - 128.0]
    }
}

/// Steps of the table of cube roots: between them it is straight to 1e-5.
const STEPS: usize = 4096;

static TABLES: LazyLock<Tables> = LazyLock::new(Tables::new);

struct Tables {
    /// Light of each value of sRGB, 0 to 1.
    linear: [f32; 256],
    /// The curve of CIE 15, cube roots above a straight start, of 0 to 1.
    curve: [f32; STEPS + 2],
}

impl Tables {
    fn new() -> Self {
        let light = |value: usize| match value as f32 / 255.0 {
            dark if dark <= 0.04045 => dark / 12.92,
            v => ((v + 0.055) / 1.055).powf(2.4),
        };
        let curve = |step: usize| match step as f32 / STEPS as f32 {
            dark if dark <= 0.008_856 => 7.787 * dark + 16.0 / 116.0,
            t => t.cbrt(),
        };
        Self { linear: std::array::from_fn(light), curve: std::array::from_fn(curve) }
    }

    fn lab(&self, rgb: [u8; 3]) -> [u8; 3] {
        let [r, g, b] = rgb.map(|value| self.linear[usize::from(value)]);
        // To XYZ as shares of white.
        let x = self.curved(0.433_953 * r + 0.376_219 * g + 0.189_828 * b);
        let y = self.curved(0.212_671 * r + 0.715_160 * g + 0.072_169 * b);
        let z = self.curved(0.017_758 * r + 0.109_477 * g + 0.872_766 * b);
        let lab = [(116.0 * y - 16.0) * 2.55, 500.0 * (x - y) + 128.0, 200.0 * (y - z) + 128.0];
        lab.map(|value| (value + 0.5) as u8)
    }

    fn curved(&self, share: f32) -> f32 {
        let place = share * STEPS as f32;
        let (step, rest) = (place as usize, place.fract());
        self.curve[step] * (1.0 - rest) + self.curve[step + 1] * rest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opencv::core::Vec3b;

    #[test]
    fn colours_are_what_opencv_makes_of_them() {
        let steps = || (0..=255_u8).step_by(15);
        let colours: Vec<[u8; 3]> = steps()
            .flat_map(|r| steps().flat_map(move |g| steps().map(move |b| [r, g, b])))
            .collect();
        let rgb = Mat::from_slice(colours.as_flattened()).unwrap();
        let rgb = rgb.reshape(3, colours.len() as i32).unwrap();
        let mut theirs = Mat::default();
        imgproc::cvt_color(&rgb, &mut theirs, imgproc::COLOR_RGB2Lab, 0).unwrap();
        for (colour, theirs) in colours.iter().zip(theirs.data_typed::<Vec3b>().unwrap()) {
            let ours = TABLES.lab(*colour);
            // Theirs are read between steps of a coarse table.
            let off = ours.iter().zip(theirs.0).map(|(a, b)| a.abs_diff(b)).max();
            assert!(off <= Some(3), "{colour:?} is {ours:?} for {theirs:?}");
        }
    }

    #[test]
    fn white_grey_and_black_have_no_colour() {
        for (grey, lightness) in [(0, 0), (119, 128), (255, 255)] {
            assert_eq!(TABLES.lab([grey; 3]), [lightness, 128, 128]);
        }
    }
}
