//! A demonstration may last as long as it likes: memory is kept for so many frames, those in which
//! nothing moves are forgotten, and what moved is learned all the same.

use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use linkage_skill::object::joint_geometry::JointKind;
use linkage_skill::{Learner, SkillConfig};
use std::sync::Arc;

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

fn camera() -> PinholeCamera {
    PinholeCamera {
        width: WIDTH,
        height: HEIGHT,
        fx: 131.0,
        fy: 131.0,
        cx: 79.5,
        cy: 59.5,
        ..PinholeCamera::kinect()
    }
}

/// Texture at a place on a surface, metres: grey values that change smoothly over 2 cm.
fn texture(x: f64, y: f64, surface: i64) -> f64 {
    let value = |i: i64, j: i64| {
        let mut h = (i * 73_856_093) ^ (j * 19_349_663) ^ (surface * 83_492_791);
        h = (h ^ (h >> 13)).wrapping_mul(1_274_126_177);
        ((h >> 8) & 0xff) as f64
    };
    let (u, v) = (x / 0.02, y / 0.02);
    let (i, j) = (u.floor() as i64, v.floor() as i64);
    let (a, b) = (u - u.floor(), v - v.floor());
    let row = |j: i64| value(i, j) * (1.0 - a) + value(i + 1, j) * a;
    row(j) * (1.0 - b) + row(j + 1) * b
}

/// A wall at 1.5 m, and before it a panel that has slid by `q` metres to the right.
fn frame(number: usize, q: f64, camera: &Arc<PinholeCamera>) -> RgbdFrame {
    let mut grey = Vec::with_capacity(WIDTH * HEIGHT);
    let mut depth = Vec::with_capacity(grey.capacity());
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let ray = camera.back_project(column as f64, row as f64, 1.0);
            let (x, y) = (ray.x * 1.2 - q, ray.y * 1.2);
            let on_panel = (-0.45..-0.05).contains(&x) && (-0.25..0.25).contains(&y);
            let (z, value) = if on_panel {
                (1.2, texture(x, y, 1))
            } else {
                (1.5, texture(ray.x * 1.5, ray.y * 1.5, 2))
            };
            grey.push(value as u8);
            depth.push(z as f32);
        }
    }
    let color =
        ColorImage::new(WIDTH, HEIGHT, grey.iter().flat_map(|g| [*g; 3]).collect()).unwrap();
    let depth = DepthImage::from_metres(WIDTH, HEIGHT, depth).unwrap();
    RgbdFrame::new(number as i64 * 33_333, Arc::clone(camera), color, depth).unwrap()
}

#[test]
fn a_demonstration_far_longer_than_memory_is_kept_for_is_learned() {
    const ROOM: usize = 120;
    let mut config = SkillConfig::load("default", None).unwrap();
    config.track.max_frames = ROOM;
    let mut learner = Learner::new(&config);
    let camera = Arc::new(camera());
    // Still for long, 60 frames of motion, still for longer: seven times as many as there is room for.
    let configuration = |i: usize| (i.clamp(300, 360) - 300) as f64 * 0.005;
    for i in 0..840 {
        learner.push(&frame(i, configuration(i), &camera)).unwrap();
        assert!(learner.tracker().frames() <= ROOM);
        let seen = learner.tracker().seen();
        assert!(seen.tracks.iter().all(|t| t.observations.len() <= ROOM));
    }
    let learned = learner.finish("panel").unwrap();
    let joint = &learned.model.joints[0];
    assert_eq!(learned.model.joints.len(), 1);
    assert_eq!(joint.kind, JointKind::Prismatic);
    assert!(joint.axis[0].abs() > 0.99, "{:?}", joint.axis);
    assert!((joint.range[1] - 0.3).abs() < 0.02, "{:?}", joint.range);
    let times = &learned.frame_utimes;
    assert!((times[0], *times.last().unwrap()) == (0, 839 * 33_333));
}
