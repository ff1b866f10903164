//! Predicts features into the next frame by optical flow; the backward flow shows where the
//! prediction failed.
//!
//! In: two images, and points of the first, pixels.
//! Out: the predicted place of each point with its forward-backward error, pixels.
//! From: paper, section III-A; forward-backward error of Kalal et al. 2010.

#[cfg(feature = "paper")]
use super::dense_flow;
use super::lucas_kanade;
use super::lucas_kanade::Pyramid;
use super::prediction::Prediction;
use crate::image::gray::Gray;
use nalgebra::Point2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The optical flow that predicts features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowMethod {
    /// Dense polynomial expansion (Farneback 2003) at half resolution with median filtering: the
    /// paper's choice.
    #[cfg(feature = "paper")]
    Farneback,
    /// Sparse pyramidal Lucas-Kanade.
    LucasKanade,
    /// Dense inverse search (Kroeger et al. 2016).
    #[cfg(feature = "paper")]
    Dis,
}

/// An image that is prepared for one optical flow.
pub struct Picture {
    #[cfg(feature = "paper")]
    method: FlowMethod,
    /// Grey image in which features are detected and described.
    pub gray: Gray,
    /// Image pyramid; `None` for a dense flow.
    pyramid: Option<Pyramid>,
}

impl Picture {
    /// Prepares a grey image.
    pub fn new(gray: Gray, method: FlowMethod) -> opencv::Result<Self> {
        let sparse = method == FlowMethod::LucasKanade;
        let pyramid = sparse.then(|| Pyramid::of(&gray)).transpose()?;
        Ok(Self {
            #[cfg(feature = "paper")]
            method,
            gray,
            pyramid,
        })
    }

    /// Predicts every point of this image into the next one; `None` where the flow fails, and for
    /// all points if the next image is of another size.
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
        self.predict_dense(next, points)
    }

    #[cfg(feature = "paper")]
    fn predict_dense(
        &self,
        next: &Self,
        points: &[Point2<f32>],
    ) -> opencv::Result<Vec<Option<Prediction>>> {
        match self.method {
            FlowMethod::Dis => dense_flow::predict_by_dis(&self.gray, &next.gray, points),
            _ => dense_flow::predict_by_farneback(&self.gray, &next.gray, points),
        }
    }

    /// Without the paper's flows an image that has no pyramid predicts nothing.
    #[cfg(not(feature = "paper"))]
    fn predict_dense(
        &self,
        _next: &Self,
        points: &[Point2<f32>],
    ) -> opencv::Result<Vec<Option<Prediction>>> {
        Ok(vec![None; points.len()])
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_followed_into_a_picture_of_another_size() {
        let methods = [
            FlowMethod::LucasKanade,
            #[cfg(feature = "paper")]
            FlowMethod::Farneback,
            #[cfg(feature = "paper")]
            FlowMethod::Dis,
        ];
        for method in methods {
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
