//! RGB-D frames, cameras, and the sources that deliver them.
//!
//! Everything downstream sees an [`RgbdFrame`]: colour and depth registered to one
//! [`PinholeCamera`], at one instant. Where it came from, a recording or a live
//! sensor, is hidden behind [`RgbdSource`]; [`open`] turns a source name such as
//! `tum:DIR` or `freenect:0` into one. [`record`] writes what a source delivers.
//!
//! Camera frame: x right, y down, z forward; metres.

pub mod bag;
mod bayer;
mod camera_file;
pub mod error;
pub mod folders;
pub mod freenect;
pub mod image_file;
pub mod jpeg;
pub mod kinect;
pub mod lcm;
pub mod live;
pub mod mcap_file;
pub mod openni2;
pub mod path_kind;
pub mod record;
pub mod record3d;
pub mod rgbd_source;
pub mod rosbag1;
pub mod rosbag2;
mod rvl;
pub mod source;
pub mod statistics;
pub mod timestamp_filter;
pub mod tum;
pub mod v4l;
mod wrapped_source;
mod yuv;

pub use camera_file::read_camera_file;
pub use error::{FrameError, PictureFault, SourceError};
pub use linkage_frames::{
    CameraError, ColorImage, DepthImage, PinholeCamera, RgbdFrame, camera, depth, frame,
    plain_text, text_table,
};
pub use rgbd_source::{Awaited, RgbdSource};
pub use source::{SourceOptions, open, open_with};
pub use statistics::SourceStatistics;
pub use timestamp_filter::{Timeline, TimestampFilter};
pub use wrapped_source::WrappedSource;
