//! Foxglove's own messages of pictures, cameras and transforms, in protobuf, as the messages of ROS
//! that say the same.
//!
//! Numbers of fields are those of Foxglove's published schemas: `foxglove.RawImage`,
//! `CompressedImage`, `CameraCalibration`, `FrameTransform` and `FrameTransforms`. A field that is
//! left out is 0 or empty, as protobuf has it; pixels of several bytes begin with the least.

use super::messages::{CameraInfo, CompressedImage, Header, Image, MAX_DISTORTION};
use super::protobuf::{Fields, Value};
use super::transforms::{MAX_TRANSFORMS, Transform, pose_of};
use super::wire::WireError;

/// `foxglove.RawImage`.
///
/// # Errors
/// [`WireError`], as for all that follow.
pub fn raw_image(message: &[u8]) -> Result<Image<'_>, WireError> {
    let header = Header { utime: 0, frame: "" };
    let (width, height, encoding, step, data) = (0, 0, "", 0, &[][..]);
    let mut image = Image { header, width, height, encoding, is_big_endian: false, step, data };
    for field in Fields::new(message) {
        match field? {
            (1, value) => image.header.utime = utime(value)?,
            (2, value) => image.width = value.fixed32("width")? as usize,
            (3, value) => image.height = value.fixed32("height")? as usize,
            (4, value) => image.encoding = value.text("encoding")?,
            (5, value) => image.step = value.fixed32("step")? as usize,
            (6, value) => image.data = value.bytes("data")?,
            (7, value) => image.header.frame = value.text("frame_id")?,
            _ => {}
        }
    }
    Ok(image)
}

/// `foxglove.CompressedImage`.
///
/// # Errors
/// [`WireError`].
pub fn compressed_image(message: &[u8]) -> Result<CompressedImage<'_>, WireError> {
    let header = Header { utime: 0, frame: "" };
    let mut image = CompressedImage { header, format: "", data: &[] };
    for field in Fields::new(message) {
        match field? {
            (1, value) => image.header.utime = utime(value)?,
            (2, value) => image.data = value.bytes("data")?,
            (3, value) => image.format = value.text("format")?,
            (4, value) => image.header.frame = value.text("frame_id")?,
            _ => {}
        }
    }
    Ok(image)
}

/// `foxglove.CameraCalibration`.
///
/// # Errors
/// [`WireError`].
pub fn camera_calibration(message: &[u8]) -> Result<CameraInfo, WireError> {
    let (mut d, mut k, mut p) = (Vec::new(), Vec::new(), Vec::new());
    let (mut width, mut height, mut frame, mut distortion_model) = (0, 0, "", "");
    for field in Fields::new(message) {
        match field? {
            (2, value) => width = value.fixed32("width")? as usize,
            (3, value) => height = value.fixed32("height")? as usize,
            (4, value) => distortion_model = value.text("distortion_model")?,
            (5, value) => value.doubles("D", &mut d, MAX_DISTORTION)?,
            (6, value) => value.doubles("K", &mut k, 9)?,
            (8, value) => value.doubles("P", &mut p, 12)?,
            (9, value) => frame = value.text("frame_id")?,
            _ => {}
        }
    }
    Ok(CameraInfo {
        frame: frame.to_owned(),
        width,
        height,
        distortion_model: distortion_model.to_owned(),
        d,
        k: matrix("K", &k)?,
        p: matrix("P", &p)?,
        binning: [0, 0],
    })
}

/// `foxglove.FrameTransforms`.
///
/// # Errors
/// [`WireError`], for more than [`MAX_TRANSFORMS`] too.
pub fn frame_transforms(message: &[u8]) -> Result<Vec<Transform>, WireError> {
    let mut transforms = Vec::new();
    for field in Fields::new(message) {
        if let (1, value) = field? {
            // One takes fifty times the memory of an empty message.
            if transforms.len() == MAX_TRANSFORMS {
                let value = format!("more than {MAX_TRANSFORMS}");
                return Err(WireError::Value { field: "transforms", value });
            }
            transforms.push(frame_transform(value.bytes("transform")?)?);
        }
    }
    Ok(transforms)
}

/// `foxglove.FrameTransform`.
///
/// # Errors
/// [`WireError`].
pub fn frame_transform(message: &[u8]) -> Result<Transform, WireError> {
    let (mut parent, mut child) = ("", "");
    let (mut translation, mut rotation) = ([0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    for field in Fields::new(message) {
        match field? {
            (2, value) => parent = value.text("parent_frame_id")?,
            (3, value) => child = value.text("child_frame_id")?,
            (4, value) => translation = coordinates("translation", value)?,
            (5, value) => rotation = coordinates("rotation", value)?,
            _ => {}
        }
    }
    let parent_from_child = pose_of(translation, rotation)?;
    Ok(Transform { parent: parent.to_owned(), child: child.to_owned(), parent_from_child })
}

/// Microseconds of a `google.protobuf.Timestamp`.
fn utime(value: Value<'_>) -> Result<i64, WireError> {
    let field = "timestamp";
    let (mut seconds, mut nanoseconds) = (0_i64, 0_u64);
    for part in Fields::new(value.bytes(field)?) {
        match part? {
            (1, value) => seconds = value.varint(field)?.cast_signed(),
            (2, value) => nanoseconds = value.varint(field)?,
            _ => {}
        }
    }
    let microseconds = i64::try_from(nanoseconds / 1000).ok().filter(|us| *us < 1_000_000);
    let wrong = || WireError::Value { field, value: format!("{seconds} s and {nanoseconds} ns") };
    let utime = seconds.checked_mul(1_000_000).zip(microseconds);
    utime.and_then(|(whole, part)| whole.checked_add(part)).ok_or_else(wrong)
}

/// A message of `N` numbers of double precision: `foxglove.Vector3`, `foxglove.Quaternion`.
fn coordinates<const N: usize>(
    field: &'static str,
    value: Value<'_>,
) -> Result<[f64; N], WireError> {
    let mut numbers = [0.0; N];
    for part in Fields::new(value.bytes(field)?) {
        let (number, value) = part?;
        let place = usize::try_from(number).ok().and_then(|n| n.checked_sub(1));
        if let Some(to) = place.and_then(|place| numbers.get_mut(place)) {
            *to = value.double(field)?;
        }
    }
    Ok(numbers)
}

/// All numbers of a matrix; zeros where it was left out.
fn matrix<const N: usize>(field: &'static str, numbers: &[f64]) -> Result<[f64; N], WireError> {
    if numbers.is_empty() {
        return Ok([0.0; N]);
    }
    let value = || format!("{} numbers instead of {N}", numbers.len());
    numbers.try_into().map_err(|_| WireError::Value { field, value: value() })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::bag::protobuf_writer::{bytes, double, doubles, fixed32, varint};
    use proptest::prelude::*;

    /// The field `timestamp`, which all of Foxglove's messages begin with.
    pub(crate) fn timestamp(utime: i64) -> Vec<u8> {
        let (seconds, us) = (utime.div_euclid(1_000_000), utime.rem_euclid(1_000_000));
        bytes(1, &[varint(1, seconds.cast_unsigned()), varint(2, us as u64 * 1000)].concat())
    }

    /// A `foxglove.RawImage` of two rows.
    fn raw() -> Vec<u8> {
        let (width, height, step) = (fixed32(2, 1), fixed32(3, 2), fixed32(5, 2));
        let (encoding, data) = (bytes(4, b"16UC1"), bytes(6, &[1, 2, 3, 4]));
        let stamp = timestamp(12_345_678);
        [stamp, width, height, encoding, step, data, bytes(7, b"optical")].concat()
    }

    #[test]
    fn a_raw_image_is_read_field_by_field() {
        let message = raw();
        let image = raw_image(&message).unwrap();
        assert_eq!(image.header, Header { utime: 12_345_678, frame: "optical" });
        assert_eq!((image.width, image.height, image.encoding), (1, 2, "16UC1"));
        assert_eq!((image.is_big_endian, image.step), (false, 2));
        assert_eq!(image.data, [1, 2, 3, 4]);
    }

    #[test]
    fn what_is_left_out_is_empty_and_what_is_not_known_is_passed_over() {
        let later = [bytes(15, b"of a later schema"), bytes(2, b"\xff\xd8")].concat();
        let image = compressed_image(&later).unwrap();
        assert_eq!(image.header, Header { utime: 0, frame: "" });
        assert_eq!((image.format, image.data), ("", &b"\xff\xd8"[..]));
        assert_eq!(camera_calibration(&[]).unwrap().k, [0.0; 9]);
    }

    #[test]
    fn a_stamp_before_1970_is_read_and_one_that_is_none_is_refused() {
        let read = |stamp: &[u8]| compressed_image(stamp).map(|image| image.header.utime);
        assert_eq!(read(&timestamp(-1)), Ok(-1));
        let ns = bytes(1, &varint(2, 4_000_000_000));
        assert!(read(&ns).unwrap_err().to_string().contains("4000000000 ns"));
        assert!(read(&bytes(1, &varint(1, i64::MAX as u64))).is_err());
    }

    #[test]
    fn a_matrix_needs_all_its_numbers() {
        let k = [600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0];
        let message = [fixed32(2, 640), bytes(4, b"plumb_bob"), doubles(6, &k)].concat();
        let info = camera_calibration(&message).unwrap();
        assert_eq!((info.width, info.k, &*info.distortion_model), (640, k, "plumb_bob"));
        let error = camera_calibration(&doubles(6, &k[..4])).unwrap_err().to_string();
        assert!(error.contains("K is 4 numbers instead of 9"), "{error}");
    }

    #[test]
    fn a_transform_maps_the_child_into_its_parent() {
        let half = 0.5_f64.sqrt();
        let translation = bytes(4, &double(1, 1.0));
        let rotation = bytes(5, &[double(3, half), double(4, half)].concat());
        let one = [bytes(2, b"base"), bytes(3, b"color"), translation, rotation].concat();
        let read = frame_transforms(&[bytes(1, &one), bytes(1, &one)].concat()).unwrap();
        assert_eq!((read.len(), &*read[0].parent, &*read[0].child), (2, "base", "color"));
        let x = read[0].parent_from_child * nalgebra::Point3::new(1.0, 0.0, 0.0);
        assert!((x - nalgebra::Point3::new(1.0, 1.0, 0.0)).norm() < 1e-12, "{x}");
        let endless = frame_transforms(&bytes(1, &[]).repeat(MAX_TRANSFORMS + 1)).unwrap_err();
        assert!(endless.to_string().contains("more than 10000"), "{endless}");
    }

    #[test]
    fn a_message_that_is_cut_never_lies_outside_itself() {
        let message = raw();
        for length in 0..message.len() {
            if let Ok(image) = raw_image(&message[..length]) {
                assert!(image.data.len() <= length);
            }
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_message_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = raw_image(&bytes);
            let _ = compressed_image(&bytes);
            let _ = camera_calibration(&bytes);
            let _ = frame_transforms(&bytes);
        }
    }
}
