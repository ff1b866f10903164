//! Descriptors of patches: SIFT's histograms of gradients (Lowe 2004) and the square root of
//! their shares (RootSIFT, Arandjelović & Zisserman 2012), for patches of any affine shape.

use super::DESCRIPTOR_LENGTH;
use crate::vision::Gray;
use opencv::core::{Mat, Size};
use opencv::imgproc;
use opencv::prelude::*;
use std::sync::LazyLock;

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
    fn at(&self, [x, y]: [f32; 2]) -> f32 {
        let most = |side: usize| side as f32 - 1.001;
        self.inside([x.clamp(0.0, most(self.width)), y.clamp(0.0, most(self.height))])
    }

    /// True where four pixels surround a place.
    fn is_inside(&self, [x, y]: [f32; 2]) -> bool {
        x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32
    }

    /// Bilinear, for a place that four pixels surround.
    fn inside(&self, [x, y]: [f32; 2]) -> f32 {
        let (u, v) = (x as usize, y as usize);
        let (du, dv) = (x - u as f32, y - v as f32);
        let first = v * self.width + u;
        let [upper, lower] = [first, first + self.width].map(|i| {
            let (left, right) = (f32::from(self.values[i]), f32::from(self.values[i + 1]));
            left + (right - left) * du
        });
        upper + (lower - upper) * dv
    }
}

/// The descriptor of a patch, a unit vector.
pub fn gradients(pyramid: &Pyramid, patch: &Patch) -> [f32; DESCRIPTOR_LENGTH] {
    let samples = sampled(pyramid, patch);
    let mut histogram = [0.0_f32; DESCRIPTOR_LENGTH];
    let shares = &*SHARES;
    for (y, (row, of_row)) in shares.iter().enumerate() {
        let gathered = row_histogram(&samples, y, shares);
        for (r, share) in of_row.iter().enumerate() {
            let cells = &mut histogram[(row + r) * gathered.len()..][..gathered.len()];
            cells.iter_mut().zip(gathered).for_each(|(sum, value)| *sum += value * share);
        }
    }
    rooted(histogram)
}

/// By row or column of samples: the first row or column of cells that it shares what it has among,
/// and the shares of this and the next.
type Shares = [(usize, [f32; 2]); SIDE];

/// The outer half cell fades out, and all fade with their distance from the patch's centre.
static SHARES: LazyLock<Shares> = LazyLock::new(|| {
    let cell = SIDE as f32 / (CELLS + 1) as f32;
    std::array::from_fn(|i| {
        let from_centre = (i as f32 + 1.0 - 0.5 * (SIDE + 1) as f32) / cell;
        let fading = (-from_centre * from_centre / (2.0 * CELLS as f32)).exp();
        let place = from_centre + 0.5 * (CELLS - 1) as f32;
        let beyond = place - place.floor();
        match place.floor() {
            first if first < 0.0 => (0, [fading * beyond, 0.0]),
            first if first as usize + 1 >= CELLS => (CELLS - 2, [0.0, fading * (1.0 - beyond)]),
            first => (first as usize, [fading * (1.0 - beyond), fading * beyond]),
        }
    })
});

/// Gradients of a row, shared among its cells and the directions next to their own.
fn row_histogram(samples: &Samples, row: usize, shares: &Shares) -> [f32; CELLS * DIRECTIONS] {
    let (strengths, directions) = row_of_gradients(samples, row);
    let mut histogram = [0.0; CELLS * DIRECTIONS];
    for ((strength, direction), (column, of_column)) in
        strengths.into_iter().zip(directions).zip(shares)
    {
        let first = direction as usize;
        let beyond = direction - first as f32;
        let (first, second) = (first % DIRECTIONS, (first + 1) % DIRECTIONS);
        for (c, share) in of_column.iter().enumerate() {
            let cell = (column + c) * DIRECTIONS;
            histogram[cell + first] += strength * share * (1.0 - beyond);
            histogram[cell + second] += strength * share * beyond;
        }
    }
    histogram
}

/// Strengths of a row's gradients, and their directions in eighths of a turn, up to 8.
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
fn eighths(dx: f32, dy: f32) -> f32 {
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
    if corners.into_iter().all(|p| picture.is_inside(p)) {
        grid(|row, column| picture.inside(place(row, column)))
    } else {
        grid(|row, column| picture.at(place(row, column)))
    }
}

fn grid(value: impl Fn(usize, usize) -> f32) -> Samples {
    std::array::from_fn(|row| std::array::from_fn(|column| value(row, column)))
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
        assert!(gradients(&plain, &patch(32.0, 32.0)).iter().all(|x| *x == 0.0));
    }
}
