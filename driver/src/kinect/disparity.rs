//! Disparities of 11 bits and the distances that they stand for.

use std::sync::LazyLock;

/// The disparity that stands for "no reading".
pub const NO_DISPARITY: u16 = 2047;

/// Distance of the reference plane, millimetres; all constants as libfreenect assumes them.
const REFERENCE_MM: f64 = 1200.0;
/// Size of a pixel on the reference plane, millimetres.
const REFERENCE_PIXEL_MM: f64 = 1.042;
/// Distance from the emitter to the infrared camera, millimetres.
const BASELINE_MM: f64 = 75.0;
/// Disparity of the reference plane, in steps of a quarter of a pixel, and its offset.
const REFERENCE_DISPARITY: f64 = 800.0;
const STEPS_PER_PIXEL: f64 = 4.0;
const OFFSET_PX: f64 = 0.375;

/// Distance of a disparity in metres; 0 where it stands for none.
pub fn metres_of(disparity: u16) -> f32 {
    static METRES: LazyLock<Vec<f32>> =
        LazyLock::new(|| (0..NO_DISPARITY).map(computed_metres).collect());
    METRES.get(usize::from(disparity)).copied().unwrap_or(0.0)
}

fn computed_metres(disparity: u16) -> f32 {
    let shift_px = (f64::from(disparity) - REFERENCE_DISPARITY) / STEPS_PER_PIXEL - OFFSET_PX;
    let shift_mm = shift_px * REFERENCE_PIXEL_MM;
    let mm = REFERENCE_MM * shift_mm / (BASELINE_MM - shift_mm) + REFERENCE_MM;
    if shift_mm < BASELINE_MM && mm > 0.0 { (mm * 1e-3) as f32 } else { 0.0 }
}

/// The disparity nearest to a distance in metres.
pub fn disparity_of(metres: f32) -> u16 {
    if !(metres.is_finite() && metres > 0.0) {
        return NO_DISPARITY;
    }
    let beyond = f64::from(metres) * 1e3 - REFERENCE_MM;
    let shift_mm = BASELINE_MM * beyond / (REFERENCE_MM + beyond);
    let shift_px = shift_mm / REFERENCE_PIXEL_MM;
    let disparity = (shift_px + OFFSET_PX) * STEPS_PER_PIXEL + REFERENCE_DISPARITY;
    (disparity.round().max(0.0) as u16).min(NO_DISPARITY)
}

/// Unpacks values of 11 bits that follow each other, the first bit the highest.
pub fn unpack_11bit(packed: &[u8], count: usize) -> Option<Vec<u16>> {
    if packed.len() * 8 < count * 11 {
        return None;
    }
    let (mut window, mut bits) = (0_u32, 0);
    let mut bytes = packed.iter();
    let mut values = Vec::with_capacity(count);
    while values.len() < count {
        while bits < 11 {
            window = (window << 8) | u32::from(*bytes.next()?);
            bits += 8;
        }
        bits -= 11;
        values.push(((window >> bits) & 0x7ff) as u16);
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn distances_are_those_that_are_known_of_the_sensor() {
        // Burrus' calibration: 0.1236 tan(d / 2842.5 + 1.1863).
        for disparity in [500_u16, 700, 800, 900, 1000] {
            let burrus = 0.1236 * (f64::from(disparity) / 2842.5 + 1.1863).tan();
            let ours = f64::from(metres_of(disparity));
            assert!((ours / burrus - 1.0).abs() < 0.04, "{disparity}: {ours} {burrus}");
        }
        assert_eq!(metres_of(NO_DISPARITY), 0.0);
    }

    #[test]
    fn packed_values_come_out() {
        // 0x555 0x2aa: 10101010101 01010101010
        assert_eq!(
            unpack_11bit(&[0b1010_1010, 0b1010_1010, 0b1010_1000], 2),
            Some(vec![0x555, 0x2aa])
        );
        assert_eq!(unpack_11bit(&[0; 2], 2), None);
    }

    proptest! {
        #[test]
        fn a_disparity_comes_back_from_its_distance(disparity in 300_u16..1080) {
            prop_assert_eq!(disparity_of(metres_of(disparity)), disparity);
        }
    }
}
