//! Descriptors of patches: SIFT's histograms of gradients (Lowe 2004) and the square root of
//! their shares (RootSIFT, Arandjelović & Zisserman 2012), for patches of any affine shape.

use super::orientation::{BINS, peaks};
use crate::image::gray::Gray;
use opencv::core::{Mat, Size};
use opencv::imgproc;
use opencv::prelude::*;
use std::sync::LazyLock;

/// Values in a descriptor.
pub const DESCRIPTOR_LENGTH: usize = 128;
/// Samples along a side of a patch.
const SIDE: usize = 20;
/// Cells along a side.
const CELLS: usize = 4;
/// Directions in a cell.
const DIRECTIONS: usize = 8;
/// Share of a descriptor that one of its values may have before the root is taken: a light may make
/// one edge much stronger than all others.
const MOST: f32 = 0.2;

/// A parallelogram in the picture: half its sides, as vectors from its centre, pixels.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// Its centre.
    pub centre: [f64; 2],
    /// From the centre to the middle of the right side.
    pub right: [f64; 2],
    /// From the centre to the middle of the lower side.
    pub down: [f64; 2],
}

impl Patch {
    /// Turned from right towards down by an angle on its surface, radians.
    pub fn turned(&self, angle: f32) -> Self {
        let (sin, cos) = f64::from(angle).sin_cos();
        let mix = |a: f64, b: f64| [0, 1].map(|i| a * self.right[i] + b * self.down[i]);
        Self { right: mix(cos, sin), down: mix(-sin, cos), ..*self }
    }
}

/// An image pyramid.
pub struct Pyramid(Vec<Level>);

struct Level {
    width: usize,
    height: usize,
    /// Each pixel with its neighbours to the right, below, and below to the right; those of the
    /// last column and row are not asked for.
    squares: Vec<[u8; 4]>,
}

impl Pyramid {
    /// `levels` pictures, each half as large as the last.
    pub fn new(gray: &Gray, levels: usize) -> opencv::Result<Self> {
        let mut pictures = vec![Level::new(gray.mat())?];
        let mut larger = gray.mat().try_clone()?;
        while pictures.len() < levels {
            let mut smaller = Mat::default();
            imgproc::pyr_down(
                &larger,
                &mut smaller,
                Size::default(),
                opencv::core::BORDER_DEFAULT,
            )?;
            pictures.push(Level::new(&smaller)?);
            larger = smaller;
        }
        Ok(Self(pictures))
    }

    /// Index of the picture whose pixels are nearest in size to a patch's samples.
    fn level_of(&self, patch: &Patch) -> usize {
        let area = (patch.right[0] * patch.down[1] - patch.right[1] * patch.down[0]).abs();
        let step = 2.0 * area.sqrt() / SIDE as f64;
        (step.max(1.0).log2().round() as usize).min(self.0.len() - 1)
    }
}

impl Level {
    fn new(mat: &Mat) -> opencv::Result<Self> {
        let (width, height) = (mat.cols() as usize, mat.rows() as usize);
        let values = mat.data_bytes()?;
        let squares = values
            .windows(width + 2)
            .map(|w| [w[0], w[1], w[width], w[width + 1]])
            .chain(std::iter::repeat_n([0; 4], width + 1))
            .collect();
        Ok(Self { width, height, squares })
    }

    /// True where four pixels surround a place.
    fn is_inside(&self, [x, y]: [f32; 2]) -> bool {
        x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32
    }

    /// Bilinear, at places that four pixels surround.
    #[inline(always)]
    fn row<const N: usize>(&self, [x, y]: &[[f32; N]; 2], values: &mut [f32; N]) {
        let number = |i: usize| y[i] as u32 * self.width as u32 + x[i] as u32;
        let numbers: [u32; N] = std::array::from_fn(number);
        let squares = numbers.map(|n| self.squares[n as usize]);
        for (i, square) in squares.iter().enumerate() {
            let (du, dv) = (x[i] - x[i].trunc(), y[i] - y[i].trunc());
            let [a, b, c, d] = square.map(f32::from);
            let (upper, lower) = (a + (b - a) * du, c + (d - c) * du);
            values[i] = upper + (lower - upper) * dv;
        }
    }
}

/// The descriptor of a patch, a unit vector: loops as wide as the processor allows, with the same
/// results on all.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
pub fn gradients(pyramid: &Pyramid, patch: &Patch) -> [f32; DESCRIPTOR_LENGTH] {
    let samples = sampled(pyramid, patch);
    let spread = &*SPREAD;
    let rows: [Row; SIDE] = std::array::from_fn(|y| row_histogram(&samples, y, spread));
    let mut histogram = [[0.0_f32; CELLS * DIRECTIONS]; CELLS];
    for (r, (sums, shares)) in histogram.iter_mut().zip(spread).enumerate() {
        for (row, share) in rows[r * PITCH..].iter().zip(shares) {
            sums.iter_mut().zip(row.as_flattened()).for_each(|(sum, value)| *sum += value * share);
        }
    }
    let mut flat = [0.0; DESCRIPTOR_LENGTH];
    flat.copy_from_slice(histogram.as_flattened());
    rooted(flat)
}

/// Samples to which gradients count: one and a half sigmas of a feature of which the patch shows
/// 3.2 on either side.
const FADING: f32 = 4.7;

/// The directions in which a patch's gradients are strongest, from its right towards down,
/// radians; the strongest first.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
pub fn directions(pyramid: &Pyramid, patch: &Patch) -> Vec<f32> {
    let samples = sampled(pyramid, patch);
    let mut histogram = [0.0; BINS];
    for row in 0..SIDE {
        let (strengths, directions) = row_of_gradients(&samples, row);
        for (x, (strength, direction)) in strengths.into_iter().zip(directions).enumerate() {
            let bin = (direction * (BINS as f32 / DIRECTIONS as f32)).round() as usize % BINS;
            histogram[bin] += strength * NEARNESS[x] * NEARNESS[row];
        }
    }
    peaks(&histogram)
}

/// How much a row or column of samples counts.
static NEARNESS: LazyLock<[f32; SIDE]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let from_centre = i as f32 + 0.5 - 0.5 * SIDE as f32;
        (-0.5 * (from_centre / FADING).powi(2)).exp()
    })
});

/// Histograms of a row's cells.
type Row = [[f32; DIRECTIONS]; CELLS];

/// Samples from one cell to the next: each reaches to the middles of its neighbours.
const PITCH: usize = SIDE / (CELLS + 1);

/// By row or column of cells: what it takes of the samples that it reaches.
type Spread = [[f32; 2 * PITCH]; CELLS];

/// The outer half cell fades out, and all fade with their distance from the patch's centre.
static SPREAD: LazyLock<Spread> = LazyLock::new(|| {
    std::array::from_fn(|cell| {
        std::array::from_fn(|i| {
            let sample = (cell * PITCH + i) as f32 + 0.5;
            let from_centre = (sample - 0.5 * SIDE as f32) / PITCH as f32;
            let from_cell = from_centre + 0.5 * (CELLS - 1) as f32 - cell as f32;
            let fading = (-from_centre * from_centre / (2.0 * CELLS as f32)).exp();
            fading * (1.0 - from_cell.abs())
        })
    })
});

/// Gradients of a row, shared among its cells and the directions next to their own.
#[inline(always)]
fn row_histogram(samples: &Samples, row: usize, spread: &Spread) -> Row {
    let (strengths, directions) = row_of_gradients(samples, row);
    let mut shared = [[0.0; DIRECTIONS]; SIDE];
    for ((shared, strength), direction) in shared.iter_mut().zip(strengths).zip(directions) {
        for (share, near) in shared.iter_mut().zip(NEAR) {
            let apart = (direction - near).abs();
            *share = strength * (1.0 - apart.min(DIRECTIONS as f32 - apart)).max(0.0);
        }
    }
    let mut cells = [[0.0; DIRECTIONS]; CELLS];
    for (c, (cell, shares)) in cells.iter_mut().zip(spread).enumerate() {
        for (shared, share) in shared[c * PITCH..].iter().zip(shares) {
            cell.iter_mut().zip(shared).for_each(|(sum, value)| *sum += value * share);
        }
    }
    cells
}

/// The directions that are counted, eighths of a turn.
const NEAR: [f32; DIRECTIONS] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// Strengths of a row's gradients, and their directions in eighths of a turn, up to 8.
#[inline(always)]
fn row_of_gradients(samples: &Samples, row: usize) -> ([f32; SIDE], [f32; SIDE]) {
    let [above, here, below] = [&samples[row], &samples[row + 1], &samples[row + 2]];
    let (mut strengths, mut directions) = ([0.0; SIDE], [0.0; SIDE]);
    for x in 0..SIDE {
        let (dx, dy) = (here[x + 2] - here[x], below[x + 1] - above[x + 1]);
        strengths[x] = (dx * dx + dy * dy).sqrt();
        directions[x] = eighths(dx, dy);
    }
    (strengths, directions)
}

/// Direction of a vector in eighths of a turn, from 0 to 8, to 1e-4 of one; without a branch.
#[inline(always)]
pub(super) fn eighths(dx: f32, dy: f32) -> f32 {
    let (across, down) = (dx.abs(), dy.abs());
    let (least, most) = (across.min(down), across.max(down));
    let r = least / most.max(f32::MIN_POSITIVE);
    let r2 = r * r;
    // atan(r) / (pi / 4) for r from 0 to 1.
    let octant = r
        * (1.273_211
            + r2 * (-0.423_514_3
                + r2 * (0.246_427_2
                    + r2 * (-0.148_247_1 + r2 * (0.067_040_3 - r2 * 0.014_923_9)))));
    let quadrant = if down > across { 2.0 - octant } else { octant };
    let half = if dx < 0.0 { 4.0 - quadrant } else { quadrant };
    if dy < 0.0 { 8.0 - half } else { half }
}

/// Samples of a patch with a rim of one.
type Samples = [[f32; SIDE + 2]; SIDE + 2];

/// Values on a grid over the patch.
#[inline(always)]
fn sampled(pyramid: &Pyramid, patch: &Patch) -> Samples {
    let level = pyramid.level_of(patch);
    let picture = &pyramid.0[level];
    let scale = 0.5_f64.powi(level as i32);
    let centre = patch.centre.map(|p| ((p + 0.5) * scale - 0.5) as f32);
    let [right, down] = [patch.right, patch.down].map(|side| side.map(|p| (p * scale) as f32));
    let along = |k: usize| (2 * k) as f32 / SIDE as f32 - (1.0 + 1.0 / SIDE as f32);
    let place = |row: usize, column: usize| {
        let (a, b) = (along(column), along(row));
        [0, 1].map(|i| centre[i] + a * right[i] + b * down[i])
    };
    let corners = [0, SIDE + 1].into_iter().flat_map(|r| [0, SIDE + 1].map(|c| place(r, c)));
    let is_inside = corners.into_iter().all(|p| picture.is_inside(p));
    let mut samples = [[0.0; SIDE + 2]; SIDE + 2];
    for (row, samples) in samples.iter_mut().enumerate() {
        let mut places = [[0.0; SIDE + 2]; 2];
        for (i, places) in places.iter_mut().enumerate() {
            for (column, p) in places.iter_mut().enumerate() {
                *p = place(row, column)[i];
            }
        }
        if !is_inside {
            let most = |side: usize| (side as f32 - 1.001).max(0.0);
            places[0].iter_mut().for_each(|x| *x = x.clamp(0.0, most(picture.width)));
            places[1].iter_mut().for_each(|y| *y = y.clamp(0.0, most(picture.height)));
        }
        picture.row(&places, samples);
    }
    samples
}

#[inline(always)]
fn rooted(mut histogram: [f32; DESCRIPTOR_LENGTH]) -> [f32; DESCRIPTOR_LENGTH] {
    let length = histogram.iter().map(|x| x * x).sum::<f32>().sqrt().max(1e-6);
    for x in &mut histogram {
        *x = x.min(MOST * length);
    }
    let sum = histogram.iter().sum::<f32>().max(1e-6);
    histogram.map(|x| (x / sum).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 120;

    /// Blobs of several sizes, turned by a quarter if `turned`, brighter by `light`.
    fn picture(turned: bool, light: f64) -> Pyramid {
        let value = |x: f64, y: f64| {
            let wave = (0.21 * x).sin() * (0.13 * y).cos() + (0.07 * x + 0.11 * y).sin();
            (light * (90.0 + 30.0 * wave)) as u8
        };
        let bytes: Vec<u8> = (0..SIZE * SIZE)
            .map(|i| {
                let (x, y) = ((i % SIZE) as f64, (i / SIZE) as f64);
                if turned { value(y, (SIZE - 1) as f64 - x) } else { value(x, y) }
            })
            .collect();
        Pyramid::new(&Gray::new(SIZE, SIZE, &bytes).unwrap(), 3).unwrap()
    }

    fn patch(x: f64, y: f64) -> Patch {
        Patch { centre: [x, y], right: [18.0, 0.0], down: [0.0, 18.0] }
    }

    fn likeness(a: &[f32; DESCRIPTOR_LENGTH], b: &[f32; DESCRIPTOR_LENGTH]) -> f32 {
        a.iter().zip(b).map(|(x, y)| x * y).sum()
    }

    #[test]
    fn a_descriptor_is_a_unit_vector_that_light_hardly_changes() {
        let (bright, dim) = (picture(false, 1.0), picture(false, 0.6));
        let (a, b) = (gradients(&bright, &patch(60.0, 50.0)), gradients(&dim, &patch(60.0, 50.0)));
        assert!((likeness(&a, &a) - 1.0).abs() < 1e-4);
        assert!(likeness(&a, &b) > 0.98);
        assert!(likeness(&a, &gradients(&bright, &patch(80.0, 70.0))) < 0.9);
    }

    #[test]
    fn a_turned_patch_on_a_turned_picture_looks_the_same() {
        let upright = gradients(&picture(false, 1.0), &patch(60.0, 50.0));
        // A point (x, y) of the one is at (119 - y, x) of the other.
        let turned = Patch { centre: [69.0, 60.0], right: [0.0, 18.0], down: [-18.0, 0.0] };
        assert!(likeness(&upright, &gradients(&picture(true, 1.0), &turned)) > 0.99);
    }

    #[test]
    fn a_patch_turned_to_its_own_direction_looks_the_same_however_the_picture_is_turned() {
        let own = |picture: &Pyramid, patch: Patch| {
            let angle = directions(picture, &patch)[0];
            gradients(picture, &patch.turned(angle))
        };
        let as_it_is = own(&picture(false, 1.0), patch(60.0, 50.0));
        let turned = own(&picture(true, 1.0), patch(69.0, 60.0));
        assert!(likeness(&as_it_is, &turned) > 0.98);
    }

    #[test]
    fn a_direction_is_told_in_eighths_of_a_turn() {
        for degrees in 0..360 {
            let (sin, cos) = (degrees as f32).to_radians().sin_cos();
            let error = (eighths(3.0 * cos, 3.0 * sin) - degrees as f32 / 45.0).abs();
            assert!(error.min(8.0 - error) < 1e-4, "{degrees}: {error}");
        }
        assert_eq!(eighths(0.0, 0.0), 0.0);
    }

    #[test]
    fn a_plain_patch_has_no_direction() {
        let plain = Pyramid::new(&Gray::new(64, 64, &[100; 64 * 64]).unwrap(), 2).unwrap();
        assert!(directions(&plain, &patch(32.0, 32.0)).is_empty());
        assert!(gradients(&plain, &patch(32.0, 32.0)).iter().all(|x| *x == 0.0));
    }
}
