//! Foxglove's messages as messages of ROS 1 and ROS 2: the package `foxglove_msgs`.
//!
//! They hold what those of protobuf do, without field numbers and in another order: a time stamp, which
//! has no header round it, comes first.

use super::messages::{CameraInfo, CompressedImage, Header, Image, MAX_DISTORTION, stamp};
use super::transforms::{MAX_TRANSFORMS, Transform, pose_of};
use super::wire::{WireError, WireFormat, WireReader};

/// `foxglove_msgs/RawImage`.
///
/// # Errors
/// [`WireError`], as for all that follow.
pub fn raw_image(message: &[u8], format: WireFormat) -> Result<Image<'_>, WireError> {
    let mut reader = WireReader::new(message, format)?;
    let header = header(&mut reader, format)?;
    let (width, height) = (reader.u32("width")? as usize, reader.u32("height")? as usize);
    Ok(Image {
        header,
        width,
        height,
        encoding: reader.text("encoding")?,
        is_big_endian: false,
        step: reader.u32("step")? as usize,
        data: reader.bytes("data")?,
    })
}

/// `foxglove_msgs/CompressedImage`.
///
/// # Errors
/// [`WireError`].
pub fn compressed_image(
    message: &[u8],
    format: WireFormat,
) -> Result<CompressedImage<'_>, WireError> {
    let mut reader = WireReader::new(message, format)?;
    let header = header(&mut reader, format)?;
    let data = reader.bytes("data")?;
    Ok(CompressedImage { header, format: reader.text("format")?, data })
}

/// `foxglove_msgs/CameraCalibration`.
///
/// # Errors
/// [`WireError`].
pub fn camera_calibration(message: &[u8], format: WireFormat) -> Result<CameraInfo, WireError> {
    let mut reader = WireReader::new(message, format)?;
    let header = header(&mut reader, format)?;
    let (width, height) = (reader.u32("width")? as usize, reader.u32("height")? as usize);
    let distortion_model = reader.text("distortion_model")?.to_owned();
    let d = reader.f64_sequence("D", MAX_DISTORTION)?;
    let k = reader.f64s::<9>("K")?;
    reader.f64s::<9>("R")?;
    let p = reader.f64s::<12>("P")?;
    let frame = header.frame.to_owned();
    Ok(CameraInfo { frame, width, height, distortion_model, d, k, p, binning: [0, 0] })
}

/// `foxglove_msgs/FrameTransform`, or `foxglove_msgs/FrameTransforms` where it holds several.
///
/// # Errors
/// [`WireError`], for more than [`MAX_TRANSFORMS`] too.
pub fn frame_transforms(
    message: &[u8],
    format: WireFormat,
    holds_several: bool,
) -> Result<Vec<Transform>, WireError> {
    let mut reader = WireReader::new(message, format)?;
    let count = if holds_several { reader.u32("transforms")? as usize } else { 1 };
    if count > MAX_TRANSFORMS {
        return Err(WireError::Value { field: "transforms", value: format!("{count} of them") });
    }
    let mut transforms = Vec::new();
    for _ in 0..count {
        transforms.push(frame_transform(&mut reader, format)?);
    }
    Ok(transforms)
}

fn frame_transform(
    reader: &mut WireReader<'_>,
    format: WireFormat,
) -> Result<Transform, WireError> {
    stamp(reader, format)?;
    let parent = reader.text("parent_frame_id")?.to_owned();
    let child = reader.text("child_frame_id")?.to_owned();
    let parent_from_child = pose_of(reader.f64s("translation")?, reader.f64s("rotation")?)?;
    Ok(Transform { parent, child, parent_from_child })
}

fn header<'b>(reader: &mut WireReader<'b>, format: WireFormat) -> Result<Header<'b>, WireError> {
    Ok(Header { utime: stamp(reader, format)?, frame: reader.text("frame_id")? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::messages::tests::{ros1, text};
    use proptest::prelude::*;

    fn numbers(values: &[f64]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    /// 12.345678 s.
    fn time() -> Vec<u8> {
        ros1(&[&12_u32.to_le_bytes(), &345_678_900_u32.to_le_bytes()])
    }

    fn size() -> Vec<u8> {
        ros1(&[&1_u32.to_le_bytes(), &2_u32.to_le_bytes()])
    }

    fn raw() -> Vec<u8> {
        let (step, data) = (2_u32.to_le_bytes(), [4, 0, 0, 0, 1, 2, 3, 4]);
        ros1(&[&time(), &text("optical"), &size(), &text("16UC1"), &step, &data])
    }

    #[test]
    fn a_raw_image_is_read_field_by_field() {
        let message = raw();
        let image = raw_image(&message, WireFormat::Ros1).unwrap();
        assert_eq!(image.header, Header { utime: 12_345_678, frame: "optical" });
        assert_eq!((image.width, image.height, image.step), (1, 2, 2));
        assert_eq!((image.encoding, image.data), ("16UC1", &[1, 2, 3, 4][..]));
        for length in 0..message.len() {
            assert!(raw_image(&message[..length], WireFormat::Ros1).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn a_compressed_image_has_its_data_before_its_format() {
        let message = ros1(&[&time(), &text("c"), &[3, 0, 0, 0, 7, 8, 9], &text("png")]);
        let image = compressed_image(&message, WireFormat::Ros1).unwrap();
        assert_eq!((image.format, image.data), ("png", &[7, 8, 9][..]));
    }

    #[test]
    fn a_camera_is_read_with_its_matrices() {
        let k = [30.0, 0.0, 3.5, 0.0, 31.0, 2.5, 0.0, 0.0, 1.0];
        let p = [29.0, 0.0, 3.0, 0.0, 0.0, 30.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let d = ros1(&[&2_u32.to_le_bytes(), &numbers(&[0.1, 0.2])]);
        let matrices = ros1(&[&d, &numbers(&k), &numbers(&[0.0; 9]), &numbers(&p)]);
        let message = ros1(&[&time(), &text("c"), &size(), &text("plumb_bob"), &matrices]);
        let info = camera_calibration(&message, WireFormat::Ros1).unwrap();
        assert_eq!((info.width, info.height, info.k, info.p), (1, 2, k, p));
        assert_eq!((info.distortion_model.as_str(), info.d), ("plumb_bob", vec![0.1, 0.2]));
    }

    #[test]
    fn transforms_come_alone_or_several() {
        let pose = numbers(&[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
        let one = ros1(&[&time(), &text("base"), &text("color"), &pose]);
        let two = ros1(&[&2_u32.to_le_bytes(), &one, &one]);
        for (message, holds_several, count) in [(one, false, 1), (two, true, 2)] {
            let read = frame_transforms(&message, WireFormat::Ros1, holds_several).unwrap();
            assert_eq!((read.len(), &*read[0].parent, &*read[0].child), (count, "base", "color"));
            assert_eq!(read[0].parent_from_child.translation.vector.as_slice(), [1.0, 2.0, 3.0]);
        }
        let endless = u32::MAX.to_le_bytes();
        assert!(frame_transforms(&endless, WireFormat::Ros1, true).is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_message_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            for format in [WireFormat::Ros1, WireFormat::Cdr] {
                let _ = raw_image(&bytes, format);
                let _ = compressed_image(&bytes, format);
                let _ = camera_calibration(&bytes, format);
                let _ = frame_transforms(&bytes, format, true);
            }
        }
    }
}
