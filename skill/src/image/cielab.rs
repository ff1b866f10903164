//! Pictures in CIE L*a*b*, from sRGB under daylight (D65). OpenCV's conversion fills tables for a
//! tenth of a second before the first picture.

use linkage_frames::ColorImage;
use opencv::core::{BORDER_DEFAULT, Mat, Size};
use opencv::imgproc;
use opencv::prelude::*;
use rayon::prelude::*;
use std::sync::LazyLock;

/// Blur that takes the noise of single pixels, pixels.
const BLUR_PX: f64 = 1.2;

/// A slightly blurred picture, L* from 0 to 100.
pub struct CielabImage {
    width: usize,
    /// L* of 100 as 255, a* and b* from -128.
    values: Vec<[u8; 3]>,
}

impl CielabImage {
    /// Converts a colour picture.
    ///
    /// # Errors
    /// The error of the vision library.
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

/// Steps of the tables' light: one is a quarter of a level of a* where the curve is steepest.
const STEPS: usize = 1 << 14;
/// One, in numbers of 16 binary places.
const ONE: i32 = 1 << 16;

static TABLES: LazyLock<Tables> = LazyLock::new(Tables::new);

/// Integers throughout: a picture is converted for each frame.
struct Tables {
    /// Light of each value of sRGB, 0 to [`STEPS`].
    linear: [u32; 256],
    /// The curve of CIE 15 of each light, cube roots above a straight start, 0 to [`ONE`].
    curve: Vec<i32>,
}

impl Tables {
    fn new() -> Self {
        let light = |value: usize| match value as f64 / 255.0 {
            dark if dark <= 0.04045 => dark / 12.92,
            v => ((v + 0.055) / 1.055).powf(2.4),
        };
        let curve = |step: usize| match step as f64 / STEPS as f64 {
            dark if dark <= 0.008_856 => 7.787 * dark + 16.0 / 116.0,
            t => t.cbrt(),
        };
        Self {
            linear: std::array::from_fn(|value| (light(value) * STEPS as f64).round() as u32),
            curve: (0..=STEPS).map(|step| (curve(step) * f64::from(ONE)).round() as i32).collect(),
        }
    }

    fn lab(&self, rgb: [u8; 3]) -> [u8; 3] {
        let light = rgb.map(|value| self.linear[usize::from(value)]);
        // To XYZ as shares of white, each row a whole.
        let curved = |weights: [u32; 3]| {
            let [r, g, b] = std::array::from_fn(|i| weights[i] * light[i]);
            self.curve[((r + g + b) >> 16) as usize]
        };
        let x = curved([28_440, 24_655, 12_441]);
        let y = curved([13_938, 46_868, 4_730]);
        let z = curved([1_164, 7_175, 57_197]);
        let half = ONE / 2;
        // 255 for 100: 2.55 is 51 twentieths.
        let lightness = (116 * y - 16 * ONE) / 20 * 51;
        [lightness, 500 * (x - y) + 128 * ONE, 200 * (y - z) + 128 * ONE]
            .map(|value| ((value + half) >> 16).clamp(0, 255) as u8)
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
