//! What the project's other crates and benchmarks use beyond the interface. It changes without notice.

pub use crate::articulation::pose_log::parse_pose_log;
pub use crate::config::merge::merge;
pub use crate::features::quantised::{Descriptor, quantise};
pub use crate::features::{DescribedFeature, FeatureDensity, FeatureKind, Keypoints};
pub use crate::image::gray::Gray;
pub use crate::learn::learned_joint::{orient, range_of};
pub use crate::learn::tracking::{Observation, Picture, Track, TrackId, Tracker, Trajectory};
pub use crate::math::rigid::{
    distance_to_line, line_angle, nearest_on_line, orthonormal_basis, plane_through, rigid_fit,
    rotation_about, rotation_nearest,
};
pub use crate::math::robust::median;
pub use crate::object::appearance::{ModelFeature, Surfel};
pub use crate::object::check::check_name;
pub use crate::object::model::{covariance_rows, is_undecided};
pub use crate::recognise::result::{is_yes, yes};
pub use crate::recognise::retrieval::{Index, Vocabulary, Words};
#[cfg(feature = "store")]
pub use crate::store::record::Record;
