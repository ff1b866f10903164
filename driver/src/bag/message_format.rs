//! How a topic's messages are written, and the messages of pictures, cameras and transforms read by
//! it.

use super::messages::{CameraInfo, CompressedImage, Image};
use super::transforms::{Transform, parse_transforms};
use super::wire::{WireError, WireFormat};
use super::{foxglove, foxglove_ros};

/// How a topic's messages are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageFormat {
    /// Messages of ROS.
    Ros(WireFormat),
    /// Foxglove's own schemas in protobuf.
    Foxglove,
    /// Foxglove's own schemas as messages of ROS.
    FoxgloveRos(WireFormat),
}

impl MessageFormat {
    /// A picture.
    ///
    /// # Errors
    /// [`WireError`], as for all that follow.
    pub fn image(self, message: &[u8]) -> Result<Image<'_>, WireError> {
        match self {
            Self::Ros(format) => Image::parse(message, format),
            Self::Foxglove => foxglove::raw_image(message),
            Self::FoxgloveRos(format) => foxglove_ros::raw_image(message, format),
        }
    }

    /// A compressed picture.
    ///
    /// # Errors
    /// [`WireError`].
    pub fn compressed_image(self, message: &[u8]) -> Result<CompressedImage<'_>, WireError> {
        match self {
            Self::Ros(format) => CompressedImage::parse(message, format),
            Self::Foxglove => foxglove::compressed_image(message),
            Self::FoxgloveRos(format) => foxglove_ros::compressed_image(message, format),
        }
    }

    /// A camera.
    ///
    /// # Errors
    /// [`WireError`].
    pub fn camera_info(self, message: &[u8]) -> Result<CameraInfo, WireError> {
        match self {
            Self::Ros(format) => CameraInfo::parse(message, format),
            Self::Foxglove => foxglove::camera_calibration(message),
            Self::FoxgloveRos(format) => foxglove_ros::camera_calibration(message, format),
        }
    }

    /// Transforms; `message_type` tells whether Foxglove's message holds one or several.
    ///
    /// # Errors
    /// [`WireError`].
    pub fn transforms(
        self,
        message: &[u8],
        message_type: &str,
    ) -> Result<Vec<Transform>, WireError> {
        let is_one = message_type == "foxglove.FrameTransform";
        match self {
            Self::Ros(format) => parse_transforms(message, format),
            Self::Foxglove if is_one => Ok(vec![foxglove::frame_transform(message)?]),
            Self::Foxglove => foxglove::frame_transforms(message),
            Self::FoxgloveRos(format) => foxglove_ros::frame_transforms(message, format, !is_one),
        }
    }
}
