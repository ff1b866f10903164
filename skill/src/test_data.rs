//! Test data: pictures of a synthetic scene, and features of synthetic objects.

use crate::features::quantised::quantise;
use crate::features::{DESCRIPTOR_LENGTH, DescribedFeature, FeatureKind};
use crate::object::appearance::{Appearance, ModelFeature};
use linkage_frames::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// A grey picture of 320 by 240 pixels; `depth` tells how far it is, metres, along the ray through
/// a place one metre before the camera.
pub fn seen(utime: i64, depth: impl Fn(f64, f64) -> f64) -> RgbdFrame {
    let (width, height, focal) = (320, 240, 260.0);
    let camera = PinholeCamera {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: 160.0,
        cy: 120.0,
        ..PinholeCamera::kinect()
    };
    let at = |i: usize| {
        let (u, v) = ((i % width) as f64 - camera.cx, (i / width) as f64 - camera.cy);
        depth(u / focal, v / focal) as f32
    };
    let metres = (0..width * height).map(at).collect();
    let color = ColorImage::new(width, height, vec![9; width * height * 3]).expect("it fits");
    let depth = DepthImage::from_metres(width, height, metres).expect("it fits");
    RgbdFrame::new(utime, Arc::new(camera), color, depth).expect("they are of one size")
}

/// The same picture with paint on it: `brightness` tells it along the same ray.
pub fn painted(
    utime: i64,
    depth: impl Fn(f64, f64) -> f64,
    brightness: impl Fn(f64, f64) -> u8,
) -> RgbdFrame {
    let mut frame = seen(utime, depth);
    let camera = Arc::clone(&frame.camera);
    let at = |i: usize| {
        let (u, v) = ((i % camera.width) as f64, (i / camera.width) as f64);
        [brightness((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy); 3]
    };
    let bytes = (0..camera.width * camera.height).flat_map(at).collect();
    frame.color = ColorImage::new(camera.width, camera.height, bytes).expect("it fits");
    frame
}

/// Brightness at a place of a painted surface, metres: patches of 2.5 cm, none like those about it; each
/// seed gives other paint.
pub fn patches(seed: u32, x: f64, y: f64) -> u8 {
    let number = |place: f64| (place / 0.025).floor() as i32 as u32;
    let mut hash = number(x).wrapping_mul(0x9e37_79b1) ^ number(y).wrapping_mul(0x85eb_ca6b);
    for factor in [0x2c1b_3c6d, 0x297a_2d39] {
        hash = (hash.wrapping_add(seed) ^ (hash >> 15)).wrapping_mul(factor);
    }
    40 + (hash >> 16) as u8 % 170
}

/// Depth of a board across the line of sight, `half` metres to each side of it, before a wall.
pub fn board(half: f64, front: f64, wall: f64) -> impl Fn(f64, f64) -> f64 {
    move |x, y| if (x * front).abs() < half && (y * front).abs() < half { front } else { wall }
}

fn descriptors(seed: u64) -> impl Iterator<Item = [f32; DESCRIPTOR_LENGTH]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let descriptor = move |_| {
        let raw: [f32; DESCRIPTOR_LENGTH] = std::array::from_fn(|_| rng.random::<f32>().powi(4));
        let norm = raw.iter().map(|x| x * x).sum::<f32>().sqrt();
        raw.map(|x| x / norm)
    };
    (0..200).map(descriptor)
}

/// An object of 200 features; each seed gives another.
pub fn features(seed: u64) -> Appearance {
    let feature = |descriptor| ModelFeature {
        part: 0,
        kind: FeatureKind::Rectified,
        point: [0.0; 3],
        normal: [0.0; 3],
        size_m: 0.016,
        descriptor: quantise(&descriptor).to_vec(),
    };
    Appearance { features: descriptors(seed).map(feature).collect(), ..Appearance::default() }
}

/// Every third feature of that object, `size` times as large as it is.
pub fn features_seen(seed: u64, size: f64) -> Vec<DescribedFeature> {
    let feature = |descriptor| DescribedFeature {
        kind: FeatureKind::Rectified,
        pixel: [0.0; 2],
        point: Some(Point3::new(0.1, 0.1, 1.0)),
        normal: Vector3::zeros(),
        size: 0.016 * size,
        descriptor,
    };
    descriptors(seed).step_by(3).map(feature).collect()
}
