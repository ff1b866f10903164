//! Keypoints: extrema of differences of Gaussians over place and scale, with the directions of
//! their gradients (Lowe 2004). Loops over rows are as wide as the processor allows, with the same
//! results on all; Debian's OpenCV takes 1.5 times as long (`benches/frame.rs`).

use super::blurred_plane::{Plane, ROWS};
use super::orientation::{BINS, peaks};
use super::sift_descriptor::eighths;
use crate::image::gray::Gray;
use crate::math::extremes::{larger, smaller};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// A distinctive point of the picture, at one scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Pixel.
    pub pixel: [f32; 2],
    /// Diameter, pixels.
    pub size: f32,
    /// Contrast, grey levels.
    pub response: f32,
    octave: usize,
    level: usize,
    /// Place and standard deviation in its octave, pixels.
    place: [f32; 2],
    sigma: f32,
}

/// Scales in an octave.
const INTERVALS: usize = 3;
/// Blurred pictures of an octave, and differences between them.
const LEVELS: usize = INTERVALS + 3;
const DIFFERENCES: usize = LEVELS - 1;
/// Blur of an octave's first picture, pixels.
const SIGMA: f32 = 1.6;
/// Blur that a camera makes, pixels.
const CAMERA_SIGMA: f32 = 0.5;
/// Pixels at a picture's border that are left out.
const BORDER: usize = 5;
/// Largest ratio of the two curvatures: a keypoint has no position along an edge.
pub(super) const MAX_CURVATURE_RATIO: f32 = 12.0;
/// Steps to an extremum between pixels and scales.
const STEPS: usize = 5;
/// Share of the wanted contrast that a pixel must have before the extremum between pixels is
/// computed.
const AT_PIXEL: f32 = 0.5;
/// All blurred pictures of one picture.
pub struct ScaleSpace(Vec<Octave>);

/// Pictures of one size, each blurred more than the last.
struct Octave {
    planes: [Plane; LEVELS],
    /// Pixels of the picture for each pixel of these planes.
    pixels: f32,
    /// Where in the picture the first of these is, right and down.
    first: f32,
}

impl ScaleSpace {
    /// The scale space of a picture.
    pub fn new(gray: &Gray) -> opencv::Result<Self> {
        let plane = Plane::new(gray.bytes()?, gray.width(), gray.height());
        Ok(Self::from_finest(&plane, 1.0))
    }

    /// The scale space that begins with the picture doubled in size: for the smallest keypoints
    /// too.
    pub fn doubled(gray: &Gray) -> opencv::Result<Self> {
        let plane = Plane::doubled(gray.bytes()?, gray.width(), gray.height());
        Ok(Self::from_finest(&plane, 0.5))
    }

    /// `pixels` of the picture are one of the finest plane.
    fn from_finest(plane: &Plane, pixels: f32) -> Self {
        let camera_sigma = CAMERA_SIGMA / pixels;
        let blurred = plane.blurred((SIGMA.powi(2) - camera_sigma.powi(2)).sqrt());
        let first = 0.5 * (pixels - 1.0);
        let mut octaves = vec![Octave { planes: planes_from(blurred), pixels, first }];
        while let Some(next) = octaves.last().and_then(Octave::next) {
            octaves.push(next);
        }
        Self(octaves)
    }

    /// Extrema of at least some contrast, grey levels.
    pub fn keypoints(&self, contrast: f32) -> Vec<Keypoint> {
        let of_octave = |(number, octave): (usize, &Octave)| {
            let rows: Vec<usize> = inner(octave.planes[0].height).step_by(ROWS).collect();
            let found: Vec<Vec<Keypoint>> = rows
                .into_par_iter()
                .map(|first| extrema(octave, number, first, contrast))
                .collect();
            found.concat()
        };
        self.0.iter().enumerate().flat_map(of_octave).collect()
    }

    /// Directions of the gradients about a keypoint, radians from right towards down: the strongest
    /// one, and others that are nearly as strong.
    pub fn directions(&self, keypoint: &Keypoint) -> Vec<f32> {
        directions(&self.0[keypoint.octave].planes[keypoint.level], keypoint)
    }
}

/// Columns or rows that are not at the border; none of a tiny picture.
fn inner(length: usize) -> Range<usize> {
    BORDER..length.saturating_sub(BORDER)
}

impl Octave {
    /// The next octave: pictures half as large.
    fn next(&self) -> Option<Self> {
        let planes = planes_from(self.planes[INTERVALS].halved(2 * BORDER)?);
        Some(Self { planes, pixels: 2.0 * self.pixels, first: self.first })
    }
}

/// The planes of an octave from its first; each next one is blurred some more.
fn planes_from(first: Plane) -> [Plane; LEVELS] {
    let sigma = |level: usize| SIGMA * 2_f32.powf(level as f32 / INTERVALS as f32);
    let mut planes = vec![first];
    for level in 1..LEVELS {
        let more = (sigma(level).powi(2) - sigma(level - 1).powi(2)).sqrt();
        planes.push(planes[level - 1].blurred(more));
    }
    planes.try_into().unwrap_or_else(|_| unreachable!("there are so many levels"))
}

/// A row of a difference of Gaussians, and the most and least of each value and the two beside it.
#[derive(Clone, Default)]
struct DifferenceRow {
    values: Vec<f32>,
    most: Vec<f32>,
    least: Vec<f32>,
}

impl DifferenceRow {
    #[inline(always)]
    fn fill(&mut self, lower: &[f32], upper: &[f32]) {
        self.values.clear();
        self.values.extend(lower.iter().zip(upper).map(|(a, b)| b - a));
        let v = &self.values[..];
        self.most.resize(v.len(), 0.0);
        self.least.resize(v.len(), 0.0);
        let inner = 1..v.len() - 1;
        let three = v[..v.len() - 2].iter().zip(&v[1..]).zip(&v[2..]);
        let of_three = self.most[inner.clone()].iter_mut().zip(&mut self.least[inner]);
        for (((a, b), c), (most, least)) in three.zip(of_three) {
            *most = larger(larger(*a, *b), *c);
            *least = smaller(smaller(*a, *b), *c);
        }
    }
}

/// The most and the least of three rows of a difference, three pixels wide.
#[derive(Clone, Default)]
struct Around {
    most: Vec<f32>,
    least: Vec<f32>,
}

impl Around {
    #[inline(always)]
    fn fill(&mut self, rows: &[DifferenceRow; 3]) {
        let [a, b, c] = rows;
        self.most.clear();
        self.most.extend(
            a.most.iter().zip(&b.most).zip(&c.most).map(|((a, b), c)| larger(larger(*a, *b), *c)),
        );
        self.least.clear();
        self.least.extend(
            a.least
                .iter()
                .zip(&b.least)
                .zip(&c.least)
                .map(|((a, b), c)| smaller(smaller(*a, *b), *c)),
        );
    }
}

/// Extrema in some rows of an octave.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn extrema(octave: &Octave, number: usize, first: usize, contrast: f32) -> Vec<Keypoint> {
    let planes = &octave.planes;
    let (width, height) = (planes[0].width, planes[0].height);
    let mut rows: [[DifferenceRow; 3]; DIFFERENCES] = Default::default();
    let mut around: [Around; DIFFERENCES] = Default::default();
    let mut is_extreme = vec![0_u8; planes[0].stride];
    let mut found = Vec::new();
    let least = AT_PIXEL * contrast;
    for y in first - 1..(first + ROWS).min(inner(height).end) + 1 {
        for (d, rows) in rows.iter_mut().enumerate() {
            rows[y % 3].fill(planes[d].row(y), planes[d + 1].row(y));
        }
        if y < first + 1 {
            continue;
        }
        let middle = y - 1;
        rows.iter().zip(&mut around).for_each(|(rows, around)| around.fill(rows));
        for level in 1..=INTERVALS {
            let values = &rows[level][middle % 3].values;
            mark(&mut is_extreme, values, &around[level - 1..=level + 1], least);
            for x in memchr::memchr_iter(1, &is_extreme) {
                if inner(width).contains(&x)
                    && let Some(keypoint) = refined(octave, number, [x, middle, level], contrast)
                {
                    found.push(keypoint);
                }
            }
        }
    }
    found
}

/// Marks values that are extrema among their neighbours in position and scale.
#[inline(always)]
fn mark(marks: &mut [u8], values: &[f32], around: &[Around], least_contrast: f32) {
    let [below, same, above] = around else { unreachable!("three scales are compared") };
    let n = marks.len();
    let (values, marks) = (&values[..n], &mut marks[..n]);
    let most = [&below.most[..n], &same.most[..n], &above.most[..n]];
    let least = [&below.least[..n], &same.least[..n], &above.least[..n]];
    for x in 0..n {
        let v = values[x];
        let highest = larger(larger(most[0][x], most[1][x]), most[2][x]);
        let lowest = smaller(smaller(least[0][x], least[1][x]), least[2][x]);
        let peak = (v > least_contrast) & (v >= highest);
        let pit = (v < -least_contrast) & (v <= lowest);
        marks[x] = u8::from(peak | pit);
    }
}

/// The extremum between pixels and scales that an extremum at a pixel leads to, if it has enough
/// contrast and is no edge.
fn refined(
    octave: &Octave,
    number: usize,
    [mut x, mut y, mut level]: [usize; 3],
    contrast: f32,
) -> Option<Keypoint> {
    let Octave { planes, pixels, first } = octave;
    let (width, height) = (planes[0].width, planes[0].height);
    for _ in 0..STEPS {
        let local = Local::at(planes, x, y, level);
        let offset = local.extremum()?;
        if offset.amax() < 0.5 {
            let value = local.value + 0.5 * local.gradient.dot(&offset);
            if value.abs() < contrast || local.is_edge() {
                return None;
            }
            let place = [x as f32 + offset.x, y as f32 + offset.y];
            let scale = (level as f32 + offset.z) / INTERVALS as f32;
            let sigma = SIGMA * 2_f32.powf(scale);
            return Some(Keypoint {
                pixel: place.map(|p| pixels * p + first),
                size: 2.0 * sigma * pixels,
                response: value.abs(),
                octave: number,
                level,
                place,
                sigma,
            });
        }
        let moved = |i: usize, by: f32, range: Range<usize>| {
            if by.abs() > 1e3 {
                return None;
            }
            i.checked_add_signed(by.round() as isize).filter(|i| range.contains(i))
        };
        x = moved(x, offset.x, inner(width))?;
        y = moved(y, offset.y, inner(height))?;
        level = moved(level, offset.z, 1..INTERVALS + 1)?;
    }
    None
}

/// A difference of Gaussians about a pixel, to the second order.
struct Local {
    value: f32,
    gradient: Vector3<f32>,
    hessian: Matrix3<f32>,
}

impl Local {
    fn at(planes: &[Plane; LEVELS], x: usize, y: usize, level: usize) -> Self {
        let d = |dx: isize, dy: isize, dl: isize| {
            let (x, y) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            let level = level.wrapping_add_signed(dl);
            planes[level + 1].at(x, y) - planes[level].at(x, y)
        };
        let value = d(0, 0, 0);
        let first = |a: f32, b: f32| 0.5 * (b - a);
        let second = |a: f32, b: f32| a + b - 2.0 * value;
        let cross = |aa: f32, ab: f32, ba: f32, bb: f32| 0.25 * (aa + bb - ab - ba);
        let xy = cross(d(-1, -1, 0), d(-1, 1, 0), d(1, -1, 0), d(1, 1, 0));
        let xl = cross(d(-1, 0, -1), d(-1, 0, 1), d(1, 0, -1), d(1, 0, 1));
        let yl = cross(d(0, -1, -1), d(0, -1, 1), d(0, 1, -1), d(0, 1, 1));
        let xx = second(d(-1, 0, 0), d(1, 0, 0));
        let yy = second(d(0, -1, 0), d(0, 1, 0));
        let ll = second(d(0, 0, -1), d(0, 0, 1));
        Self {
            value,
            gradient: Vector3::new(
                first(d(-1, 0, 0), d(1, 0, 0)),
                first(d(0, -1, 0), d(0, 1, 0)),
                first(d(0, 0, -1), d(0, 0, 1)),
            ),
            hessian: Matrix3::new(xx, xy, xl, xy, yy, yl, xl, yl, ll),
        }
    }

    /// From the pixel and scale to the extremum.
    fn extremum(&self) -> Option<Vector3<f32>> {
        let step = -(self.hessian.try_inverse()? * self.gradient);
        step.iter().all(|s| s.is_finite()).then_some(step)
    }

    fn is_edge(&self) -> bool {
        let (xx, yy, xy) = (self.hessian[(0, 0)], self.hessian[(1, 1)], self.hessian[(0, 1)]);
        let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
        let r = MAX_CURVATURE_RATIO;
        determinant <= 0.0 || trace * trace * r >= (r + 1.0) * (r + 1.0) * determinant
    }
}

/// Standard deviation of the weights about a keypoint, as a multiple of the keypoint's.
const SPREAD: f32 = 1.5;

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn directions(plane: &Plane, keypoint: &Keypoint) -> Vec<f32> {
    let sigma = SPREAD * keypoint.sigma;
    let reach = (3.0 * sigma).round() as isize;
    let [x, y] = keypoint.place.map(|p| p.round() as isize);
    let inside = |i: isize, length: usize| i > 0 && i + 1 < length as isize;
    let columns: Vec<usize> =
        (x - reach..=x + reach).filter(|i| inside(*i, plane.width)).map(|i| i as usize).collect();
    let weight =
        |i: usize, middle: isize| (-0.5 * ((i as isize - middle) as f32 / sigma).powi(2)).exp();
    let along: Vec<f32> = columns.iter().map(|&i| weight(i, x)).collect();
    let mut histogram = [0.0; BINS];
    let (Some(&first), n) = (columns.first(), columns.len()) else { return Vec::new() };
    let mut strengths = vec![0.0_f32; n];
    let mut bins = vec![0.0_f32; n];
    for row in (y - reach..=y + reach).filter(|i| inside(*i, plane.height)) {
        let row = row as usize;
        let of_row = weight(row, y);
        let [above, here, below] = [row - 1, row, row + 1].map(|r| plane.row(r));
        let (above, below) = (&above[first..first + n], &below[first..first + n]);
        let (left, right) = (&here[first - 1..first - 1 + n], &here[first + 1..first + 1 + n]);
        for i in 0..n {
            let (dx, dy) = (right[i] - left[i], below[i] - above[i]);
            strengths[i] = of_row * along[i] * (dx * dx + dy * dy).sqrt();
            bins[i] = eighths(dx, dy) * (BINS as f32 / 8.0) + 0.5;
        }
        for (strength, bin) in strengths.iter().zip(&bins) {
            histogram[*bin as usize % BINS] += strength;
        }
    }
    peaks(&histogram)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{PI, TAU};

    const WIDTH: usize = 200;
    const HEIGHT: usize = 160;

    fn picture(value: impl Fn(f32, f32) -> f32) -> Gray {
        let bytes: Vec<u8> = (0..WIDTH * HEIGHT)
            .map(|i| value((i % WIDTH) as f32, (i / WIDTH) as f32).round().clamp(0.0, 255.0) as u8)
            .collect();
        Gray::new(WIDTH, HEIGHT, &bytes).unwrap()
    }

    fn space(value: impl Fn(f32, f32) -> f32) -> ScaleSpace {
        ScaleSpace::doubled(&picture(value)).unwrap()
    }

    /// A bright blob on grey.
    fn blob(x: f32, y: f32, at: [f32; 2], sigma: f32) -> f32 {
        let squared = (x - at[0]).powi(2) + (y - at[1]).powi(2);
        60.0 + 120.0 * (-0.5 * squared / sigma.powi(2)).exp()
    }

    #[test]
    fn a_blob_is_found_where_it_is_and_as_large_as_it_is() {
        for (at, sigma) in [([90.0, 70.0], 3.0), ([63.3, 81.6], 4.5), ([120.4, 60.7], 8.0)] {
            let picture = picture(|x, y| blob(x, y, at, sigma));
            for space in [ScaleSpace::new(&picture), ScaleSpace::doubled(&picture)] {
                let found = space.unwrap().keypoints(2.0);
                let best = found.iter().max_by(|a, b| a.response.total_cmp(&b.response)).unwrap();
                let off = (best.pixel[0] - at[0]).hypot(best.pixel[1] - at[1]);
                assert!(off < 0.15, "{off} px from {at:?}");
                assert!((0.75..1.25).contains(&(0.5 * best.size / sigma)), "{} {sigma}", best.size);
            }
        }
    }

    #[test]
    fn a_plain_picture_and_a_straight_edge_have_no_keypoints() {
        assert!(space(|_, _| 100.0).keypoints(0.5).is_empty());
        assert!(
            space(|x, y| if x + 0.5 * y > 120.0 { 180.0 } else { 60.0 }).keypoints(2.0).is_empty()
        );
    }

    #[test]
    fn a_picture_of_a_few_pixels_has_none() {
        for (width, height) in [(1, 1), (2, 90), (90, 2), (5, 5), (40, 7)] {
            let bytes: Vec<u8> = (0..width * height).map(|i| (i * 97) as u8).collect();
            let gray = Gray::new(width, height, &bytes).unwrap();
            let found = ScaleSpace::doubled(&gray).unwrap().keypoints(1.0);
            let narrow = width.min(height) <= BORDER;
            assert!(!narrow || found.is_empty(), "{width} x {height}: {found:?}");
        }
    }

    #[test]
    fn directions_turn_with_the_picture() {
        // A small blob beside a large one: it gets brighter towards the large one.
        let (middle, large) = ([90.0, 70.0], [78.0, 76.0]);
        let picture = |x: f32, y: f32| blob(x, y, middle, 2.0) + 0.5 * blob(x, y, large, 9.0);
        let direction = |space: &ScaleSpace, at: [f32; 2]| {
            let near = |k: &&Keypoint| (k.pixel[0] - at[0]).hypot(k.pixel[1] - at[1]) < 1.5;
            let found = space.keypoints(2.0);
            let keypoint = found
                .iter()
                .filter(near)
                .max_by(|a, b| a.response.total_cmp(&b.response))
                .expect("the small blob is found");
            space.directions(keypoint)
        };
        let upright = direction(&space(picture), middle);
        // What lies to the right lies below when all is turned by a quarter.
        let side = HEIGHT as f32 - 1.0;
        let turned = direction(&space(|x, y| picture(y, side - x)), [side - middle[1], middle[0]]);
        let towards = (large[1] - middle[1]).atan2(large[0] - middle[0]);
        let apart = |a: f32, b: f32| ((a - b + PI).rem_euclid(TAU) - PI).abs();
        assert!(upright.iter().any(|a| apart(*a, towards) < 0.44), "{upright:?} {towards}");
        assert_eq!(upright.len(), turned.len());
        let is_found = |a: f32| turned.iter().any(|b| apart(a, *b) < 0.035);
        assert!(upright.iter().all(|a| is_found(a + 0.5 * PI)), "{upright:?} {turned:?}");
    }
}
