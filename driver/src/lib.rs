//! RGB-D frames, cameras, and the sources that deliver them.
//!
//! Everything downstream sees an [`RgbdFrame`]: colour and depth registered to one
//! [`PinholeCamera`], at one instant. Where it came from, a recording or a live
//! sensor, is hidden behind [`RgbdSource`]; [`open`] turns a source name such as
//! `tum:DIR` into one.
//!
//! Camera frame: x right, y down, z forward; metres.

pub mod camera;
pub mod depth;
pub mod frame;
pub mod image_file;
pub mod source;
pub mod tum;

pub use camera::{CameraError, PinholeCamera};
pub use frame::{ColorImage, DepthImage, FrameError, RgbdFrame};
pub use source::{RgbdSource, SourceError, open};
