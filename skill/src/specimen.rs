//! What tests look at: pictures of a made-up scene.

use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
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

/// Depth of a board across the line of sight, `half` metres to each side of it, before a wall.
pub fn board(half: f64, front: f64, wall: f64) -> impl Fn(f64, f64) -> f64 {
    move |x, y| if (x * front).abs() < half && (y * front).abs() < half { front } else { wall }
}
