//! Spatio-temporal feature tracking (paper, section III-A): corners are found at several
//! scales, predicted by optical flow, checked by flow failure detection and by their
//! description, reinforced by fresh detections, replaced where none are left, and lifted to
//! 3-D with position and normal.

pub(crate) mod config;
mod corners;
#[cfg(feature = "paper")]
mod dense_flow;
mod depth_lift;
mod descriptor;
mod flow;
mod lucas_kanade;
mod prediction;
#[cfg(feature = "paper")]
mod surf;
mod thin;
mod track;
mod tracker;

pub use config::TrackConfig;
pub use depth_lift::DepthLift;
pub use descriptor::DescriptorKind;
pub use flow::{FlowMethod, Picture};
pub use thin::informative_frames;
pub use track::{Observation, Track, TrackId, TrackSet, Trajectory};
pub use tracker::Tracker;
