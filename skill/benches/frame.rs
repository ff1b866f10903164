//! What a frame of 640 x 480 costs in each of the skill's stages that see every one: followed by
//! the tracker, described for recognition, prepared for an object that is followed. At 30 Hz a core
//! has 33.3 ms for each. And sparse flow and keypoints, ours against OpenCV's.

#![allow(missing_docs)]

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use linkage_frames::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use linkage_skill::SkillConfig;
use linkage_skill::config::FlowMethod;
use linkage_skill::internals::{FeatureDensity, Gray, Keypoints, Picture, Tracker};
use linkage_skill::recognise::Scene;
use nalgebra::Point2;
use opencv::core::{KeyPoint, Mat, Point2f, Size, TermCriteria, Vector, no_array};
use opencv::features2d::SIFT;
use opencv::prelude::*;
use opencv::video;
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

/// Features to follow there and back, as the tracker asks for.
const FEATURES: usize = 2000;

fn flow(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("2000 features there and back");
    group.sample_size(20);
    let grays: Vec<Gray> =
        [0.0, 2.5].map(|shift| Gray::from_color(&frame(0, shift).color).expect("a picture")).into();
    let points: Vec<Point2<f32>> = (0..FEATURES)
        .map(|i| Point2::new(20.3 + 12.0 * (i % 50) as f32, 20.7 + 11.0 * (i / 50) as f32))
        .collect();
    let picture = |gray: &Gray| {
        let gray = gray.blurred(0.7).expect("a picture");
        Picture::new(gray, FlowMethod::LucasKanade).expect("a picture made ready")
    };
    let previous = picture(&grays[0]);
    // The last frame's pyramid is available; the new one's is not.
    group.bench_function("ours", |b| {
        b.iter(|| previous.predict(&picture(&grays[1]), black_box(&points)).expect("a flow"));
    });
    let start: Vector<Point2f> = points.iter().map(|p| Point2f::new(p.x, p.y)).collect();
    let ready = |gray: &Gray| {
        let gray = gray.blurred(0.7).expect("a picture");
        let mut levels: Vector<Mat> = Vector::new();
        let window = Size::new(13, 13);
        video::build_optical_flow_pyramid(gray.mat(), &mut levels, window, 3, true, 4, 0, true)
            .expect("a pyramid");
        levels
    };
    let before = ready(&grays[0]);
    group.bench_function("OpenCV's", |b| {
        b.iter(|| {
            let now = ready(&grays[1]);
            let there = opencvs(&before, &now, black_box(&start));
            opencvs(&now, &before, &there)
        });
    });
}

fn opencvs(from: &Vector<Mat>, to: &Vector<Mat>, start: &Vector<Point2f>) -> Vector<Point2f> {
    let (mut end, mut status, mut error) =
        (Vector::<Point2f>::new(), Vector::<u8>::new(), Vector::<f32>::new());
    let (window, steps) = (Size::new(13, 13), TermCriteria::new(3, 15, 0.03).expect("criteria"));
    video::calc_optical_flow_pyr_lk(
        from,
        to,
        start,
        &mut end,
        &mut status,
        &mut error,
        window,
        3,
        steps,
        0,
        1e-4,
    )
    .expect("a flow");
    end
}

fn keypoints(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("keypoints");
    group.sample_size(20);
    let frame = frame(0, 0.0);
    group.bench_function("ours", |b| {
        b.iter(|| Keypoints::new(black_box(&frame), FeatureDensity::Query, |_, _| true));
    });
    group.bench_function("OpenCV's", |b| {
        b.iter(|| {
            let gray = Gray::from_color(black_box(&frame.color)).expect("a picture");
            let mut found: Vector<KeyPoint> = Vector::new();
            let mut sift = SIFT::create(0, 3, 0.008, 12.0, 1.6).expect("a detector");
            sift.detect(gray.mat(), &mut found, &no_array()).expect("keypoints");
            found
        });
    });
}

criterion_group!(benches, stages, flow, keypoints);
criterion_main!(benches);
