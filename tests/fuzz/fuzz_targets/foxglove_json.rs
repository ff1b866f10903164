//! A message of Foxglove in JSON of any bytes: refused, or one in protobuf whose picture is no larger than the JSON and
//! whose camera can be one.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::bag::camera_info::camera_of;
use linkage_driver::bag::foxglove_json::in_protobuf;
use linkage_driver::bag::message_format::MessageFormat;
use linkage_driver::bag::picture::{
    color_of_compressed, color_of_image, depth_of_compressed, depth_of_image,
};
use linkage_driver::bag::transforms::FrameTree;

/// Columns and rows of the pictures that are decoded.
const SIZE: (usize, usize) = (16, 8);
const UNITS_PER_METRE: f64 = 1000.0;
const FORMAT: MessageFormat = MessageFormat::Foxglove;

fuzz_target!(|json: &[u8]| {
    check_pictures(json);
    if let Ok(bytes) = in_protobuf("foxglove.CameraCalibration", json)
        && let Ok(info) = FORMAT.camera_info(&bytes)
        && let Ok(camera) = camera_of(&info, false, UNITS_PER_METRE)
    {
        camera.check().expect("a camera that is accepted can be one");
    }
    for message_type in ["foxglove.FrameTransform", "foxglove.FrameTransforms"] {
        if let Ok(bytes) = in_protobuf(message_type, json)
            && let Ok(transforms) = FORMAT.transforms(&bytes, message_type)
        {
            FrameTree::default().add(transforms);
        }
    }
});

fn check_pictures(json: &[u8]) {
    if let Ok(bytes) = in_protobuf("foxglove.RawImage", json)
        && let Ok(image) = FORMAT.image(&bytes)
    {
        assert!(image.data.len() <= json.len());
        let _ = color_of_image(&image, SIZE);
        let _ = depth_of_image(&image, SIZE, UNITS_PER_METRE);
    }
    if let Ok(bytes) = in_protobuf("foxglove.CompressedImage", json)
        && let Ok(image) = FORMAT.compressed_image(&bytes)
    {
        assert!(image.data.len() <= json.len());
        let _ = color_of_compressed(&image, SIZE);
        let _ = depth_of_compressed(&image, SIZE, UNITS_PER_METRE);
    }
}
