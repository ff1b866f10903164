//! Depth post-processing: smoothing that keeps edges, surface normals, bounds of the readings around a place.

mod bilateral;
mod normals;
mod registration;
mod scale;

pub use crate::depth_bounds::DepthBounds;
pub use crate::depth_noise::{DepthSensor, feature_across_sigma};
pub use bilateral::{BilateralConfig, smooth};
pub use normals::{NormalMap, SurfacePatch};
pub use registration::Registration;
pub use scale::{ScaleCheck, ScaleIssue};
