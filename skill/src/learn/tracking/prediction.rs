//! Where a flow predicts a feature, and how sure it is.

use nalgebra::Point2;

/// A feature's predicted place and how far the backward flow misses its start, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Place in the next frame.
    pub pixel: Point2<f32>,
    /// Forward-backward error.
    pub forward_backward_px: f32,
}
