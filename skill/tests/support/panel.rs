// A synthetic recording: a panel with texture slides before a board. Tests, examples and the
// examples of the documentation include this file.

use linkage_frames::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use std::sync::Arc;

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

/// A small camera.
pub fn camera() -> PinholeCamera {
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

/// A board before a wall, and before the board a panel that has slid by `q` metres to the right.
pub fn frame(number: usize, q: f64, camera: &Arc<PinholeCamera>) -> RgbdFrame {
    let mut grey = Vec::with_capacity(WIDTH * HEIGHT);
    let mut depth = Vec::with_capacity(grey.capacity());
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let ray = camera.back_project(column as f64, row as f64, 1.0);
            let at = |z: f64| (ray.x * z, ray.y * z);
            let ((x, y), board, wall) = (at(1.2), at(1.3), at(2.0));
            let (z, value) = if (-0.45..-0.05).contains(&(x - q)) && y.abs() < 0.25 {
                (1.2, texture(x - q, y, 1))
            } else if board.0.abs() < 0.5 && board.1.abs() < 0.35 {
                (1.3, texture(board.0, board.1, 2))
            } else {
                (2.0, texture(wall.0, wall.1, 3))
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

/// The panel rests, slides by 0.3 m, and rests.
pub fn panel_that_opens() -> impl Iterator<Item = RgbdFrame> {
    let camera = Arc::new(camera());
    (0..80_usize).map(move |i| frame(i, (i.clamp(10, 70) - 10) as f64 * 0.005, &camera))
}
