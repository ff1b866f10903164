//! Prediction of features into the next frame by optical flow, with the backward flow that
//! shows where it failed (Kalal et al. 2010).

use crate::vision::{Gray, median_blur_flow};
use nalgebra::Point2;
use opencv::core::{Mat, Point2f, Size, TermCriteria, Vec2f, Vector};
use opencv::prelude::*;
use opencv::{imgproc, video};
use serde::{Deserialize, Serialize};

/// The flow that predicts features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowMethod {
    /// Dense polynomial expansion (Farneback 2003) at half resolution with median
    /// filtering, as the paper has it.
    Farneback,
    /// Sparse pyramidal Lucas-Kanade.
    LucasKanade,
    /// Dense inverse search (Kroeger et al. 2016).
    Dis,
}

/// A feature's predicted place and how far the backward flow misses its start, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Place in the next frame.
    pub pixel: Point2<f32>,
    /// Forward-backward error.
    pub forward_backward_px: f32,
}

/// Predicts every point; `None` where the flow itself gave up.
pub fn predict(
    method: FlowMethod,
    previous: &Gray,
    next: &Gray,
    points: &[Point2<f32>],
) -> opencv::Result<Vec<Option<Prediction>>> {
    match method {
        FlowMethod::LucasKanade => predict_lucas_kanade(previous, next, points),
        FlowMethod::Farneback => predict_dense(previous, next, points, 2, farneback),
        FlowMethod::Dis => predict_dense(previous, next, points, 1, dis),
    }
}

fn predict_lucas_kanade(
    previous: &Gray,
    next: &Gray,
    points: &[Point2<f32>],
) -> opencv::Result<Vec<Option<Prediction>>> {
    const LEVELS: i32 = 3;
    let window = Size::new(13, 13);
    let pyramid = |gray: &Gray| -> opencv::Result<Vector<Mat>> {
        let mut levels = Vector::new();
        video::build_optical_flow_pyramid(
            gray.mat(),
            &mut levels,
            window,
            LEVELS,
            true,
            4,
            0,
            true,
        )?;
        Ok(levels)
    };
    let (from, to) = (pyramid(previous)?, pyramid(next)?);
    let track = |a: &Vector<Mat>,
                 b: &Vector<Mat>,
                 start: &Vector<Point2f>|
     -> opencv::Result<(Vector<Point2f>, Vector<u8>)> {
        let criteria = TermCriteria::new(3, 15, 0.03)?;
        let (mut end, mut status, mut error) =
            (Vector::<Point2f>::new(), Vector::<u8>::new(), Vector::<f32>::new());
        video::calc_optical_flow_pyr_lk(
            a,
            b,
            start,
            &mut end,
            &mut status,
            &mut error,
            window,
            LEVELS,
            criteria,
            0,
            1e-4,
        )?;
        Ok((end, status))
    };
    let start: Vector<Point2f> = points.iter().map(|p| Point2f::new(p.x, p.y)).collect();
    if start.is_empty() {
        return Ok(Vec::new());
    }
    let (forward, found) = track(&from, &to, &start)?;
    let (backward, returned) = track(&to, &from, &forward)?;
    Ok((0..points.len())
        .map(|i| {
            let (f, b) = (forward.get(i).ok()?, backward.get(i).ok()?);
            let ok = found.get(i).ok()? > 0 && returned.get(i).ok()? > 0;
            ok.then(|| Prediction {
                pixel: Point2::new(f.x, f.y),
                forward_backward_px: (b.x - points[i].x).hypot(b.y - points[i].y),
            })
        })
        .collect())
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

/// Bilinear flow at a full-resolution pixel, in full-resolution pixels.
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
