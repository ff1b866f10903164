//! ROS 2 messages of a frame, in CDR of little endian: a JPEG, depth, and their camera.
//!
//! The texts of the message definitions are what a reader without ROS needs to understand them.

use linkage_frames::camera::PinholeCamera;

const SEPARATOR: &str =
    "================================================================================\n";
const HEADER: &str = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n";
const TIME: &str = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
const REGION: &str = "MSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n";

/// Definition of `sensor_msgs/msg/CompressedImage`.
pub fn compressed_image_definition() -> String {
    definition("std_msgs/Header header\nstring format\nuint8[] data\n", &[HEADER, TIME])
}

/// Definition of `sensor_msgs/msg/Image`.
pub fn image_definition() -> String {
    let fields = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n";
    definition(fields, &[HEADER, TIME])
}

/// Definition of `sensor_msgs/msg/CameraInfo`.
pub fn camera_info_definition() -> String {
    let fields = "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n";
    definition(fields, &[HEADER, TIME, REGION])
}

fn definition(fields: &str, parts: &[&str]) -> String {
    let parts: String = parts.iter().map(|part| format!("{SEPARATOR}{part}")).collect();
    format!("{fields}{parts}")
}

/// A picture as it goes into `sensor_msgs/msg/Image`.
pub struct RawPicture<'p> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What the bytes of a pixel are.
    pub encoding: &'static str,
    /// All rows without padding.
    pub data: &'p [u8],
}

/// When and in which frame of coordinates.
#[derive(Clone, Copy)]
pub struct Stamp<'s> {
    /// Microseconds.
    pub utime: i64,
    /// Name of the frame of coordinates.
    pub frame: &'s str,
}

/// `sensor_msgs/msg/CompressedImage`.
pub fn compressed_image(stamp: Stamp<'_>, format: &str, data: &[u8]) -> Vec<u8> {
    let mut writer = CdrWriter::with_stamp(stamp);
    writer.text(format);
    writer.bytes(data);
    writer.out
}

/// `sensor_msgs/msg/Image`.
pub fn image(stamp: Stamp<'_>, picture: &RawPicture<'_>) -> Vec<u8> {
    let mut writer = CdrWriter::with_stamp(stamp);
    writer.u32(picture.height as u32);
    writer.u32(picture.width as u32);
    writer.text(picture.encoding);
    writer.out.push(0);
    writer.u32((picture.data.len() / picture.height.max(1)) as u32);
    writer.bytes(picture.data);
    writer.out
}

/// `sensor_msgs/msg/CameraInfo`.
pub fn camera_info(stamp: Stamp<'_>, camera: &PinholeCamera) -> Vec<u8> {
    let PinholeCamera { fx, fy, cx, cy, distortion, .. } = *camera;
    let is_rational = distortion[5..].iter().any(|k| *k != 0.0);
    let (model, count) = if is_rational { ("rational_polynomial", 8) } else { ("plumb_bob", 5) };
    let mut writer = CdrWriter::with_stamp(stamp);
    writer.u32(camera.height as u32);
    writer.u32(camera.width as u32);
    writer.text(model);
    writer.u32(count as u32);
    writer.f64s(&distortion[..count]);
    writer.f64s(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    writer.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    writer.f64s(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, and the whole picture as the region of interest.
    for _ in 0..6 {
        writer.u32(0);
    }
    writer.out.push(0);
    writer.out
}

/// Writes fields one after the other.
struct CdrWriter {
    out: Vec<u8>,
}

impl CdrWriter {
    /// Begins a message with its header.
    fn with_stamp(stamp: Stamp<'_>) -> Self {
        let mut writer = Self { out: vec![0, 1, 0, 0] };
        // Seconds of ROS 2 have 32 bits: until the year 2038.
        let seconds = stamp.utime.div_euclid(1_000_000);
        writer.u32((seconds.clamp(i32::MIN.into(), i32::MAX.into()) as i32).cast_unsigned());
        writer.u32(stamp.utime.rem_euclid(1_000_000) as u32 * 1000);
        writer.text(stamp.frame);
        writer
    }

    fn align(&mut self, alignment: usize) {
        // Alignment counts from behind the four bytes that tell the byte order.
        while !(self.out.len() - 4).is_multiple_of(alignment) {
            self.out.push(0);
        }
    }

    fn u32(&mut self, value: u32) {
        self.align(4);
        self.out.extend(value.to_le_bytes());
    }

    fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.align(8);
            self.out.extend(value.to_le_bytes());
        }
    }

    fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.out.extend(text.as_bytes());
        self.out.push(0);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.out.extend(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::messages::{CameraInfo, CompressedImage, Image};
    use crate::bag::wire::WireFormat;

    const STAMP: Stamp<'static> = Stamp { utime: 1_700_000_000_123_456, frame: "optical" };

    #[test]
    fn what_is_written_is_read_back() {
        let bytes = compressed_image(STAMP, "jpeg", &[1, 2, 3]);
        let read = CompressedImage::parse(&bytes, WireFormat::Cdr).unwrap();
        assert_eq!((read.header.utime, read.header.frame), (STAMP.utime, STAMP.frame));
        assert_eq!((read.format, read.data), ("jpeg", &[1, 2, 3][..]));
        let picture = RawPicture { width: 2, height: 1, encoding: "16UC1", data: &[1, 2, 3, 4] };
        let bytes = image(STAMP, &picture);
        let read = Image::parse(&bytes, WireFormat::Cdr).unwrap();
        assert_eq!((read.width, read.height, read.step, read.data), (2, 1, 4, picture.data));
    }

    #[test]
    fn a_camera_comes_back_with_its_distortion() {
        for distortion in [
            [0.1, -0.2, 0.001, 0.002, 0.05, 0.0, 0.0, 0.0],
            [0.1, -0.2, 0.001, 0.002, 0.05, 0.1, 0.02, 0.003],
        ] {
            let camera = PinholeCamera { distortion, ..PinholeCamera::kinect() };
            let info = CameraInfo::parse(&camera_info(STAMP, &camera), WireFormat::Cdr).unwrap();
            let read = crate::bag::camera_info::camera_of(&info, false, 5000.0).unwrap();
            assert_eq!(read, camera);
        }
    }
}
