//! Tests: our keypoints and descriptors beside OpenCV's SIFT of the same settings, on a synthetic picture and on
//! one that a real camera took (`$LINKAGE_DATA`).

use super::CONTRAST;
use super::dog_keypoints::{Keypoint, MAX_CURVATURE_RATIO, ScaleSpace};
use super::sift_descriptor::{DESCRIPTOR_LENGTH, Patch, Pyramid, gradients};
use crate::image::gray::Gray;
use opencv::core::{KeyPoint, Mat, Vector, no_array};
use opencv::features2d::SIFT;
use opencv::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f32::consts::TAU;
use std::path::{Path, PathBuf};

/// Bright and dark blobs of many sizes, some of them long, on grey.
fn synthetic() -> Gray {
    const SIZE: [usize; 2] = [360, 280];
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut values = vec![110.0_f64; SIZE[0] * SIZE[1]];
    for _ in 0..700 {
        let at = SIZE.map(|length| rng.random_range(0.0..length as f64));
        let sigma = 1.2 * 10_f64.powf(rng.random_range(0.0..1.0));
        let (stretch, turn) = (rng.random_range(1.0..2.5), rng.random_range(0.0..3.1_f64));
        let height = rng.random_range(-50.0..50.0);
        for (i, value) in values.iter_mut().enumerate() {
            let (x, y) = ((i % SIZE[0]) as f64 - at[0], (i / SIZE[0]) as f64 - at[1]);
            let (along, across) =
                (x * turn.cos() + y * turn.sin(), y * turn.cos() - x * turn.sin());
            let squared = (along / (stretch * sigma)).powi(2) + (across / sigma).powi(2);
            if squared < 20.0 {
                *value += height * (-0.5 * squared).exp();
            }
        }
    }
    let bytes: Vec<u8> = values.iter().map(|v| v.round().clamp(0.0, 255.0) as u8).collect();
    Gray::new(SIZE[0], SIZE[1], &bytes).unwrap()
}

/// A kitchen, as a real camera saw it; `None` where the data are not there.
fn real() -> Option<Gray> {
    let data = std::env::var("LINKAGE_DATA").map_or_else(
        |_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let recording = data.join("real/kitchen7_c");
    if !recording.is_dir() {
        eprintln!("ignored: real/kitchen7_c is not under $LINKAGE_DATA");
        return None;
    }
    let mut frames = linkage_driver::open(recording.to_str().expect("a name in UTF-8")).unwrap();
    let frame = frames.next_frame().unwrap().expect("a frame");
    Some(Gray::from_color(&frame.color).unwrap())
}

/// A feature of OpenCV's, as we write it.
struct Theirs {
    pixel: [f32; 2],
    size: f32,
    /// From right towards down, radians.
    angle: f32,
    /// The square root of its shares.
    descriptor: [f32; DESCRIPTOR_LENGTH],
}

impl Theirs {
    fn all(gray: &Gray) -> Vec<Self> {
        let contrast = f64::from(3.0 * CONTRAST / 255.0);
        let mut sift = SIFT::create(0, 3, contrast, f64::from(MAX_CURVATURE_RATIO), 1.6).unwrap();
        let (mut found, mut descriptors) = (Vector::<KeyPoint>::new(), Mat::default());
        sift.detect_and_compute(gray.mat(), &no_array(), &mut found, &mut descriptors, false)
            .unwrap();
        let rows = descriptors.data_typed::<f32>().unwrap().chunks_exact(DESCRIPTOR_LENGTH);
        found.iter().zip(rows).map(|(keypoint, row)| Self::new(&keypoint, row)).collect()
    }

    fn new(keypoint: &KeyPoint, row: &[f32]) -> Self {
        let sum: f32 = row.iter().sum();
        // OpenCV counts directions from right towards up.
        let ours = |i: usize| row[i / 8 * 8 + (8 - i % 8) % 8];
        Self {
            // OpenCV's doubled picture lies a quarter of a pixel beside the picture.
            pixel: [keypoint.pt().x - 0.25, keypoint.pt().y - 0.25],
            size: keypoint.size(),
            angle: keypoint.angle().to_radians(),
            descriptor: std::array::from_fn(|i| (ours(i) / sum.max(1e-6)).sqrt()),
        }
    }

    /// It is as far from a keypoint of ours as rounding explains, and as large.
    fn is(&self, ours: &Keypoint) -> bool {
        let off = (self.pixel[0] - ours.pixel[0]).hypot(self.pixel[1] - ours.pixel[1]);
        off < 0.5 && (self.size / ours.size).log2().abs() < 0.15
    }

    /// Our descriptor of the same patch: OpenCV's cells are three sigmas wide, and its patch has half a cell
    /// more to each side.
    fn described_by_us(&self, pyramid: &Pyramid) -> [f32; DESCRIPTOR_LENGTH] {
        let half_width = f64::from(self.reach());
        let (sin, cos) = f64::from(self.angle).sin_cos();
        let patch = Patch {
            centre: self.pixel.map(f64::from),
            right: [half_width * cos, half_width * sin],
            down: [-half_width * sin, half_width * cos],
        };
        gradients(pyramid, &patch)
    }

    /// Half the width of its patch, pixels.
    fn reach(&self) -> f32 {
        2.5 * 3.0 * 0.5 * self.size
    }

    /// All of its patch, however it is turned, lies in the picture.
    fn is_inside(&self, gray: &Gray) -> bool {
        let reach = 1.5 * self.reach();
        let fits = |at: f32, length: usize| at > reach && at + reach < length as f32;
        fits(self.pixel[0], gray.width()) && fits(self.pixel[1], gray.height())
    }
}

/// Shares of our keypoints that OpenCV has too, and of its that we have.
fn shares_in_common(gray: &Gray) -> [f64; 2] {
    let ours = ScaleSpace::doubled(gray).unwrap().keypoints(CONTRAST);
    let theirs = Theirs::all(gray);
    assert!(ours.len() > 200 && theirs.len() > 200, "{} and {}", ours.len(), theirs.len());
    let share = |found: usize, all: usize| found as f64 / all as f64;
    let has = |k: &&Keypoint| theirs.iter().any(|t| t.is(k));
    let have = |t: &&Theirs| ours.iter().any(|k| t.is(k));
    [
        share(ours.iter().filter(has).count(), ours.len()),
        share(theirs.iter().filter(have).count(), theirs.len()),
    ]
}

/// Mean inner product of our descriptor and OpenCV's of the same patch, and the share of ours to which of all
/// of OpenCV's that of the same place is nearest.
fn likeness(gray: &Gray) -> (f64, f64) {
    let pyramid = Pyramid::new(gray, super::LEVELS).unwrap();
    let theirs: Vec<Theirs> = Theirs::all(gray).into_iter().filter(|t| t.is_inside(gray)).collect();
    let product = |a: &[f32; DESCRIPTOR_LENGTH], b: &[f32; DESCRIPTOR_LENGTH]| -> f32 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    };
    let (mut sum, mut right) = (0.0, 0);
    for t in &theirs {
        let ours = t.described_by_us(&pyramid);
        sum += f64::from(product(&ours, &t.descriptor));
        let nearest = theirs
            .iter()
            .max_by(|a, b| product(&ours, &a.descriptor).total_cmp(&product(&ours, &b.descriptor)));
        let apart = |n: &Theirs| (n.pixel[0] - t.pixel[0]).hypot(n.pixel[1] - t.pixel[1]);
        right += usize::from(nearest.is_some_and(|n| apart(n) < 2.0));
    }
    let count = theirs.len() as f64;
    (sum / count, right as f64 / count)
}

/// Difference of two angles, radians.
fn apart(a: f32, b: f32) -> f32 {
    ((a - b + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU).abs()
}

/// Share of OpenCV's keypoints that we have too whose direction is one of ours, to five degrees.
fn share_of_directions(gray: &Gray) -> f64 {
    let space = ScaleSpace::doubled(gray).unwrap();
    let ours = space.keypoints(CONTRAST);
    let (mut all, mut right) = (0, 0);
    for t in Theirs::all(gray) {
        let same: Vec<&Keypoint> = ours.iter().filter(|k| t.is(k)).collect();
        let told = |k: &&Keypoint| space.directions(k).iter().any(|a| apart(*a, t.angle) < 0.09);
        all += usize::from(!same.is_empty());
        right += usize::from(same.iter().any(told));
    }
    right as f64 / all as f64
}

#[test]
fn keypoints_are_where_opencv_has_them_and_as_large() {
    for gray in [Some(synthetic()), real()].into_iter().flatten() {
        let [of_ours, of_theirs] = shares_in_common(&gray);
        assert!(of_ours > 0.97 && of_theirs > 0.97, "{of_ours} of ours, {of_theirs} of theirs");
    }
}

#[test]
fn directions_are_those_of_opencv() {
    for gray in [Some(synthetic()), real()].into_iter().flatten() {
        let share = share_of_directions(&gray);
        assert!(share > 0.97, "{share}");
    }
}

#[test]
fn a_descriptor_is_most_like_that_which_opencv_has_of_the_same_place() {
    for gray in [Some(synthetic()), real()].into_iter().flatten() {
        let (likeness, right) = likeness(&gray);
        assert!(likeness > 0.95 && right > 0.98, "likeness {likeness}, nearest {right}");
    }
}
