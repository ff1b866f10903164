//! A message of any bytes, in CDR, as ROS 1 writes it and as Foxglove does: refused, or a picture that
//! lies within it and a camera that can be one.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::bag::camera_info::camera_of;
use linkage_driver::bag::message_format::MessageFormat;
use linkage_driver::bag::picture::{
    color_of_compressed, color_of_image, depth_of_compressed, depth_of_image,
};
use linkage_driver::bag::transforms::{FrameTree, parse_transform};
use linkage_driver::bag::wire::WireFormat;

/// Columns and rows of the pictures that are decoded.
const SIZE: (usize, usize) = (16, 8);
const UNITS_PER_METRE: f64 = 1000.0;

fuzz_target!(|bytes: &[u8]| {
    let wires = [WireFormat::Cdr, WireFormat::Ros1];
    let ros =
        wires.into_iter().flat_map(|w| [MessageFormat::Ros(w), MessageFormat::FoxgloveRos(w)]);
    for format in ros.chain([MessageFormat::Foxglove]) {
        if let Ok(image) = format.image(bytes) {
            assert!(image.data.len() <= bytes.len());
            let _ = color_of_image(&image, SIZE);
            let _ = depth_of_image(&image, SIZE, UNITS_PER_METRE);
        }
        if let Ok(image) = format.compressed_image(bytes) {
            assert!(image.data.len() <= bytes.len());
            let _ = color_of_compressed(&image, SIZE);
            let _ = depth_of_compressed(&image, SIZE, UNITS_PER_METRE);
        }
        if let Ok(info) = format.camera_info(bytes)
            && let Ok(camera) = camera_of(&info, false, UNITS_PER_METRE)
        {
            camera.check().expect("a camera that is accepted can be one");
        }
        for message_type in ["tf2_msgs/TFMessage", "foxglove.FrameTransform"] {
            if let Ok(transforms) = format.transforms(bytes, message_type) {
                FrameTree::default().add(transforms);
            }
        }
        if let MessageFormat::Ros(format) = format {
            let _ = parse_transform(bytes, format);
        }
    }
});
