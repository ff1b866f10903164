//! A message of any bytes, in CDR and as ROS 1 writes it: refused, or a picture that lies within
//! it and a camera that can be one.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::bag::camera_info::camera_of;
use linkage_driver::bag::messages::{CameraInfo, CompressedImage, Image};
use linkage_driver::bag::picture::{
    color_of_compressed, color_of_image, depth_of_compressed, depth_of_image,
};
use linkage_driver::bag::transforms::{FrameTree, parse_transform};
use linkage_driver::bag::wire::WireFormat;

/// Columns and rows of the pictures that are decoded.
const SIZE: (usize, usize) = (16, 8);
const UNITS_PER_METRE: f64 = 1000.0;

fuzz_target!(|bytes: &[u8]| {
    for format in [WireFormat::Cdr, WireFormat::Ros1] {
        if let Ok(image) = Image::parse(bytes, format) {
            assert!(image.data.len() <= bytes.len());
            let _ = color_of_image(&image, SIZE);
            let _ = depth_of_image(&image, SIZE, UNITS_PER_METRE);
        }
        if let Ok(image) = CompressedImage::parse(bytes, format) {
            assert!(image.data.len() <= bytes.len());
            let _ = color_of_compressed(&image, SIZE);
            let _ = depth_of_compressed(&image, SIZE, UNITS_PER_METRE);
        }
        if let Ok(info) = CameraInfo::parse(bytes, format)
            && let Ok(camera) = camera_of(&info, false, UNITS_PER_METRE)
        {
            camera.check().expect("a camera that is accepted can be one");
        }
        let _ = FrameTree::default().add(bytes, format);
        let _ = parse_transform(bytes, format);
    }
});
