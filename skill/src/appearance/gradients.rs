//! Descriptors of patches: SIFT's histograms of gradients (Lowe 2004) and the square root of
//! their shares (RootSIFT, Arandjelović & Zisserman 2012), for patches of any affine shape.

use super::DESCRIPTOR_LENGTH;
use crate::vision::Gray;
use opencv::core::{Mat, Size};
use opencv::imgproc;
use opencv::prelude::*;

/// Samples along a side of a patch.
const SIDE: usize = 20;
/// Cells along a side.
const CELLS: usize = 4;
/// Directions in a cell.
const DIRECTIONS: usize = 8;
/// Share of a descriptor that one of its values may have before the root is taken: light may
/// fall so that one edge outshines all.
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

/// A picture and smaller and smaller ones of it.
pub struct Pyramid(Vec<Level>);

struct Level {
    width: usize,
    height: usize,
    values: Vec<u8>,
}

impl Pyramid {
    /// `levels` pictures, each half as large as the last.
    pub fn new(gray: &Gray, levels: usize) -> opencv::Result<Self> {
        let mut pictures = vec![Level {
            width: gray.width(),
            height: gray.height(),
            values: gray.bytes()?.to_vec(),
        }];
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
        Ok(Self {
            width: mat.cols() as usize,
            height: mat.rows() as usize,
            values: mat.data_bytes()?.to_vec(),
        })
    }

    /// Bilinear; beyond the border as at it.
    fn at(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (u, v) = (x as usize, y as usize);
        let (du, dv) = (x - u as f32, y - v as f32);
        let right = (u + 1).min(self.width - 1);
        let below = (v + 1).min(self.height - 1);
        let value = |u: usize, v: usize| f32::from(self.values[v * self.width + u]);
        let upper = value(u, v) * (1.0 - du) + value(right, v) * du;
        let lower = value(u, below) * (1.0 - du) + value(right, below) * du;
        upper * (1.0 - dv) + lower * dv
    }
}

/// The descriptor of a patch, a unit vector.
pub fn gradients(pyramid: &Pyramid, patch: &Patch) -> [f32; DESCRIPTOR_LENGTH] {
    let samples = sampled(pyramid, patch);
    let mut histogram = [0.0_f32; DESCRIPTOR_LENGTH];
    let middle = 0.5 * (SIDE + 1) as f32;
    let cell = SIDE as f32 / (CELLS + 1) as f32;
    for y in 1..=SIDE {
        for x in 1..=SIDE {
            let dx = samples[y][x + 1] - samples[y][x - 1];
            let dy = samples[y + 1][x] - samples[y - 1][x];
            let strength = dx.hypot(dy);
            if strength <= 0.0 {
                continue;
            }
            // In cells from the patch's centre; the outer half cell fades out.
            let (across, down) = ((x as f32 - middle) / cell, (y as f32 - middle) / cell);
            let fading = (-(across * across + down * down) / (2.0 * CELLS as f32)).exp();
            let turn = dy.atan2(dx) / std::f32::consts::TAU;
            let half = 0.5 * (CELLS - 1) as f32;
            spread(
                &mut histogram,
                [down + half, across + half],
                turn.rem_euclid(1.0) * DIRECTIONS as f32,
                strength * fading,
            );
        }
    }
    rooted(histogram)
}

/// Values on a grid over the patch, with a rim of one.
fn sampled(pyramid: &Pyramid, patch: &Patch) -> [[f32; SIDE + 2]; SIDE + 2] {
    let level = pyramid.level_of(patch);
    let picture = &pyramid.0[level];
    let scale = 0.5_f64.powi(level as i32);
    let of_pixel = |p: f64| ((p + 0.5) * scale - 0.5) as f32;
    let along = |k: usize| 2.0 * (k as f64 - 0.5) / SIDE as f64 - 1.0;
    std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            let (a, b) = (along(column), along(row));
            picture.at(
                of_pixel(patch.centre[0] + a * patch.right[0] + b * patch.down[0]),
                of_pixel(patch.centre[1] + a * patch.right[1] + b * patch.down[1]),
            )
        })
    })
}

/// Shares a value among the cells and directions next to its own.
fn spread(histogram: &mut [f32; DESCRIPTOR_LENGTH], place: [f32; 2], direction: f32, value: f32) {
    let [row, column] = place.map(f32::floor);
    let (dr, dc) = (place[0] - row, place[1] - column);
    let first = direction as usize % DIRECTIONS;
    let dd = direction - direction.floor();
    for (r, wr) in [(row, 1.0 - dr), (row + 1.0, dr)] {
        for (c, wc) in [(column, 1.0 - dc), (column + 1.0, dc)] {
            if r < 0.0 || c < 0.0 || r >= CELLS as f32 || c >= CELLS as f32 {
                continue;
            }
            let cell = (r as usize * CELLS + c as usize) * DIRECTIONS;
            histogram[cell + first] += value * wr * wc * (1.0 - dd);
            histogram[cell + (first + 1) % DIRECTIONS] += value * wr * wc * dd;
        }
    }
}

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
    fn a_plain_patch_has_no_direction() {
        let plain = Pyramid::new(&Gray::new(64, 64, &[100; 64 * 64]).unwrap(), 2).unwrap();
        assert!(gradients(&plain, &patch(32.0, 32.0)).iter().all(|x| *x == 0.0));
    }
}
