//! Colours of surfaces as the formats want them.

/// Red, green and blue (sRGB, 0 to 1) of a colour in CIE L*a*b* (white point D65).
pub fn srgb([l, a, b]: [f32; 3]) -> [f64; 3] {
    let (l, a, b) = (f64::from(l), f64::from(a), f64::from(b));
    let y = (l + 16.0) / 116.0;
    let linear = |t: f64| if t > 6.0 / 29.0 { t.powi(3) } else { (t - 16.0 / 116.0) / 7.787 };
    let (x, y, z) = (0.95047 * linear(y + a / 500.0), linear(y), 1.08883 * linear(y - b / 200.0));
    let rgb = [
        3.2406 * x - 1.5372 * y - 0.4986 * z,
        -0.9689 * x + 1.8758 * y + 0.0415 * z,
        0.0557 * x - 0.2040 * y + 1.0570 * z,
    ];
    rgb.map(|c| {
        let c = if c.is_finite() { c.clamp(0.0, 1.0) } else { 0.5 };
        if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_colours_come_out() {
        let known = [
            ([100.0, 0.0, 0.0], [1.0, 1.0, 1.0]),
            ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
            ([53.24, 80.09, 67.20], [1.0, 0.0, 0.0]),
            ([32.30, 79.19, -107.86], [0.0, 0.0, 1.0]),
        ];
        for (lab, rgb) in known {
            let made = srgb(lab);
            assert!(made.iter().zip(rgb).all(|(a, b)| (a - b).abs() < 0.01), "{lab:?}: {made:?}");
        }
    }
}
