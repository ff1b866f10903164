//! What a frame of 640 x 480 costs in each of the skill's stages that see every one: followed by
//! the tracker, described for recognition, prepared for an object that is followed. At 30 Hz a core
//! has 33.3 ms for each.

#![allow(missing_docs)]

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use linkage_skill::SkillConfig;
use linkage_skill::recognise::Scene;
use linkage_skill::track::Tracker;
use std::hint::black_box;
use std::sync::Arc;

/// A board with blobs of many sizes, `shift` pixels to the left.
fn frame(index: usize, shift: f64) -> RgbdFrame {
    let camera = PinholeCamera::kinect();
    let (width, height) = (camera.width, camera.height);
    let value = |i: usize| {
        let (x, y) = ((i % width) as f64 + shift, (i / width) as f64);
        let wave = (0.31 * x).sin() * (0.27 * y).cos()
            + (0.11 * x + 0.07 * y).sin() * (0.05 * x - 0.09 * y).cos()
            + (0.017 * x * (1.0 + 0.001 * y)).sin();
        (128.0 + 40.0 * wave) as u8
    };
    let rgb = (0..width * height).flat_map(|i| [value(i); 3]).collect();
    let metres = (0..width * height).map(|i| 0.8 + (i % width) as f32 * 0.001).collect();
    let color = ColorImage::new(width, height, rgb).expect("three bytes a pixel");
    let depth = DepthImage::from_metres(width, height, metres).expect("a reading a pixel");
    RgbdFrame::new(33_333 * (1 + index as i64), Arc::new(camera), color, depth).expect("one size")
}

fn stages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("a frame");
    group.sample_size(20);
    let config = SkillConfig::default();
    let first = frame(0, 0.0);
    let rest: Vec<RgbdFrame> = (1..6).map(|i| frame(i, 1.5 * i as f64)).collect();
    let started = || {
        let mut tracker = Tracker::new(config.track.clone());
        tracker.push(&first).expect("a frame is tracked");
        tracker
    };
    group.bench_function("tracked, five of them", |b| {
        let track = |mut tracker: Tracker| {
            rest.iter().for_each(|f| tracker.push(f).expect("a frame is tracked"));
            tracker
        };
        b.iter_batched(started, track, BatchSize::PerIteration);
    });
    group.bench_function("described", |b| b.iter(|| Scene::new(black_box(&first))));
    group.bench_function("prepared to be followed in", |b| {
        b.iter(|| Scene::plain(black_box(&first)))
    });
}

criterion_group!(benches, stages);
criterion_main!(benches);
