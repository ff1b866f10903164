//! Depth post-processing: smoothing that keeps edges, and surface normals.

mod bilateral;
mod normals;
mod registration;
mod scale;

pub use crate::depth_noise::{DepthSensor, feature_across_sigma};
pub use bilateral::{BilateralConfig, smooth};
pub use normals::{NormalMap, SurfacePatch};
pub use registration::Registration;
pub use scale::{ScaleCheck, ScaleIssue};
