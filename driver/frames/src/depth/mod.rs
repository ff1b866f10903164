//! Depth post-processing: smoothing that keeps edges, and surface normals.

mod bilateral;
mod noise;
mod normals;
mod registration;
mod scale;

pub use bilateral::{BilateralConfig, smooth};
pub use noise::{DepthSensor, feature_across_sigma};
pub use normals::{NormalMap, SurfacePatch};
pub use registration::Registration;
pub use scale::{ScaleCheck, ScaleIssue};
