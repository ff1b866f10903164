//! Surfaces painted from a seed: grain at several scales, and marks on richer ones.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Texels on a side.
pub const SIDE: usize = 768;
/// Texels in a metre.
const TEXELS_PER_METRE: f64 = 500.0;

/// How much there is to see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Richness {
    /// Marks everywhere: labels, magnets, prints.
    Rich,
    /// Grain and a few marks.
    Medium,
    /// Nearly plain.
    Poor,
}

/// How much there is to see on a thing at home.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TextureClass {
    /// Paint, metal, laminate.
    Plain,
    /// Wood with a visible grain, or paint with a few labels.
    Medium,
    /// Strong grain and many labels.
    Rich,
}

impl TextureClass {
    /// The name in `truth.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Medium => "medium",
            Self::Rich => "rich",
        }
    }
}

/// A repeating surface, linear RGB 0-255.
pub struct Texture {
    /// Colour without grain and marks, RGB 0-255.
    pub colour: [f64; 3],
    texels: Vec<[f32; 3]>,
    side: usize,
    texels_per_metre: f64,
    /// Surface coordinates of the first texel, metres.
    corner: f64,
}

impl Texture {
    /// Paints one.
    pub fn new(colour: [f64; 3], richness: Richness, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (grain, marks) = match richness {
            Richness::Rich => (26.0, 260),
            Richness::Medium => (18.0, 70),
            Richness::Poor => (3.0, 3),
        };
        let mut light = vec![0.0_f32; SIDE * SIDE];
        for (cell, share) in [(96, 0.5), (32, 0.35), (12, 0.3), (5, 0.2)] {
            add_noise(&mut light, [cell, cell], share * grain, &mut rng);
        }
        let mut texels: Vec<[f32; 3]> =
            light.iter().map(|l| colour.map(|c| c as f32 + l)).collect();
        for _ in 0..marks {
            add_mark(&mut texels, colour, &mut rng);
        }
        Self::of_texels(colour, texels)
    }

    /// A surface of [`SIDE`] by [`SIDE`] texels, rows first.
    pub fn of_texels(colour: [f64; 3], texels: Vec<[f32; 3]>) -> Self {
        Self { colour, texels, side: SIDE, texels_per_metre: TEXELS_PER_METRE, corner: 0.0 }
    }

    /// Black and white cells, top row first, on white paper about the origin: `size_m` wide on
    /// paper of `paper_m`.
    pub fn pattern(cells: &[Vec<bool>], size_m: f64, paper_m: f64) -> Self {
        const PER_CELL: usize = 24;
        let texels_per_metre = (cells.len() * PER_CELL) as f64 / size_m;
        let side = (paper_m * texels_per_metre) as usize;
        let rim = 0.5 * (side as f64 - (cells.len() * PER_CELL) as f64);
        let cell = |texel: usize| ((texel as f64 - rim) / PER_CELL as f64).floor();
        let mut texels = Vec::with_capacity(side * side);
        for v in 0..side {
            for u in 0..side {
                // Rows run down, the surface's y runs up.
                let (column, row) = (cell(u), cell(side - 1 - v));
                let inside = column >= 0.0 && row >= 0.0;
                let white = !inside
                    || cells
                        .get(row as usize)
                        .and_then(|r| r.get(column as usize))
                        .copied()
                        .unwrap_or(true);
                texels.push([if white { 225.0 } else { 18.0 }; 3]);
            }
        }
        Self { colour: [225.0; 3], texels, side, texels_per_metre, corner: -0.5 * paper_m }
    }

    /// Colour at surface coordinates in metres, bilinear.
    pub fn at(&self, x: f64, y: f64) -> [f32; 3] {
        let side = self.side;
        let wrap = |v: f64| ((v - self.corner) * self.texels_per_metre).rem_euclid(side as f64);
        let (u, v) = (wrap(x), wrap(y));
        let (u0, v0) = (u as usize % side, v as usize % side);
        let (u1, v1) = ((u0 + 1) % side, (v0 + 1) % side);
        let (fu, fv) = ((u - u0 as f64) as f32, (v - v0 as f64) as f32);
        let (a, b) = (&self.texels[v0 * side + u0], &self.texels[v0 * side + u1]);
        let (c, d) = (&self.texels[v1 * side + u0], &self.texels[v1 * side + u1]);
        std::array::from_fn(|k| {
            let top = a[k] + fu * (b[k] - a[k]);
            let bottom = c[k] + fu * (d[k] - c[k]);
            top + fv * (bottom - top)
        })
    }
}

/// Smooth value noise in cells of (width, height) texels, which repeats at the borders.
pub fn add_noise(
    light: &mut [f32],
    [width, height]: [usize; 2],
    amplitude: f64,
    rng: &mut ChaCha8Rng,
) {
    let (columns, rows) = (SIDE / width, SIDE / height);
    let lattice: Vec<f32> =
        (0..columns * rows).map(|_| (amplitude * rng.random_range(-1.0..1.0)) as f32).collect();
    let smooth = |f: f32| f * f * (3.0 - 2.0 * f);
    for v in 0..rows * height {
        for u in 0..columns * width {
            let (i, j) = (u / width, v / height);
            let fu = smooth((u % width) as f32 / width as f32);
            let fv = smooth((v % height) as f32 / height as f32);
            let at = |i: usize, j: usize| lattice[(j % rows) * columns + i % columns];
            let top = at(i, j) + fu * (at(i + 1, j) - at(i, j));
            let bottom = at(i, j + 1) + fu * (at(i + 1, j + 1) - at(i, j + 1));
            light[v * SIDE + u] += top + fv * (bottom - top);
        }
    }
}

/// A rectangle, disc or stroke of another colour.
fn add_mark(texels: &mut [[f32; 3]], base: [f64; 3], rng: &mut ChaCha8Rng) {
    let shift = rng.random_range(-90.0..90.0);
    let tint: [f32; 3] =
        std::array::from_fn(|k| (base[k] + shift + rng.random_range(-40.0..40.0)) as f32);
    let centre = [rng.random_range(0.0..SIDE as f64), rng.random_range(0.0..SIDE as f64)];
    let half = [rng.random_range(2.0..22.0), rng.random_range(2.0..22.0)];
    let (sin, cos) = rng.random_range(0.0..std::f64::consts::PI).sin_cos();
    let disc = rng.random_bool(0.35);
    let reach = half[0] + half[1];
    for dv in -(reach as i32)..=reach as i32 {
        for du in -(reach as i32)..=reach as i32 {
            let (du, dv) = (f64::from(du), f64::from(dv));
            let (x, y) = ((du * cos + dv * sin) / half[0], (dv * cos - du * sin) / half[1]);
            let inside = if disc { x * x + y * y < 1.0 } else { x.abs() < 1.0 && y.abs() < 1.0 };
            if inside {
                let u = (centre[0] + du).rem_euclid(SIDE as f64) as usize % SIDE;
                let v = (centre[1] + dv).rem_euclid(SIDE as f64) as usize % SIDE;
                texels[v * SIDE + u] = tint;
            }
        }
    }
}
