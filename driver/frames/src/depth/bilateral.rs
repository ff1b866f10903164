//! The fast bilateral filter (Paris & Durand 2006), which the paper applies to depth
//! (section III-A): the picture is splatted into a coarse grid over (u, v, depth), the grid
//! is blurred, and each pixel reads its value back by trilinear interpolation.
//!
//! The cost does not depend on `sigma_s`, unlike a direct bilateral filter's.

use crate::frame::DepthImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Widths of the filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BilateralConfig {
    /// Spatial standard deviation in pixels. The paper's, III-A: 20.
    pub sigma_s_px: f64,
    /// Range standard deviation in metres. The paper's, III-A: 0.04.
    pub sigma_r_m: f64,
}

impl Default for BilateralConfig {
    fn default() -> Self {
        Self { sigma_s_px: 20.0, sigma_r_m: 0.04 }
    }
}

/// Cells kept free around the grid so that blurring needs no special border.
const PAD: usize = 2;
/// Depth beyond which readings are passed through unfiltered, in metres.
const FAR_M: f32 = 12.0;

struct Grid {
    nu: usize,
    nv: usize,
    nz: usize,
    /// (sum of depth, sum of weight), z fastest.
    cells: Vec<[f32; 2]>,
}

impl Grid {
    fn index(&self, u: usize, v: usize, z: usize) -> usize {
        (v * self.nu + u) * self.nz + z
    }

    /// One pass of [1 2 1]/4 twice along an axis: close to a Gaussian of one cell.
    fn blur(&mut self, stride: usize, len: usize) {
        for _ in 0..2 {
            let source = self.cells.clone();
            self.cells.par_iter_mut().enumerate().for_each(|(i, cell)| {
                let along = (i / stride) % len;
                if along == 0 || along + 1 == len {
                    return;
                }
                for k in 0..2 {
                    cell[k] = 0.25 * source[i - stride][k]
                        + 0.5 * source[i][k]
                        + 0.25 * source[i + stride][k];
                }
            });
        }
    }

    fn read(&self, u: f32, v: f32, z: f32) -> [f32; 2] {
        let (u0, v0, z0) = (u as usize, v as usize, z as usize);
        let (fu, fv, fz) = (u - u0 as f32, v - v0 as f32, z - z0 as f32);
        let mut sum = [0.0; 2];
        for (dv, wv) in [(0, 1.0 - fv), (1, fv)] {
            for (du, wu) in [(0, 1.0 - fu), (1, fu)] {
                for (dz, wz) in [(0, 1.0 - fz), (1, fz)] {
                    let cell = self.cells[self.index(u0 + du, v0 + dv, z0 + dz)];
                    let w = wu * wv * wz;
                    sum[0] += w * cell[0];
                    sum[1] += w * cell[1];
                }
            }
        }
        sum
    }
}

/// Smooths depth over surfaces and keeps its steps. Pixels without a reading stay so.
pub fn smooth(depth: &DepthImage, config: &BilateralConfig) -> DepthImage {
    let (width, height) = (depth.width(), depth.height());
    let near = depth.as_metres().iter().copied().fold(f32::INFINITY, f32::min);
    if !near.is_finite() {
        return depth.clone();
    }
    let far = depth.as_metres().iter().copied().fold(0.0, f32::max).min(FAR_M);
    let ss = config.sigma_s_px as f32;
    let sr = config.sigma_r_m as f32;
    let cell_of = |extent: f32, sigma: f32| (extent / sigma).ceil() as usize + 1 + 2 * PAD;
    let mut grid = Grid {
        nu: cell_of(width as f32, ss),
        nv: cell_of(height as f32, ss),
        nz: cell_of((far - near).max(0.0), sr),
        cells: Vec::new(),
    };
    grid.cells = vec![[0.0; 2]; grid.nu * grid.nv * grid.nz];
    let at = |i: usize, z: f32| {
        let pad = PAD as f32;
        ((i % width) as f32 / ss + pad, (i / width) as f32 / ss + pad, (z - near) / sr + pad)
    };
    for (i, &z) in depth.as_metres().iter().enumerate() {
        if z <= far {
            let (u, v, d) = at(i, z);
            let index = grid.index(u.round() as usize, v.round() as usize, d.round() as usize);
            grid.cells[index][0] += z;
            grid.cells[index][1] += 1.0;
        }
    }
    let (nu, nv, nz) = (grid.nu, grid.nv, grid.nz);
    grid.blur(1, nz);
    grid.blur(nz, nu);
    grid.blur(nz * nu, nv);
    let smoothed = depth
        .as_metres()
        .par_iter()
        .enumerate()
        .map(|(i, &z)| {
            if z.is_nan() || z > far {
                return z;
            }
            let (u, v, d) = at(i, z);
            let [sum, weight] = grid.read(u, v, d);
            if weight > 1e-6 { sum / weight } else { z }
        })
        .collect();
    DepthImage::from_metres(width, height, smoothed)
        .expect("the smoothed picture has the size of the one it was made from")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step_with_noise() -> DepthImage {
        let mut state = 7_u32;
        let metres = (0..160 * 120)
            .map(|i| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let noise = (state >> 8) as f32 / (1 << 24) as f32 - 0.5;
                (if i % 160 < 80 { 1.0 } else { 2.0 }) + 0.01 * noise
            })
            .collect();
        DepthImage::from_metres(160, 120, metres).unwrap()
    }

    #[test]
    fn noise_falls_and_the_step_stays() {
        let smoothed = smooth(&step_with_noise(), &BilateralConfig::default());
        for (u, expected) in [(40, 1.0), (76, 1.0), (84, 2.0), (120, 2.0)] {
            let z = smoothed.at(u, 60).unwrap();
            assert!((z - expected).abs() < 0.002, "column {u}: {z}");
        }
    }

    #[test]
    fn a_hole_stays_a_hole() {
        let depth = DepthImage::from_metres(3, 1, vec![1.0, 0.0, 1.0]).unwrap();
        assert_eq!(smooth(&depth, &BilateralConfig::default()).at(1, 0), None);
    }
}
