//! Depth post-processing: smoothing that keeps edges, and surface normals.

mod bilateral;
mod noise;
mod normals;
mod registration;
mod scale;

pub use bilateral::{BilateralConfig, smooth};
pub use noise::{depth_sigma, depth_tolerance};
pub use normals::{NormalMap, SurfacePatch};
pub use registration::Registration;
pub use scale::{ScaleCheck, ScaleIssue};
