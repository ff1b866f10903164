//! Spatio-temporal feature tracking (paper, section III-A): corners are found at several
//! scales, predicted by optical flow, checked by flow failure detection and by their
//! description, reinforced by fresh detections, replaced where none are left, and lifted to
//! 3-D with position and normal.

pub(crate) mod config;
mod corners;
mod depth_lift;
mod descriptor;
mod flow;
mod lucas_kanade;
mod surf;
mod thin;
mod track;
mod tracker;

pub use config::TrackConfig;
pub use depth_lift::{DepthLift, Lifter};
pub use descriptor::{DescriptorKind, Descriptors, describe};
pub use flow::{FlowMethod, Picture, Prediction};
pub use surf::{Surf, SurfPoint};
pub use thin::informative_frames;
pub use track::{Observation, Track, TrackSet, Trajectory};
pub use tracker::Tracker;
