//! Mosaics of colour cameras: each pixel of the sensor sees one colour, in cells of 2x2 pixels with
//! one red, one blue and two green ones.
//!
//! In: a mosaic of 8 or 16 bits. Out: RGB, each colour the mean of the nearest pixels that saw it
//! (bilinear), computed in bytes. Of the crates that do this, `demosaic` 0.3 takes and gives `f32`, for
//! photographs, and `bayer` 0.1.5 is of 2017 and needs rayon 0.8.

/// Values of 16 bits in one of 8: 65535 becomes 255.
const STEPS_16_IN_8: u16 = 257;

/// Which pixels of a cell see which colour: the first row, then the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BayerPattern {
    /// Red, green; green, blue.
    Rggb,
    /// Blue, green; green, red.
    Bggr,
    /// Green, blue; red, green.
    Gbrg,
    /// Green, red; blue, green.
    Grbg,
}

impl BayerPattern {
    /// The pattern in a name of ROS, `bayer_rggb8` or `bayer_rggb16`, and its bits a pixel.
    pub fn of_encoding(encoding: &str) -> Option<(Self, usize)> {
        let (name, bits) = encoding.strip_prefix("bayer_")?.split_at_checked(4)?;
        let pattern = match name {
            "rggb" => Self::Rggb,
            "bggr" => Self::Bggr,
            "gbrg" => Self::Gbrg,
            "grbg" => Self::Grbg,
            _ => return None,
        };
        match bits {
            "8" => Some((pattern, 8)),
            "16" => Some((pattern, 16)),
            _ => None,
        }
    }

    /// Column and row of the red pixel in a cell; the blue one is at the opposite corner.
    fn red(self) -> (usize, usize) {
        match self {
            Self::Rggb => (0, 0),
            Self::Bggr => (1, 1),
            Self::Gbrg => (0, 1),
            Self::Grbg => (1, 0),
        }
    }
}

/// A pixel of 16 bits in 8, to the nearest.
pub fn to_8_bits(value: u16) -> u8 {
    // At most (65535 + 128) / 257 = 255.
    ((u32::from(value) + u32::from(STEPS_16_IN_8 / 2)) / u32::from(STEPS_16_IN_8)) as u8
}

/// Colours of a mosaic; RGB, top row first. `None` when the mosaic does not hold `width * height`
/// bytes or is smaller than a cell.
pub fn demosaic(
    pattern: BayerPattern,
    mosaic: &[u8],
    width: usize,
    height: usize,
) -> Option<Vec<u8>> {
    if width < 2 || height < 2 || mosaic.len() != width.checked_mul(height)? {
        return None;
    }
    let (red_u, red_v) = pattern.red();
    let mut rgb = Vec::with_capacity(mosaic.len() * 3);
    for v in 0..height {
        let row = |v: usize| &mosaic[v * width..][..width];
        let (up, down) = neighbours(v, height);
        let (above, here, below) = (row(up), row(v), row(down));
        for u in 0..width {
            let (left, right) = neighbours(u, width);
            let own = here[u];
            let across = mean([here[left], here[right]]);
            let along = mean([above[u], below[u]]);
            let beside = mean([here[left], here[right], above[u], below[u]]);
            let corners = mean([above[left], above[right], below[left], below[right]]);
            rgb.extend(match (u % 2 == red_u, v % 2 == red_v) {
                (true, true) => [own, beside, corners],
                (false, true) => [across, own, along],
                (true, false) => [along, own, across],
                (false, false) => [corners, beside, own],
            });
        }
    }
    Some(rgb)
}

/// The places before and behind one; mirrored about the border, which keeps the pattern.
fn neighbours(at: usize, side: usize) -> (usize, usize) {
    (if at == 0 { 1 } else { at - 1 }, if at + 1 == side { at - 1 } else { at + 1 })
}

fn mean<const N: usize>(values: [u8; N]) -> u8 {
    // A mean of bytes is a byte.
    (values.iter().map(|v| u16::from(*v)).sum::<u16>() / N as u16) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATTERNS: [(&str, BayerPattern); 4] = [
        ("rggb", BayerPattern::Rggb),
        ("bggr", BayerPattern::Bggr),
        ("gbrg", BayerPattern::Gbrg),
        ("grbg", BayerPattern::Grbg),
    ];

    /// What a sensor sees of a picture: of each pixel the colour that the pattern's letters name.
    fn mosaic(letters: &str, width: usize, rgb: &[[u8; 3]]) -> Vec<u8> {
        let seen = |(i, pixel): (usize, &[u8; 3])| {
            let (u, v) = (i % width, i / width);
            match letters.as_bytes()[2 * (v % 2) + u % 2] {
                b'r' => pixel[0],
                b'g' => pixel[1],
                _ => pixel[2],
            }
        };
        rgb.iter().enumerate().map(seen).collect()
    }

    #[test]
    fn a_plain_colour_comes_back_in_every_pattern_and_to_the_border() {
        let colour = [200_u8, 120, 40];
        for (letters, pattern) in PATTERNS {
            for (width, height) in [(6, 4), (5, 3), (2, 2)] {
                let seen = mosaic(letters, width, &vec![colour; width * height]);
                let rgb = demosaic(pattern, &seen, width, height).unwrap();
                assert!(rgb.chunks_exact(3).all(|p| p == colour), "{letters}: {rgb:?}");
            }
        }
    }

    #[test]
    fn colours_that_rise_evenly_come_back_inside_the_border() {
        let (width, height) = (8, 6);
        let pixel = |i: usize| {
            let (u, v) = ((i % width) as u8, (i / width) as u8);
            [10 + 4 * u, 20 + 6 * v, 100 + 2 * u + 8 * v]
        };
        let picture: Vec<[u8; 3]> = (0..width * height).map(pixel).collect();
        for (letters, pattern) in PATTERNS {
            let rgb = demosaic(pattern, &mosaic(letters, width, &picture), width, height).unwrap();
            let (pixels, _) = rgb.as_chunks::<3>();
            for v in 1..height - 1 {
                let row = v * width + 1..(v + 1) * width - 1;
                assert_eq!(pixels[row.clone()], picture[row], "{letters}, row {v}");
            }
        }
    }

    #[test]
    fn names_of_ros_tell_the_pattern_and_the_bits() {
        for (letters, pattern) in PATTERNS {
            let of = |bits| BayerPattern::of_encoding(&format!("bayer_{letters}{bits}"));
            assert_eq!((of("8"), of("16")), (Some((pattern, 8)), Some((pattern, 16))));
        }
        for other in ["bayer_rgbg8", "bayer_rggb12", "bayer_", "rggb8", "bayer_ß®g8"] {
            assert_eq!(BayerPattern::of_encoding(other), None, "{other}");
        }
    }

    #[test]
    fn sixteen_bits_become_eight_to_the_nearest() {
        let values = [0, 128, 129, 257, 32_768, 65_406, 65_407, 65_535];
        assert_eq!(values.map(to_8_bits), [0, 0, 1, 1, 128, 254, 255, 255]);
    }

    #[test]
    fn a_mosaic_of_another_size_or_smaller_than_a_cell_is_none() {
        for (bytes, width, height) in [(24, 6, 5), (6, 6, 1), (6, 1, 6), (0, 0, 0)] {
            assert_eq!(demosaic(BayerPattern::Rggb, &vec![0; bytes], width, height), None);
        }
        assert_eq!(demosaic(BayerPattern::Rggb, &[0; 4], usize::MAX, 4), None);
    }
}
