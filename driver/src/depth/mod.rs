//! Depth post-processing: smoothing that keeps edges, and surface normals.

mod bilateral;
mod normals;
mod registration;
mod scale;

pub use bilateral::{BilateralConfig, smooth};
pub use normals::{NormalMap, SurfacePatch};
pub use registration::Registration;
pub use scale::{ScaleDoubt, ScaleWatch};

/// Standard deviation of a structured-light sensor's depth in metres at depth `z` metres:
/// noise of the match plus the step of the disparity. It grows with the square of the
/// depth (Khoshelham & Elberink 2012; constants measured on Kinect-like recordings).
pub fn depth_sigma(z: f64) -> f64 {
    let disparity_step = z * z / (580.0 * 0.075) / 8.0 / 3.5;
    0.0012 + 0.0019 * (z - 0.4) * (z - 0.4) + disparity_step
}

/// How far a reading may lie from a surface at depth `z` whose normal has this cosine to the
/// line of sight, metres.
pub fn depth_tolerance(z: f64, cosine: f64) -> f64 {
    let slant = (1.0 / cosine.max(0.2).powi(2) - 1.0).max(0.0).sqrt();
    0.006 + 3.0 * depth_sigma(z) + 0.004 * slant
}
