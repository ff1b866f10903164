//! RGB-D frames: colour and depth registered to one camera, at one instant, and what can be computed
//! of one frame alone. No camera driver, no file of pictures.
//!
//! Camera frame: x right, y down, z forward; metres.
#![forbid(unsafe_code)]

pub mod camera;
pub mod depth;
mod depth_bounds;
mod depth_noise;
pub mod frame;
pub mod frame_error;
pub mod plain_text;
pub mod text_table;

pub use camera::{CameraError, PinholeCamera};
pub use frame::{ColorImage, DepthImage, RgbdFrame};
pub use frame_error::FrameError;
