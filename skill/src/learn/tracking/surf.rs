//! The SURF descriptor at given key points: box filters on an integral image, 64 values, upright or
//! turned to the dominant gradient. Debian's OpenCV does not contain it.
//!
//! In: a grey image, and key points with their scales, pixels.
//! Out: descriptors of unit length.
//! From: Bay, Ess, Tuytelaars, Van Gool 2008; the paper (III-A) describes features with SURF.

use crate::image::gray::Gray;
use rayon::prelude::*;

/// Number of values in a descriptor.
pub const SURF_LENGTH: usize = 64;

/// A key point that is described.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfPoint {
    /// Column, pixels.
    pub x: f32,
    /// Row, pixels.
    pub y: f32,
    /// Scale s of the SURF paper, pixels: the described square is 20 s wide.
    pub scale: f32,
}

/// The integral image from which descriptors are computed.
pub struct Surf {
    width: i32,
    height: i32,
    integral: Vec<u32>,
}

impl Surf {
    /// Computes the integral image.
    pub fn new(gray: &Gray) -> opencv::Result<Self> {
        let (width, height) = (gray.width(), gray.height());
        let bytes = gray.bytes()?;
        let stride = width + 1;
        let mut integral = vec![0_u32; stride * (height + 1)];
        for v in 0..height {
            let mut row = 0;
            for u in 0..width {
                row += u32::from(bytes[v * width + u]);
                integral[(v + 1) * stride + u + 1] = integral[v * stride + u + 1] + row;
            }
        }
        Ok(Self { width: width as i32, height: height as i32, integral })
    }

    /// Descriptors of all points, each of unit length, or zero on a flat patch.
    pub fn describe(&self, points: &[SurfPoint], upright: bool) -> Vec<[f32; SURF_LENGTH]> {
        points
            .par_iter()
            .map(|p| {
                let angle = if upright { 0.0 } else { self.orientation(p) };
                self.descriptor(p, angle)
            })
            .collect()
    }

    fn box_sum(&self, x0: i32, y0: i32, x1: i32, y1: i32) -> f32 {
        let clamp = |value: i32, limit: i32| value.clamp(0, limit) as usize;
        let stride = self.width as usize + 1;
        let (l, r) = (clamp(x0, self.width), clamp(x1, self.width));
        let (t, b) = (clamp(y0, self.height) * stride, clamp(y1, self.height) * stride);
        (self.integral[b + r] + self.integral[t + l]) as f32
            - (self.integral[b + l] + self.integral[t + r]) as f32
    }

    /// Haar wavelet responses along x and y at a place, for a filter of `size` pixels.
    fn haar(&self, x: f32, y: f32, size: i32) -> (f32, f32) {
        let half = size / 2;
        let (x, y) = (x.round() as i32, y.round() as i32);
        let (x0, x1, y0, y1) = (x - half, x + half, y - half, y + half);
        let left = self.box_sum(x0, y0, x, y1);
        let right = self.box_sum(x, y0, x1, y1);
        let top = self.box_sum(x0, y0, x1, y);
        let bottom = self.box_sum(x0, y, x1, y1);
        (right - left, bottom - top)
    }

    /// Direction of the dominant gradient, radians: that of the 60-degree sector with the longest
    /// summed response within 6 s.
    fn orientation(&self, p: &SurfPoint) -> f32 {
        let s = p.scale;
        let size = even(4.0 * s);
        let mut responses = Vec::with_capacity(113);
        for j in -6..=6_i32 {
            for i in -6..=6_i32 {
                if i * i + j * j < 36 {
                    let (dx, dy) = self.haar(p.x + i as f32 * s, p.y + j as f32 * s, size);
                    let weight = gaussian(i as f32, j as f32, 2.5);
                    let (dx, dy) = (weight * dx, weight * dy);
                    responses.push((dy.atan2(dx), dx, dy));
                }
            }
        }
        let mut best = (0.0, 0.0);
        for step in 0..42 {
            let start = -std::f32::consts::PI + step as f32 * 0.15;
            let (mut sx, mut sy) = (0.0, 0.0);
            for &(angle, dx, dy) in &responses {
                let ahead = (angle - start).rem_euclid(std::f32::consts::TAU);
                if ahead < std::f32::consts::FRAC_PI_3 {
                    sx += dx;
                    sy += dy;
                }
            }
            let length = sx * sx + sy * sy;
            if length > best.0 {
                best = (length, sy.atan2(sx));
            }
        }
        best.1
    }

    /// Sums of dx, |dx|, dy, |dy| over 4 x 4 subregions of 5 x 5 samples each.
    fn descriptor(&self, p: &SurfPoint, angle: f32) -> [f32; SURF_LENGTH] {
        let (sin, cos) = angle.sin_cos();
        let s = p.scale;
        let size = even(2.0 * s);
        let mut out = [0.0; SURF_LENGTH];
        for j in 0..20 {
            for i in 0..20 {
                let (gx, gy) = (i as f32 - 9.5, j as f32 - 9.5);
                let x = p.x + s * (gx * cos - gy * sin);
                let y = p.y + s * (gx * sin + gy * cos);
                let (hx, hy) = self.haar(x, y, size);
                let weight = gaussian(gx, gy, 3.3);
                let dx = weight * (hx * cos + hy * sin);
                let dy = weight * (hy * cos - hx * sin);
                let cell = 4 * ((j / 5) * 4 + i / 5);
                out[cell] += dx;
                out[cell + 1] += dx.abs();
                out[cell + 2] += dy;
                out[cell + 3] += dy.abs();
            }
        }
        let norm = out.iter().map(|v| v * v).sum::<f32>().sqrt();
        if norm > 1e-6 {
            out.iter_mut().for_each(|v| *v /= norm);
        }
        out
    }
}

fn even(size: f32) -> i32 {
    ((size / 2.0).round() as i32).max(1) * 2
}

fn gaussian(x: f32, y: f32, sigma: f32) -> f32 {
    (-(x * x + y * y) / (2.0 * sigma * sigma)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blobs of different brightness; `turn` turns them about (64, 64), `gain` scales light.
    fn blobs(turn: f32, gain: f32) -> Gray {
        let (sin, cos) = turn.sin_cos();
        let bytes: Vec<u8> = (0..128 * 128)
            .map(|i| {
                let (x, y) = ((i % 128) as f32 - 64.0, (i / 128) as f32 - 64.0);
                let (u, v) = (x * cos + y * sin, y * cos - x * sin);
                let value = 100.0
                    + 60.0 * (u * 0.21 + 1.0).sin() * (v * 0.13).cos()
                    + 40.0 * gaussian(u - 9.0, v + 4.0, 5.0);
                (value * gain).clamp(0.0, 255.0) as u8
            })
            .collect();
        Gray::new(128, 128, &bytes).unwrap()
    }

    fn at_centre(gray: &Gray, upright: bool) -> [f32; SURF_LENGTH] {
        let point = SurfPoint { x: 64.0, y: 64.0, scale: 1.6 };
        Surf::new(gray).unwrap().describe(&[point], upright)[0]
    }

    fn distance(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f32>().sqrt()
    }

    #[test]
    fn light_does_not_change_the_description() {
        assert!(
            distance(&at_centre(&blobs(0.0, 1.0), true), &at_centre(&blobs(0.0, 0.7), true)) < 0.05
        );
    }

    #[test]
    fn the_oriented_descriptor_survives_a_turn_that_the_upright_one_does_not() {
        let (straight, turned) = (blobs(0.0, 1.0), blobs(0.9, 1.0));
        let upright = distance(&at_centre(&straight, true), &at_centre(&turned, true));
        let oriented = distance(&at_centre(&straight, false), &at_centre(&turned, false));
        assert!(oriented < 0.35 && upright > 2.0 * oriented, "{oriented} {upright}");
    }
}
