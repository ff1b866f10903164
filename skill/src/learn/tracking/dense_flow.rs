//! Predicts features by dense optical flow with median filtering.
//!
//! In: two images of one size, and points of the first, pixels.
//! Out: their places in the second, and how far the flow back from there misses its start, pixels.
//! From: paper, section III-A: Farneback 2003, with the median filter of Wang et al. 2011. The
//! dense inverse search of Kroeger et al. 2016 is not the paper's.

use super::prediction::Prediction;
use crate::image::gray::Gray;
use nalgebra::Point2;
use opencv::core::{self, DataType, Mat, Size, Vec2f, Vector};
use opencv::prelude::*;
use opencv::{imgproc, video};

/// Predicts points by polynomial expansion (Farneback 2003) at half resolution.
pub fn predict_by_farneback(
    previous: &Gray,
    next: &Gray,
    points: &[Point2<f32>],
) -> opencv::Result<Vec<Option<Prediction>>> {
    predict_dense(previous, next, points, 2, farneback)
}

/// Predicts points by dense inverse search (Kroeger et al. 2016) at full resolution.
pub fn predict_by_dis(
    previous: &Gray,
    next: &Gray,
    points: &[Point2<f32>],
) -> opencv::Result<Vec<Option<Prediction>>> {
    predict_dense(previous, next, points, 1, dis)
}

type DenseFlow = fn(&Mat, &Mat) -> opencv::Result<Mat>;

fn predict_dense(
    previous: &Gray,
    next: &Gray,
    points: &[Point2<f32>],
    shrink: i32,
    flow: DenseFlow,
) -> opencv::Result<Vec<Option<Prediction>>> {
    let (a, b) = (shrunk(previous, shrink)?, shrunk(next, shrink)?);
    let forward = median_blur_flow(&flow(&a, &b)?)?;
    let backward = median_blur_flow(&flow(&b, &a)?)?;
    let scale = shrink as f32;
    Ok(points
        .iter()
        .map(|p| {
            let f = sample(&forward, p, scale)?;
            let pixel = Point2::new(p.x + f[0], p.y + f[1]);
            let back = sample(&backward, &pixel, scale)?;
            let forward_backward_px = (f[0] + back[0]).hypot(f[1] + back[1]);
            Some(Prediction { pixel, forward_backward_px })
        })
        .collect())
}

fn shrunk(gray: &Gray, shrink: i32) -> opencv::Result<Mat> {
    if shrink == 1 {
        return gray.mat().try_clone();
    }
    let size = Size::new(gray.width() as i32 / shrink, gray.height() as i32 / shrink);
    let mut small = Mat::default();
    imgproc::resize(gray.mat(), &mut small, size, 0.0, 0.0, imgproc::INTER_AREA)?;
    Ok(small)
}

/// Flow at a full-resolution pixel, interpolated bilinearly, in full-resolution pixels; `None`
/// outside the image.
fn sample(flow: &Mat, pixel: &Point2<f32>, scale: f32) -> Option<[f32; 2]> {
    let x = (pixel.x + 0.5) / scale - 0.5;
    let y = (pixel.y + 0.5) / scale - 0.5;
    if !(x >= 0.0 && y >= 0.0) {
        return None;
    }
    let (x0, y0) = (x as i32, y as i32);
    if x0 + 1 >= flow.cols() || y0 + 1 >= flow.rows() {
        return None;
    }
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let mut sum = [0.0; 2];
    for (dy, wy) in [(0, 1.0 - fy), (1, fy)] {
        for (dx, wx) in [(0, 1.0 - fx), (1, fx)] {
            let value = flow.at_2d::<Vec2f>(y0 + dy, x0 + dx).ok()?;
            for k in 0..2 {
                sum[k] += wx * wy * value[k] * scale;
            }
        }
    }
    Some(sum)
}

/// 5x5 median of each flow component (Wang et al. 2011, as the paper cites it).
fn median_blur_flow(flow: &Mat) -> opencv::Result<Mat> {
    let mut components: Vector<Mat> = Vector::new();
    core::split(flow, &mut components)?;
    let mut smoothed: Vector<Mat> = Vector::new();
    for component in &components {
        let mut out = Mat::default();
        imgproc::median_blur(&component, &mut out, 5)?;
        smoothed.push(out);
    }
    let mut merged = Mat::default();
    core::merge(&smoothed, &mut merged)?;
    debug_assert_eq!(merged.typ(), Vec2f::opencv_type());
    Ok(merged)
}

fn farneback(a: &Mat, b: &Mat) -> opencv::Result<Mat> {
    let mut flow = Mat::default();
    video::calc_optical_flow_farneback(a, b, &mut flow, 0.5, 3, 15, 3, 5, 1.2, 0)?;
    Ok(flow)
}

fn dis(a: &Mat, b: &Mat) -> opencv::Result<Mat> {
    let mut flow = Mat::default();
    video::DISOpticalFlow::create(video::DISOpticalFlow_PRESET_FAST)?.calc(a, b, &mut flow)?;
    Ok(flow)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth pattern, moved by some pixels to the right.
    fn pattern(shift: f64) -> Gray {
        let at = |i: usize| {
            let (u, v) = ((i % 160) as f64 - shift, (i / 160) as f64);
            (127.0
                + 60.0 * (0.15 * u).sin() * (0.11 * v).cos()
                + 50.0 * (0.05 * u + 0.19 * v).sin()) as u8
        };
        let bytes: Vec<u8> = (0..160 * 120).map(at).collect();
        Gray::new(160, 120, &bytes).unwrap()
    }

    #[test]
    fn both_flows_follow_a_picture_that_moves() {
        let points = [Point2::new(70.0, 60.0), Point2::new(100.0, 40.0)];
        for flow in [predict_by_farneback, predict_by_dis] {
            for (predicted, from) in
                flow(&pattern(0.0), &pattern(3.0), &points).unwrap().iter().zip(&points)
            {
                let predicted = predicted.as_ref().unwrap();
                let off = predicted.pixel - from - nalgebra::Vector2::new(3.0, 0.0);
                assert!(off.norm() < 0.6, "{off}");
                assert!(predicted.forward_backward_px < 0.6);
            }
        }
    }

    #[test]
    fn a_point_at_the_border_has_no_flow() {
        let outside = [Point2::new(159.5, 60.0), Point2::new(-3.0, 5.0)];
        assert_eq!(predict_by_dis(&pattern(0.0), &pattern(0.0), &outside).unwrap(), [None, None]);
    }
}
