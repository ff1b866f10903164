//! Frames and results for Foxglove and rerun: an MCAP file, or a WebSocket server for a live viewer.
//!
//! It is built with `--features view`; without the feature, `--mcap` and `--view` are errors.
//! Messages are Foxglove's own schemas, in metres and radians, and bear the time stamps of the
//! frames that they are about.

mod wanted;
mod watched;

#[cfg(not(feature = "view"))]
mod disabled;

#[cfg(feature = "view")]
mod cloud;
#[cfg(feature = "view")]
mod convert;
#[cfg(feature = "view")]
mod door;
#[cfg(feature = "view")]
mod enabled;
#[cfg(feature = "view")]
mod file;
#[cfg(feature = "view")]
mod frame_names;
#[cfg(feature = "view")]
mod live;
#[cfg(feature = "view")]
mod origin;
#[cfg(feature = "view")]
mod pictures;
#[cfg(feature = "view")]
mod readings;
#[cfg(feature = "view")]
mod scene;
#[cfg(feature = "view")]
mod shown;
#[cfg(feature = "view")]
mod topics;

#[cfg(not(feature = "view"))]
pub use disabled::View;
#[cfg(feature = "view")]
pub use enabled::View;
pub use wanted::Wanted;
pub use watched::watched;
