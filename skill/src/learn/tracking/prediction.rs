//! The place of a feature that an optical flow predicts, with its forward-backward error.

use nalgebra::Point2;

/// A feature's predicted place and its forward-backward error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Place in the next frame, pixels.
    pub pixel: Point2<f32>,
    /// Distance by which the backward flow misses the start of the forward flow, pixels.
    pub forward_backward_px: f32,
}
