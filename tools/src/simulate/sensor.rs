//! What a Kinect makes of a scene: colour with noise; depth with noise that grows with the square
//! of the distance, steps of disparity, and holes at edges, at grazing angles, in the projector's
//! shadow and on surfaces that absorb its light.

use super::render::SurfacePoint;
use linkage_driver::depth::DepthSensor;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Focal length of the infrared camera, pixels, and distance to the projector, metres.
const IR_FOCAL_PX: f64 = 580.0;
const IR_BASELINE_M: f64 = 0.075;
/// Disparity is measured in eighths of a pixel.
const DISPARITY_STEPS: f64 = 8.0;
/// Nearest and farthest reading, metres.
const RANGE_M: [f64; 2] = [0.5, 5.0];
/// Cosine of the incidence from which nothing comes back: 75 degrees.
const MIN_COSINE: f64 = 0.26;
/// Standard deviation of colour noise, grey levels.
const COLOUR_NOISE: f64 = 3.0;
/// Side of the blotches in which readings get lost, pixels.
const BLOTCH_PX: usize = 9;

/// A generator for a frame's noise.
pub fn noise_of(seed: u64, frame: usize) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ frame as u64)
}

/// A normally distributed number (Box-Muller).
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Eight-bit colour from exposed light.
pub fn colour(exposed: &[[f32; 3]], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let flicker = 1.0 + 0.01 * normal(rng);
    exposed
        .iter()
        .flat_map(|c| c.map(|x| f64::from(x) * flicker))
        .map(|x| (x + COLOUR_NOISE * normal(rng)).round().clamp(0.0, 255.0) as u8)
        .collect()
}

/// Raw depth in `units_per_metre`, 0 where there is no reading.
pub fn depth(
    surfaces: &[Option<SurfacePoint>],
    width: usize,
    units_per_metre: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<u16> {
    let height = surfaces.len() / width;
    let shadow = projector_shadow(surfaces, width);
    let blotches: Vec<f64> =
        (0..(width / BLOTCH_PX + 1) * (height / BLOTCH_PX + 1)).map(|_| rng.random()).collect();
    (0..surfaces.len())
        .map(|i| {
            let (u, v) = (i % width, i / width);
            // Edges are not where they seem: the reading is that of a neighbour.
            let near = |x: usize, limit: usize, rng: &mut ChaCha8Rng| {
                (x as f64 + 0.8 * normal(rng)).round().clamp(0.0, limit as f64 - 1.0) as usize
            };
            let (ju, jv) = (near(u, width, rng), near(v, height, rng));
            let noise = normal(rng);
            let lost: f64 = rng.random();
            let Some(s) = surfaces[jv * width + ju].filter(|_| !shadow[i]) else { return 0 };
            let blotch = blotches[(v / BLOTCH_PX) * (width / BLOTCH_PX + 1) + u / BLOTCH_PX];
            if s.cosine < MIN_COSINE || blotch < s.depth_loss || lost < 0.004 {
                return 0;
            }
            let noisy = s.z
                + noise
                    * (DepthSensor::StructuredLight.reading_sigma(s.z) - step_sigma(s.z))
                        .max(0.0005);
            if !(noisy > RANGE_M[0] && noisy < RANGE_M[1]) {
                return 0;
            }
            let disparity = IR_FOCAL_PX * IR_BASELINE_M / noisy;
            let quantised = (disparity * DISPARITY_STEPS).round() / DISPARITY_STEPS;
            let z = IR_FOCAL_PX * IR_BASELINE_M / quantised;
            (z * units_per_metre).round().clamp(0.0, 65535.0) as u16
        })
        .collect()
}

/// The part of the depth noise that comes from the steps of disparity.
fn step_sigma(z: f64) -> f64 {
    z * z / (IR_FOCAL_PX * IR_BASELINE_M) / DISPARITY_STEPS / 3.5
}

/// Pixels that the projector, to the right of the camera, does not reach: along a row the
/// projector's columns must keep their order.
fn projector_shadow(surfaces: &[Option<SurfacePoint>], width: usize) -> Vec<bool> {
    let mut shadow = vec![false; surfaces.len()];
    for (row, line) in surfaces.chunks(width).enumerate() {
        let mut least = f64::INFINITY;
        for u in (0..width).rev() {
            let Some(s) = line[u] else { continue };
            let column = u as f64 - IR_FOCAL_PX * IR_BASELINE_M / s.z;
            if column > least + 0.5 {
                shadow[row * width + u] = true;
            }
            least = least.min(column);
        }
    }
    shadow
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 90;

    /// A wall that faces the camera.
    fn wall(z: f64) -> Vec<Option<SurfacePoint>> {
        vec![Some(surface(z, 1.0)); WIDTH * 90]
    }

    fn surface(z: f64, cosine: f64) -> SurfacePoint {
        SurfacePoint { z, cosine, label: 0, depth_loss: 0.0 }
    }

    fn readings(surfaces: &[Option<SurfacePoint>]) -> Vec<f64> {
        let raw = depth(surfaces, WIDTH, 1000.0, &mut noise_of(1, 0));
        raw.into_iter().filter(|z| *z > 0).map(|z| f64::from(z) / 1000.0).collect()
    }

    #[test]
    fn depth_spreads_as_the_model_of_noise_says() {
        for z in [1.0, 2.0] {
            let found = readings(&wall(z));
            let mean = found.iter().sum::<f64>() / found.len() as f64;
            let variance =
                found.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / found.len() as f64;
            assert!((mean - z).abs() < 0.003, "{mean}");
            let ratio = variance.sqrt() / DepthSensor::StructuredLight.reading_sigma(z);
            assert!((0.5..1.5).contains(&ratio), "at {z} m: {ratio}");
        }
    }

    #[test]
    fn nothing_comes_back_from_too_near_too_far_and_grazing_surfaces() {
        assert!(readings(&wall(0.3)).is_empty() && readings(&wall(6.0)).is_empty());
        assert!(readings(&vec![Some(surface(1.0, 0.2)); WIDTH * 90]).is_empty());
        assert!(readings(&vec![None; WIDTH * 90]).is_empty());
    }

    #[test]
    fn a_post_throws_a_shadow_to_its_left() {
        let mut surfaces = wall(3.0);
        for row in surfaces.chunks_mut(WIDTH) {
            row[50..60].fill(Some(surface(1.0, 1.0)));
        }
        let shadow = projector_shadow(&surfaces, WIDTH);
        // Disparities are 43.5 and 14.5 pixels: the last 29 columns but half a pixel of tolerance.
        let hidden: Vec<usize> = (0..WIDTH).filter(|u| shadow[u + 10 * WIDTH]).collect();
        assert_eq!((hidden.first(), hidden.last()), (Some(&22), Some(&49)));
    }
}
