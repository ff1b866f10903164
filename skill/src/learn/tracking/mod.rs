//! Spatio-temporal feature tracking: corners are detected, predicted by optical flow, checked by
//! flow failure detection and by their descriptors, corrected by new detections, replaced where
//! none are left, and lifted to 3-D with position and normal.
//!
//! In: RGB-D frames in the order of time.
//! Out: tracks, in pixels and in the camera frame of each frame, metres ([`TrackSet`]).
//! From: paper, section III-A. [`TrackConfig`] names the paper's values and ours.

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
