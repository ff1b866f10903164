//! Rows of lightness for the normal equations: depth alone does not determine how far a sliding door slid; the
//! lightness on its surface does.
//!
//! In: the surface in a state (camera frame, metres) and the lightness of the image, 0 to 100.
//! Out: residuals with their rows of the Jacobian. Light differs between encounters, so that a gain and an offset
//! are fitted for each part first.
//! From: direct photometric alignment.

use crate::recognise::kinematics::{Articulated, State};
use crate::recognise::normal_equations::System;
use crate::recognise::render_cloud::{Cloud, visible};
use crate::recognise::scene::Scene;

/// Smallest number of samples with which the light of a part is fitted.
const LEAST_SAMPLES: usize = 20;
/// Standard deviation of lightness, of 100, that light and noise explain.
const LIGHTNESS_SIGMA: f64 = 6.0;
/// Number of independent surfels as which all residuals of lightness together count at most.
const LIGHTNESS_WORTH: f64 = 200.0;

/// A surfel in the image, with its learned and its seen lightness.
struct Sample {
    part: usize,
    /// Learned lightness, of 100.
    learned: f64,
    /// Seen lightness, of 100.
    seen: f64,
    /// Row of the Jacobian: how the seen lightness changes with each unknown.
    row: Vec<f64>,
}

/// Limits within which a surfel is compared with the image.
#[derive(Clone, Copy)]
pub struct LightnessWindow {
    /// Largest distance of a surfel from the surface seen at its pixel, metres; for lightness, of the depths, with
    /// 0.02 m added.
    pub gate_m: f64,
    /// Distance to either side over which lightness is differenced, pixels.
    pub reach_px: f64,
}

/// Adds the differences of lightness at visible surfels, after gain and offset of the light on each part.
pub fn add_lightness(
    system: &mut System,
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
    window: LightnessWindow,
) {
    let samples = lightness_samples(scene, articulated, cloud, state, window);
    let share = (LIGHTNESS_WORTH / samples.len().max(1) as f64).min(1.0);
    for part in 0..articulated.parts {
        let own: Vec<&Sample> = samples.iter().filter(|s| s.part == part).collect();
        if own.len() < LEAST_SAMPLES {
            continue;
        }
        let (gain, offset) = light(&own);
        for s in own {
            let residual = s.seen - gain * s.learned - offset;
            let weight =
                share / LIGHTNESS_SIGMA.powi(2) / (residual.abs() / LIGHTNESS_SIGMA).max(1.0);
            system.add(s.row.iter().copied(), residual, weight);
        }
    }
}

/// Surfels that are seen where they should be, with the lightness there.
fn lightness_samples(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
    LightnessWindow { gate_m, reach_px }: LightnessWindow,
) -> Vec<Sample> {
    let poses = articulated.poses(state);
    let velocities = articulated.velocities(&poses);
    let camera = &scene.frame.camera;
    visible(scene, cloud, &poses)
        .into_iter()
        .filter_map(|p| {
            let z = f64::from(scene.frame.depth.at(p.pixel.0, p.pixel.1)?);
            if (z - p.point.z).abs() > gate_m + 0.02 {
                return None;
            }
            let pixel = camera.project(&p.point)?;
            let at = |du: f64, dv: f64| scene.lab.lightness(pixel.x + du, pixel.y + dv);
            let slope_u = (at(reach_px, 0.0)? - at(-reach_px, 0.0)?) / (2.0 * reach_px);
            let slope_v = (at(0.0, reach_px)? - at(0.0, -reach_px)?) / (2.0 * reach_px);
            let (x, y) = (p.point.x / p.point.z, p.point.y / p.point.z);
            let row = velocities
                .of(p.part, &p.point)
                .map(|v| {
                    (slope_u * camera.fx * (v.x - x * v.z) + slope_v * camera.fy * (v.y - y * v.z))
                        / p.point.z
                })
                .collect();
            Some(Sample {
                part: p.part,
                learned: f64::from(cloud.surfels[p.index].lab[0]),
                seen: at(0.0, 0.0)?,
                row,
            })
        })
        .collect()
}

/// Gain and offset of the light on a part, by least squares; the gain is 0.3 to 3.
fn light(samples: &[&Sample]) -> (f64, f64) {
    let n = samples.len() as f64;
    let mean = |f: fn(&Sample) -> f64| samples.iter().map(|s| f(s)).sum::<f64>() / n;
    let (learned, seen) = (mean(|s| s.learned), mean(|s| s.seen));
    let (mut variance, mut common) = (1.0, 1.0);
    for s in samples {
        variance += (s.learned - learned).powi(2);
        common += (s.learned - learned) * (s.seen - seen);
    }
    let gain = (common / variance).clamp(0.3, 3.0);
    (gain, seen - gain * learned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_light_of_a_part_is_its_gain_and_its_offset() {
        let sample =
            |learned: f64| Sample { part: 0, learned, seen: 0.5 * learned + 12.0, row: Vec::new() };
        let samples: Vec<Sample> = (0..40).map(|i| sample(2.0 * f64::from(i))).collect();
        let (gain, offset) = light(&samples.iter().collect::<Vec<_>>());
        assert!((gain - 0.5).abs() < 1e-3 && (offset - 12.0).abs() < 0.1, "{gain} {offset}");
    }
}
