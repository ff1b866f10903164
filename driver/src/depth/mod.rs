//! Depth post-processing: smoothing that keeps edges, and surface normals.

mod bilateral;
mod normals;
mod registration;

pub use bilateral::{BilateralConfig, smooth};
pub use normals::{NormalMap, SurfacePatch};
pub use registration::Registration;

/// Standard deviation of a structured-light sensor's depth in metres at depth `z` metres:
/// noise of the match plus the step of the disparity. It grows with the square of the
/// depth (Khoshelham & Elberink 2012; constants measured on Kinect-like recordings).
pub fn depth_sigma(z: f64) -> f64 {
    let disparity_step = z * z / (580.0 * 0.075) / 8.0 / 3.5;
    0.0012 + 0.0019 * (z - 0.4) * (z - 0.4) + disparity_step
}
