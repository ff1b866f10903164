//! What is particular to the first Kinect: its disparities, its colour mosaic, and where its
//! infrared camera sits. Its drivers, and messages and dumps recorded from it, need this.

mod disparity;

pub use disparity::{NO_DISPARITY, disparity_of, metres_of, unpack_11bit};

use crate::bayer::{self, BayerPattern};
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::Registration;
use nalgebra::Isometry3;

/// The infrared camera's usual values: those that libfreenect assumes of an uncalibrated
/// device (reference plane 1.2 m away, pixels of 0.1042 mm there, so 575.8 pixels).
pub fn infrared_camera() -> PinholeCamera {
    PinholeCamera { fx: 575.8, fy: 575.8, ..PinholeCamera::kinect() }
}

/// RGB of the colour camera's mosaic, whose even rows are green and red; `None` when it does not hold
/// `width * height` bytes or is smaller than 2x2.
pub fn demosaic(mosaic: &[u8], width: usize, height: usize) -> Option<Vec<u8>> {
    bayer::demosaic(BayerPattern::Grbg, mosaic, width, height)
}

/// Registers depth of the infrared camera to colour by the usual distance of the two cameras.
pub fn registration() -> Registration {
    Registration {
        depth_camera: infrared_camera(),
        color_from_depth: Isometry3::translation(-0.023, 0.0, 0.0),
    }
}
