//! Prediction of features into the next frame by optical flow, with the backward flow that
//! shows where it failed (Kalal et al. 2010).

use super::lucas_kanade;
use super::lucas_kanade::Pyramid;
use crate::image::gray::{Gray, median_blur_flow};
use nalgebra::Point2;
use opencv::core::{Mat, Size, Vec2f};
use opencv::prelude::*;
use opencv::{imgproc, video};
use rayon::prelude::*;
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

/// A picture made ready for one flow.
pub struct Picture {
    method: FlowMethod,
    /// As features are found and described in.
    pub gray: Gray,
    /// None for a dense flow.
    pyramid: Option<Pyramid>,
}

impl Picture {
    /// Of a grey picture.
    pub fn new(gray: Gray, method: FlowMethod) -> opencv::Result<Self> {
        let sparse = method == FlowMethod::LucasKanade;
        let pyramid = sparse.then(|| Pyramid::of(&gray)).transpose()?;
        Ok(Self { method, gray, pyramid })
    }

    /// Predicts every point of this picture into the next; `None` where the flow itself gave up,
    /// and for all where the next is of another size.
    pub fn predict(
        &self,
        next: &Self,
        points: &[Point2<f32>],
    ) -> opencv::Result<Vec<Option<Prediction>>> {
        let size = |picture: &Self| (picture.gray.width(), picture.gray.height());
        if size(self) != size(next) {
            return Ok(vec![None; points.len()]);
        }
        if let (Some(from), Some(to)) = (&self.pyramid, &next.pyramid) {
            return Ok(predict_sparse(from, to, points));
        }
        match self.method {
            FlowMethod::Dis => predict_dense(&self.gray, &next.gray, points, 1, dis),
            _ => predict_dense(&self.gray, &next.gray, points, 2, farneback),
        }
    }
}

fn predict_sparse(from: &Pyramid, to: &Pyramid, points: &[Point2<f32>]) -> Vec<Option<Prediction>> {
    let there_and_back = |p: &Point2<f32>| {
        let pixel = lucas_kanade::track(from, to, p)?;
        let back = lucas_kanade::track(to, from, &pixel)?;
        Some(Prediction { pixel, forward_backward_px: (back - p).norm() })
    };
    points.par_iter().with_min_len(64).map(there_and_back).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_followed_into_a_picture_of_another_size() {
        for method in [FlowMethod::LucasKanade, FlowMethod::Farneback, FlowMethod::Dis] {
            let of_size = |width: usize, height: usize| {
                let bytes: Vec<u8> = (0..width * height).map(|i| (i * i / 7) as u8).collect();
                let gray = Gray::new(width, height, &bytes).expect("a picture");
                Picture::new(gray, method).expect("a picture made ready")
            };
            let (small, large) = (of_size(160, 120), of_size(320, 240));
            let points = [Point2::new(80.0, 60.0)];
            assert_eq!(small.predict(&large, &points).expect("a prediction"), [None]);
            assert_eq!(large.predict(&small, &points).expect("a prediction"), [None]);
        }
    }
}
