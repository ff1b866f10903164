//! Tests whether two pixels show the same surface under different light. The shadow of a drawer and of the hand that
//! pulls it moves over the floor with the drawer: the floor gets darker, but keeps its hue and its pattern. At the
//! border of a shadow, plain floor has more contrast than elsewhere.
//!
//! In: two colour images, and the pixel of the place in each.
//! Out: whether one patch is the other one, darker or brighter; whether both have about the same contrast.

use linkage_frames::ColorImage;

/// Samples of a patch on each side of its pixel.
const HALF: i64 = 3;
/// Distance between the samples of a patch, pixels.
const STEP_PX: i64 = 2;
/// Largest ratio between the brightness of a surface in light and in shadow.
const MAX_FACTOR: f64 = 4.0;
/// Light reflected from walls changes the hue in a shadow by up to this factor.
const MAX_HUE_FACTOR: f64 = 1.25;
/// Largest mean difference of two patches after their brightness is equalised, as a share of it. A pattern that has
/// moved differs by its contrast.
const MAX_DIFFERENCE: f64 = 0.07;
/// Difference that noise explains, in levels of an 8-bit channel.
const NOISE_LEVELS: f64 = 3.0;
/// Contrast may differ by this factor when the patch is misplaced by one or two pixels.
const CONTRAST_FACTOR: f64 = 2.0;
/// Outside these channel values hue is unreliable: under- or overexposed.
const TELLING_LEVELS: [f64; 2] = [12.0, 245.0];

/// True if pixel `a` of one image and pixel `b` of another may show the same place under other light.
pub fn is_same_under_other_light(
    (one, a): (&ColorImage, [f64; 2]),
    (other, b): (&ColorImage, [f64; 2]),
) -> bool {
    let (Some(one), Some(other)) = (Patch::at(one, a), Patch::at(other, b)) else { return false };
    let factor = one.luma() / other.luma();
    let is_shade = factor.max(1.0 / factor) < MAX_FACTOR;
    is_shade && one.has_hue_of(&other, factor) && one.has_pattern_of(&other)
}

/// True if the contrast around pixel `a` of one image is about that around pixel `b` of another.
pub fn has_same_contrast(
    (one, a): (&ColorImage, [f64; 2]),
    (other, b): (&ColorImage, [f64; 2]),
) -> bool {
    let (Some(one), Some(other)) = (Patch::at(one, a), Patch::at(other, b)) else { return false };
    let (one_contrast, other_contrast) = (one.contrast(), other.contrast());
    let noise = NOISE_LEVELS / one.luma().min(other.luma());
    one_contrast.max(other_contrast)
        < CONTRAST_FACTOR * one_contrast.min(other_contrast) + MAX_DIFFERENCE + noise
}

/// Luma and colour of the samples around a pixel.
struct Patch {
    luma: Vec<f64>,
    /// Mean of red, green and blue.
    colour: [f64; 3],
}

impl Patch {
    /// The patch around a pixel; `None` if it is not wholly inside the image.
    fn at(image: &ColorImage, pixel: [f64; 2]) -> Option<Self> {
        let [u, v] = pixel.map(|x| x.round() as i64);
        let offsets = || (-HALF..=HALF).map(|i| i * STEP_PX);
        let pixels = offsets().flat_map(|y| offsets().map(move |x| (u + x, v + y)));
        let (mut luma, mut sum) = (Vec::new(), [0.0; 3]);
        for (x, y) in pixels {
            let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
            luma.push(f64::from(image.luma_at(x, y)?));
            let rgb = image.at(x, y)?;
            sum.iter_mut().zip(rgb).for_each(|(sum, value)| *sum += f64::from(value));
        }
        let colour = sum.map(|s| s / luma.len() as f64);
        Some(Self { luma, colour })
    }

    /// Mean luma, at least one level.
    fn luma(&self) -> f64 {
        (self.luma.iter().sum::<f64>() / self.luma.len() as f64).max(1.0)
    }

    /// Mean absolute deviation of luma from its mean, as a share of the mean.
    fn contrast(&self) -> f64 {
        let mean = self.luma();
        self.luma.iter().map(|x| (x / mean - 1.0).abs()).sum::<f64>() / self.luma.len() as f64
    }

    /// True if each well exposed channel differs from the other patch's by about the ratio of luma.
    fn has_hue_of(&self, other: &Self, factor: f64) -> bool {
        let [least, most] = TELLING_LEVELS;
        self.colour.iter().zip(&other.colour).all(|(a, b)| {
            let tells = a.min(*b) > least && a.max(*b) < most;
            let ratio = a / b.max(1.0) / factor;
            !tells || ratio.max(1.0 / ratio) < MAX_HUE_FACTOR
        })
    }

    /// True if the samples of both patches agree after each is divided by its patch's mean luma.
    fn has_pattern_of(&self, other: &Self) -> bool {
        let (a, b) = (self.luma(), other.luma());
        let differences = self.luma.iter().zip(&other.luma).map(|(x, y)| (x / a - y / b).abs());
        let mean = differences.sum::<f64>() / self.luma.len() as f64;
        mean < MAX_DIFFERENCE + NOISE_LEVELS / a.min(b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 60;

    /// A picture of planks of two browns, `shift` pixels to the right, in a light.
    fn planks(shift: usize, light: [f64; 3], contrast: f64) -> ColorImage {
        let rgb = (0..SIZE * SIZE).flat_map(|i| {
            let is_dark = ((i % SIZE + SIZE - shift) / 5).is_multiple_of(2);
            let plank = if is_dark { 1.0 - contrast } else { 1.0 };
            [0, 1, 2].map(|k| (plank * light[k] * [200.0, 150.0, 100.0][k]) as u8)
        });
        ColorImage::new(SIZE, SIZE, rgb.collect()).unwrap()
    }

    fn is_same(a: &ColorImage, b: &ColorImage) -> bool {
        is_same_under_other_light((a, [30.0, 30.0]), (b, [30.0, 30.0]))
    }

    #[test]
    fn a_floor_in_shadow_is_the_floor() {
        for contrast in [0.0, 0.3] {
            let lit = planks(0, [1.0; 3], contrast);
            assert!(is_same(&lit, &planks(0, [0.5; 3], contrast)), "in shadow");
            assert!(is_same(&planks(0, [0.4, 0.42, 0.45], contrast), &lit), "lit by the walls");
        }
    }

    #[test]
    fn a_pattern_that_has_slid_is_another_place() {
        assert!(!is_same(&planks(0, [1.0; 3], 0.3), &planks(5, [0.6; 3], 0.3)));
        assert!(is_same(&planks(0, [1.0; 3], 0.0), &planks(5, [0.6; 3], 0.0)), "nothing tells");
    }

    #[test]
    fn what_has_another_hue_is_another_surface() {
        let lit = planks(0, [1.0; 3], 0.0);
        assert!(!is_same(&lit, &planks(0, [0.4, 0.6, 1.0], 0.0)));
        assert!(!is_same(&lit, &planks(0, [0.1; 3], 0.0)), "too dark for a shadow");
    }

    #[test]
    fn the_border_of_a_shadow_has_more_contrast_than_the_floor_beside_it() {
        let at = [30.0, 30.0];
        let (lit, dark) = (planks(0, [1.0; 3], 0.0), planks(0, [0.4; 3], 0.0));
        let mut rgb = lit.as_rgb().to_vec();
        for row in rgb.chunks_exact_mut(3 * SIZE) {
            row[..3 * 30].copy_from_slice(&dark.as_rgb()[..3 * 30]);
        }
        let border = ColorImage::new(SIZE, SIZE, rgb).unwrap();
        assert!(!has_same_contrast((&border, at), (&lit, at)));
        assert!(has_same_contrast((&dark, at), (&lit, at)));
        let pattern = planks(0, [1.0; 3], 0.3);
        assert!(has_same_contrast((&pattern, at), (&pattern, [32.0, 31.0])), "a little beside it");
    }

    #[test]
    fn at_the_border_of_a_picture_nothing_is_told() {
        let lit = planks(0, [1.0; 3], 0.0);
        assert!(!is_same_under_other_light((&lit, [2.0, 30.0]), (&lit, [30.0, 30.0])));
    }
}
