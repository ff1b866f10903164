//! Sparse pyramidal Lucas-Kanade flow. Its loops run over windows that are as wide as the processor
//! allows, with the same results on all processors. Debian's OpenCV has it for the narrowest
//! processors alone, and takes nearly twice as long (`benches/frame.rs`).
//!
//! In: two grey images of one size, as pyramids, and a point of the first, pixels.
//! Out: the place of the point in the second image, pixels; `None` if it cannot be followed.
//! From: Bouguet 2000.

use crate::image::gray::Gray;
use nalgebra::Point2;
use opencv::core::{BORDER_REFLECT_101, Mat, Scalar, Size};
use opencv::prelude::*;
use opencv::{core, imgproc};

/// Number of levels of the pyramid, each half as wide as the one before.
const LEVELS: usize = 4;
/// Width of the window around a point, pixels.
const SIDE: usize = 13;
const HALF: f32 = (SIDE / 2) as f32;
/// Largest number of steps at each level.
const STEPS: usize = 15;
/// Length of a step from which the search at a level ends, pixels.
const LAST_STEP_PX: f32 = 0.03;
/// Largest sum, in columns and in rows, of two successive steps that cancel each other, pixels:
/// they oscillate about the goal.
const SWING_PX: f32 = 0.01;
/// Smallest eigenvalue of the mean product of gradients from which a motion is determined, grey
/// values² per pixel².
const MIN_EIGENVALUE: f32 = 0.1;
/// Largest distance of a point outside the image at any level, pixels.
const OUTSIDE_PX: f32 = 7.0;
/// Width of the border around each level, pixels: a window at the farthest point stays within it.
const PADDING: i32 = 32;

/// Number of floats in a row: those of a window, those that its gradients need beside it, and those
/// that fill a register.
const LANES: usize = 16;
type Row = [f32; LANES];
/// Grey values around a point, row after row; gradients read the floats after the last row too.
type Patch<const FLOATS: usize> = [f32; FLOATS];
const TEMPLATE: usize = (SIDE + 2) * LANES + 2;
const WINDOW: usize = SIDE * LANES;

/// An image at all levels of the pyramid.
pub struct Pyramid(Vec<Level>);

/// An image with a border of reflected pixels.
struct Level {
    width: usize,
    height: usize,
    stride: usize,
    bytes: Vec<u8>,
}

impl Pyramid {
    /// Builds the pyramid of an image.
    pub fn of(gray: &Gray) -> opencv::Result<Self> {
        let mut levels = vec![Level::of(gray.mat())?];
        let mut half = gray.mat().try_clone()?;
        for _ in 1..LEVELS {
            let mut next = Mat::default();
            imgproc::pyr_down(&half, &mut next, Size::default(), core::BORDER_DEFAULT)?;
            levels.push(Level::of(&next)?);
            half = next;
        }
        Ok(Self(levels))
    }
}

impl Level {
    fn of(picture: &Mat) -> opencv::Result<Self> {
        let mut padded = Mat::default();
        let p = PADDING;
        core::copy_make_border(
            picture,
            &mut padded,
            p,
            p,
            p,
            p,
            BORDER_REFLECT_101,
            Scalar::all(0.0),
        )?;
        Ok(Self {
            width: picture.cols() as usize,
            height: picture.rows() as usize,
            stride: padded.cols() as usize,
            bytes: padded.data_bytes()?.to_vec(),
        })
    }

    fn reaches(&self, p: [f32; 2]) -> bool {
        let within = |x: f32, size: usize| x >= -OUTSIDE_PX && x < size as f32 + OUTSIDE_PX;
        within(p[0], self.width) && within(p[1], self.height)
    }

    /// Grey values at whole pixels right of and below `corner`, which may be between pixels;
    /// interpolated bilinearly.
    #[inline(always)]
    fn sample<const ROWS: usize, const FLOATS: usize>(&self, corner: [f32; 2]) -> Patch<FLOATS> {
        let (left, top) = (corner[0].floor(), corner[1].floor());
        let (a, b) = (corner[0] - left, corner[1] - top);
        let first =
            (top as i32 + PADDING) as usize * self.stride + (left as i32 + PADDING) as usize;
        let mut patch = [0.0; FLOATS];
        let mut above = self.between(first, a);
        for (row, out) in patch.as_chunks_mut::<LANES>().0.iter_mut().take(ROWS).enumerate() {
            let below = self.between(first + (row + 1) * self.stride, a);
            for i in 0..LANES {
                out[i] = (1.0 - b) * above[i] + b * below[i];
            }
            above = below;
        }
        patch
    }

    /// Grey values of a row from the byte `from` on, interpolated by the share `a` towards the next
    /// bytes.
    #[inline(always)]
    fn between(&self, from: usize, a: f32) -> Row {
        let bytes: &[u8; LANES + 1] = self.bytes[from..].first_chunk().expect("padding is wider");
        let mut row = [0.0; LANES];
        for i in 0..LANES {
            row[i] = (1.0 - a) * f32::from(bytes[i]) + a * f32::from(bytes[i + 1]);
        }
        row
    }
}

/// The place in `to` of a point of `from`; `None` if its surroundings determine no motion, or it
/// leaves the image.
pub fn track(from: &Pyramid, to: &Pyramid, point: &Point2<f32>) -> Option<Point2<f32>> {
    let mut shift = [0.0; 2];
    for level in (0..LEVELS).rev() {
        let scale = 1.0 / (1 << level) as f32;
        let start = [point.x * scale, point.y * scale];
        match refine(&from.0[level], &to.0[level], start, shift) {
            Some(better) => shift = better,
            None if level == 0 => return None,
            None => {}
        }
        if level > 0 {
            shift = shift.map(|s| 2.0 * s);
        }
    }
    Some(Point2::new(point.x + shift[0], point.y + shift[1]))
}

/// The shift at one level, refined from a rough one.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn refine(from: &Level, to: &Level, start: [f32; 2], shift: [f32; 2]) -> Option<[f32; 2]> {
    if !from.reaches(start) {
        return None;
    }
    let patch: Patch<TEMPLATE> =
        from.sample::<{ SIDE + 2 }, TEMPLATE>(start.map(|x| x - HALF - 1.0));
    let template = Template::of(&patch);
    let [xx, xy, yy] = template.products;
    let determinant = xx * yy - xy * xy;
    let least = 0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt());
    if least < MIN_EIGENVALUE * (SIDE * SIDE) as f32 || determinant < f32::EPSILON {
        return None;
    }
    let mut shift = shift;
    let mut last = [f32::INFINITY; 2];
    for _ in 0..STEPS {
        let now = [start[0] + shift[0], start[1] + shift[1]];
        if !to.reaches(now) {
            return None;
        }
        let [x, y] = template.mismatch(&to.sample::<SIDE, WINDOW>(now.map(|x| x - HALF)));
        let step = [(yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant];
        let swings = (0..2).all(|k| (step[k] + last[k]).abs() < SWING_PX);
        let share = if swings { 0.5 } else { 1.0 };
        shift = [shift[0] + share * step[0], shift[1] + share * step[1]];
        if swings || step[0] * step[0] + step[1] * step[1] <= LAST_STEP_PX * LAST_STEP_PX {
            break;
        }
        last = step;
    }
    Some(shift)
}

/// The window that is sought: grey values, gradients, and the sums of products of gradients.
struct Template {
    grey: Patch<WINDOW>,
    gradient_x: Patch<WINDOW>,
    gradient_y: Patch<WINDOW>,
    /// Sums of the products xx, xy and yy of the gradients.
    products: [f32; 3],
}

impl Template {
    /// Builds the template from a window with one pixel around it; the gradients are Scharr's.
    #[inline(always)]
    fn of(patch: &Patch<TEMPLATE>) -> Self {
        let mut grey = [0.0; WINDOW];
        let (mut gradient_x, mut gradient_y) = ([0.0; WINDOW], [0.0; WINDOW]);
        for row in 0..SIDE {
            let beside = |down: usize| -> &[f32; LANES + 2] {
                patch[(row + down) * LANES..].first_chunk().expect("floats stand after the last")
            };
            let [above, here, below] = [beside(0), beside(1), beside(2)];
            grey.as_chunks_mut().0[row] = *here[1..].first_chunk::<LANES>().expect("it is wider");
            gradient_x.as_chunks_mut().0[row] = across(above, here, below);
            gradient_y.as_chunks_mut().0[row] = down(above, below);
        }
        let products = [
            sum_of_products(&gradient_x, &gradient_x),
            sum_of_products(&gradient_x, &gradient_y),
            sum_of_products(&gradient_y, &gradient_y),
        ];
        Self { grey, gradient_x, gradient_y, products }
    }

    /// Sums over the window of the differences in grey value, times the gradients along x and along
    /// y.
    #[inline(always)]
    fn mismatch(&self, window: &Patch<WINDOW>) -> [f32; 2] {
        let mut missing = self.grey;
        for (missing, seen) in missing.iter_mut().zip(window) {
            *missing -= seen;
        }
        // Not a closure: the compiler would compile that for the narrowest processors only.
        [sum_of_products(&missing, &self.gradient_x), sum_of_products(&missing, &self.gradient_y)]
    }
}

/// 1 inside the window, 0 where a row only fills a register.
const INSIDE: Row = {
    let mut inside = [0.0; LANES];
    let mut i = 0;
    while i < SIDE {
        inside[i] = 1.0;
        i += 1;
    }
    inside
};

/// Gradients along x of the middle one of three rows.
#[inline(always)]
fn across(above: &[f32; LANES + 2], here: &[f32; LANES + 2], below: &[f32; LANES + 2]) -> Row {
    let mut gradient = [0.0; LANES];
    for i in 0..LANES {
        let sides = (above[i + 2] - above[i]) + (below[i + 2] - below[i]);
        gradient[i] = INSIDE[i] * ((3.0 * sides + 10.0 * (here[i + 2] - here[i])) / 32.0);
    }
    gradient
}

/// Gradients along y of a row, from the row above and the row below.
#[inline(always)]
fn down(above: &[f32; LANES + 2], below: &[f32; LANES + 2]) -> Row {
    let mut gradient = [0.0; LANES];
    for i in 0..LANES {
        let sides = (below[i] - above[i]) + (below[i + 2] - above[i + 2]);
        gradient[i] = INSIDE[i] * ((3.0 * sides + 10.0 * (below[i + 1] - above[i + 1])) / 32.0);
    }
    gradient
}

/// Sum of the products, by columns first: the same additions in the same order, however wide the
/// processor. The products are computed in a separate loop, as the compiler fills whole registers
/// only then.
#[inline(always)]
fn sum_of_products(a: &Patch<WINDOW>, b: &Patch<WINDOW>) -> f32 {
    let mut products = *a;
    for (product, b) in products.iter_mut().zip(b) {
        *product *= b;
    }
    let mut sums = [0.0; LANES];
    for row in products.as_chunks::<LANES>().0 {
        for (sum, product) in sums.iter_mut().zip(row) {
            *sum += product;
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use opencv::core::{Point2f, TermCriteria, Vector};
    use opencv::video;

    /// Smooth paint, moved by so many pixels.
    fn painted(shift: [f64; 2]) -> Gray {
        let (width, height) = (320, 240);
        let waves = [(0.11, 0.05, 0.4), (-0.06, 0.13, 1.9), (0.05, -0.31, 2.7), (0.17, 0.19, 5.0)];
        let bytes: Vec<u8> = (0..width * height)
            .map(|i| {
                let (u, v) = ((i % width) as f64 - shift[0], (i / width) as f64 - shift[1]);
                let sum: f64 = waves.iter().map(|(a, b, c)| (a * u + b * v + c).sin()).sum();
                (127.5 + 30.0 * sum) as u8
            })
            .collect();
        Gray::new(width, height, &bytes).expect("a picture")
    }

    fn grid() -> Vec<Point2<f32>> {
        let at =
            |i: usize| Point2::new(30.3 + 13.1 * (i % 20) as f32, 31.7 + 12.3 * (i / 20) as f32);
        (0..280).map(at).collect()
    }

    #[test]
    fn a_moved_picture_is_followed_to_a_tenth_of_a_pixel() {
        for shift in [[0.0, 0.0], [0.4, -0.3], [-3.2, 2.6], [9.5, 7.25]] {
            let from = Pyramid::of(&painted([0.0; 2])).expect("a pyramid");
            let to = Pyramid::of(&painted(shift)).expect("a pyramid");
            for p in grid() {
                let found = track(&from, &to, &p).expect("paint everywhere");
                let missed = (found - p - nalgebra::Vector2::from(shift.map(|s| s as f32))).norm();
                assert!(missed < 0.1, "{p} moved by {shift:?} is missed by {missed}");
            }
        }
    }

    #[test]
    fn points_go_where_opencv_has_them() {
        let (from, to) = (painted([0.0; 2]), painted([2.6, -1.7]));
        let points = grid();
        let ours = [Pyramid::of(&from), Pyramid::of(&to)].map(|p| p.expect("a pyramid"));
        for (p, theirs) in points.iter().zip(opencvs(&from, &to, &points)) {
            let found = track(&ours[0], &ours[1], p).expect("paint everywhere");
            assert!((found - theirs).norm() < 0.05, "{p}: {found} for {theirs}");
        }
    }

    fn opencvs(from: &Gray, to: &Gray, points: &[Point2<f32>]) -> Vec<Point2<f32>> {
        let start: Vector<Point2f> = points.iter().map(|p| Point2f::new(p.x, p.y)).collect();
        let (mut end, mut status, mut error) =
            (Vector::<Point2f>::new(), Vector::<u8>::new(), Vector::<f32>::new());
        let window = Size::new(SIDE as i32, SIDE as i32);
        let steps = TermCriteria::new(3, STEPS as i32, LAST_STEP_PX.into()).expect("criteria");
        let levels = LEVELS as i32 - 1;
        video::calc_optical_flow_pyr_lk(
            from.mat(),
            to.mat(),
            &start,
            &mut end,
            &mut status,
            &mut error,
            window,
            levels,
            steps,
            0,
            1e-4,
        )
        .expect("a flow");
        end.iter().map(|p| Point2::new(p.x, p.y)).collect()
    }

    #[test]
    fn what_has_no_gradient_or_leaves_the_picture_is_not_followed() {
        let plain =
            Pyramid::of(&Gray::new(64, 48, &[90; 64 * 48]).expect("a picture")).expect("a pyramid");
        let paint = Pyramid::of(&painted([0.0; 2])).expect("a pyramid");
        assert_eq!(track(&plain, &plain, &Point2::new(30.0, 20.0)), None);
        for outside in [[-20.0, 5.0], [400.0, 100.0], [f32::NAN, 3.0], [5.0, f32::INFINITY]] {
            assert_eq!(track(&paint, &paint, &outside.into()), None, "{outside:?}");
        }
    }
}
