//! A grey picture in floats, and its blur by a Gaussian. Loops over rows are as wide as the processor
//! allows, with the same results on all.

use rayon::prelude::*;

/// Rows that a thread takes at a time.
pub const ROWS: usize = 32;

/// A picture in floats; rows are filled up to whole registers.
pub struct Plane {
    pub width: usize,
    pub height: usize,
    /// Floats from a row to the next.
    pub stride: usize,
    values: Vec<f32>,
}

/// Floats that are worked on together.
const LANES: usize = 32;

impl Plane {
    fn empty(width: usize, height: usize) -> Self {
        let stride = width.next_multiple_of(LANES);
        Self { width, height, stride, values: vec![0.0; stride * height] }
    }

    /// A row, filled up to whole registers.
    #[inline]
    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.stride..(y + 1) * self.stride]
    }

    /// A pixel.
    #[inline(always)]
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.stride + x]
    }

    /// From the bytes of a picture.
    pub fn new(bytes: &[u8], width: usize, height: usize) -> Self {
        let mut plane = Self::empty(width, height);
        for (row, bytes) in plane.values.chunks_mut(plane.stride).zip(bytes.chunks(width)) {
            row.iter_mut().zip(bytes).for_each(|(value, byte)| *value = f32::from(*byte));
        }
        plane
    }

    /// Twice as wide and high, bilinear.
    pub fn doubled(bytes: &[u8], width: usize, height: usize) -> Self {
        let mut plane = Self::empty(2 * width, 2 * height);
        // Each of the two pixels that replace one lies a quarter of a pixel towards its neighbour.
        let beside = |x: usize, length: usize| {
            let towards = if x.is_multiple_of(2) { (x / 2).saturating_sub(1) } else { x / 2 + 1 };
            (x / 2, towards.min(length - 1))
        };
        let mix = |near: f32, far: f32| 0.75 * near + 0.25 * far;
        let stride = plane.stride;
        plane.values.par_chunks_mut(stride).enumerate().for_each(|(y, row)| {
            let (near, far) = beside(y, height);
            let lines = [near, far].map(|y| &bytes[y * width..(y + 1) * width]);
            let between: Vec<f32> = lines[0]
                .iter()
                .zip(lines[1])
                .map(|(near, far)| mix(f32::from(*near), f32::from(*far)))
                .collect();
            for (x, value) in row[..2 * width].iter_mut().enumerate() {
                let (near, far) = beside(x, width);
                *value = mix(between[near], between[far]);
            }
        });
        plane
    }

    /// Every other pixel of every other row; `None` where a side would have no more than `least`
    /// pixels.
    pub fn halved(&self, least: usize) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        if width.min(height) <= least {
            return None;
        }
        let mut plane = Self::empty(width, height);
        for (y, row) in plane.values.chunks_mut(plane.stride).enumerate() {
            row[..width]
                .iter_mut()
                .zip(self.row(2 * y).iter().step_by(2))
                .for_each(|(v, p)| *v = *p);
        }
        Some(plane)
    }

    /// Blurred by a Gaussian.
    pub fn blurred(&self, sigma: f32) -> Self {
        let kernel = half_kernel(sigma);
        let mut plane = Self::empty(self.width, self.height);
        let block = ROWS * self.stride;
        plane
            .values
            .par_chunks_mut(block)
            .enumerate()
            .for_each(|(i, rows)| blur_rows(self, &kernel, i * ROWS, rows));
        plane
    }
}

/// Standard deviations that a kernel reaches.
const KERNEL_SIGMAS: f32 = 3.5;

/// A Gaussian's weights from its middle outwards.
fn half_kernel(sigma: f32) -> Vec<f32> {
    let reach = (KERNEL_SIGMAS * sigma).round() as usize;
    let weight = |i: usize| (-0.5 * (i as f32 / sigma).powi(2)).exp();
    let sum = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f32>();
    (0..=reach).map(|i| weight(i) / sum).collect()
}

/// An index outside of a picture, mirrored at the last pixel.
fn mirrored(i: isize, length: usize) -> usize {
    let last = length as isize - 1;
    let mut i = i;
    while i < 0 || i > last {
        i = if i < 0 { -i } else { 2 * last - i };
    }
    i as usize
}

/// Blurs rows from `first` on: down each column, then along the row.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn blur_rows(from: &Plane, kernel: &[f32], first: usize, rows: &mut [f32]) {
    let reach = kernel.len() - 1;
    let (width, stride) = (from.width, from.stride);
    let mut line = vec![0.0_f32; reach + stride + reach];
    for (i, out) in rows.chunks_exact_mut(stride).enumerate() {
        let y = (first + i) as isize;
        let row = |by: isize| from.row(mirrored(y + by, from.height));
        let pairs: Vec<(&[f32], &[f32])> =
            (1..=reach as isize).map(|j| (row(-j), row(j))).collect();
        let centre = row(0);
        for (x, out) in (0..stride).step_by(LANES).zip(line[reach..].chunks_exact_mut(LANES)) {
            let mut sum = weighted(lanes(centre, x), kernel[0]);
            for ((above, below), weight) in pairs.iter().zip(&kernel[1..]) {
                add_pair(&mut sum, lanes(above, x), lanes(below, x), *weight);
            }
            out.copy_from_slice(&sum);
        }
        for j in 1..=reach {
            line[reach - j] = line[reach + mirrored(-(j as isize), width)];
            line[reach + width - 1 + j] = line[reach + mirrored((width - 1 + j) as isize, width)];
        }
        for (x, out) in (0..stride).step_by(LANES).zip(out.chunks_exact_mut(LANES)) {
            let mut sum = weighted(lanes(&line, reach + x), kernel[0]);
            for (j, weight) in kernel.iter().enumerate().skip(1) {
                let (left, right) = (lanes(&line, reach + x - j), lanes(&line, reach + x + j));
                add_pair(&mut sum, left, right, *weight);
            }
            out.copy_from_slice(&sum);
        }
    }
}

#[inline(always)]
fn lanes(row: &[f32], x: usize) -> &[f32; LANES] {
    row[x..].first_chunk().expect("rows are filled up to whole registers")
}

#[inline(always)]
fn weighted(values: &[f32; LANES], weight: f32) -> [f32; LANES] {
    let mut weighted = [0.0; LANES];
    for i in 0..LANES {
        weighted[i] = weight * values[i];
    }
    weighted
}

#[inline(always)]
fn add_pair(sum: &mut [f32; LANES], a: &[f32; LANES], b: &[f32; LANES], weight: f32) {
    for i in 0..LANES {
        sum[i] += weight * (a[i] + b[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_beside_the_picture_is_one_in_it() {
        let all: Vec<usize> = (-5..9).map(|i| mirrored(i, 4)).collect();
        assert_eq!(all, [1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2]);
    }
}
