//! The messages that pictures and cameras travel in: `sensor_msgs` of ROS 1 and ROS 2, whose fields
//! are the same except for the header's `seq`.

use super::wire::{WireError, WireFormat, WireReader};

/// Most numbers of distortion: OpenCV's largest model has 14.
pub const MAX_DISTORTION: usize = 32;

/// When and in which frame of coordinates something was seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header<'b> {
    /// Microseconds; 0 where none was given.
    pub utime: i64,
    /// Name of the frame of coordinates.
    pub frame: &'b str,
}

/// `sensor_msgs/Image`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Image<'b> {
    /// When and where.
    pub header: Header<'b>,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What the bytes of a pixel are: `rgb8`, `16UC1`, …
    pub encoding: &'b str,
    /// Numbers of several bytes begin with the greatest.
    pub is_big_endian: bool,
    /// Bytes of a row.
    pub step: usize,
    /// All rows.
    pub data: &'b [u8],
}

/// `sensor_msgs/CompressedImage`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CompressedImage<'b> {
    /// When and where.
    pub header: Header<'b>,
    /// `jpeg`, `png`, `16UC1; compressedDepth`, …
    pub format: &'b str,
    /// The compressed picture.
    pub data: &'b [u8],
}

/// `sensor_msgs/CameraInfo`.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraInfo {
    /// Name of the frame of coordinates.
    pub frame: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Name of the model of distortion.
    pub distortion_model: String,
    /// Its coefficients.
    pub d: Vec<f64>,
    /// Intrinsics of the picture as it was taken, row by row.
    pub k: [f64; 9],
    /// Intrinsics of the rectified picture, row by row.
    pub p: [f64; 12],
    /// Pixels of the sensor in a pixel of the picture, along x and y; 0 counts as 1.
    pub binning: [u32; 2],
}

/// `std_msgs/Header`.
///
/// # Errors
/// [`WireError`].
pub fn header<'b>(
    reader: &mut WireReader<'b>,
    format: WireFormat,
) -> Result<Header<'b>, WireError> {
    if format == WireFormat::Ros1 {
        reader.u32("header's seq")?;
    }
    Ok(Header { utime: stamp(reader, format)?, frame: reader.text("frame_id")? })
}

/// A time stamp, microseconds.
///
/// # Errors
/// [`WireError`].
pub fn stamp(reader: &mut WireReader<'_>, format: WireFormat) -> Result<i64, WireError> {
    let seconds = match format {
        WireFormat::Ros1 => i64::from(reader.u32("time stamp")?),
        WireFormat::Cdr => i64::from(reader.i32("time stamp")?),
    };
    let nanoseconds = reader.u32("time stamp")?;
    if nanoseconds >= 1_000_000_000 {
        let value = format!("{nanoseconds} ns after a second");
        return Err(WireError::Value { field: "time stamp", value });
    }
    Ok(seconds * 1_000_000 + i64::from(nanoseconds / 1000))
}

impl<'b> Image<'b> {
    /// Reads a message.
    ///
    /// # Errors
    /// [`WireError`].
    pub fn parse(bytes: &'b [u8], format: WireFormat) -> Result<Self, WireError> {
        let mut reader = WireReader::new(bytes, format)?;
        let header = header(&mut reader, format)?;
        let (height, width) = (reader.u32("height")? as usize, reader.u32("width")? as usize);
        Ok(Self {
            header,
            width,
            height,
            encoding: reader.text("encoding")?,
            is_big_endian: reader.u8("is_bigendian")? != 0,
            step: reader.u32("step")? as usize,
            data: reader.bytes("data")?,
        })
    }
}

impl<'b> CompressedImage<'b> {
    /// Reads a message.
    ///
    /// # Errors
    /// [`WireError`].
    pub fn parse(bytes: &'b [u8], format: WireFormat) -> Result<Self, WireError> {
        let mut reader = WireReader::new(bytes, format)?;
        let header = header(&mut reader, format)?;
        Ok(Self { header, format: reader.text("format")?, data: reader.bytes("data")? })
    }
}

impl CameraInfo {
    /// Reads a message.
    ///
    /// # Errors
    /// [`WireError`].
    pub fn parse(bytes: &[u8], format: WireFormat) -> Result<Self, WireError> {
        let mut reader = WireReader::new(bytes, format)?;
        let header = header(&mut reader, format)?;
        let (height, width) = (reader.u32("height")? as usize, reader.u32("width")? as usize);
        let distortion_model = reader.text("distortion_model")?.to_owned();
        let d = reader.f64_sequence("D", MAX_DISTORTION)?;
        let k = reader.f64s::<9>("K")?;
        reader.f64s::<9>("R")?;
        let p = reader.f64s::<12>("P")?;
        let binning = [reader.u32("binning_x")?, reader.u32("binning_y")?];
        let frame = header.frame.to_owned();
        Ok(Self { frame, width, height, distortion_model, d, k, p, binning })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Writes fields as ROS 1 does.
    pub(crate) fn ros1(fields: &[&[u8]]) -> Vec<u8> {
        fields.concat()
    }

    pub(crate) fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
    }

    fn image() -> Vec<u8> {
        ros1(&[
            &1_u32.to_le_bytes(),
            &12_u32.to_le_bytes(),
            &345_678_900_u32.to_le_bytes(),
            &text("optical"),
            &1_u32.to_le_bytes(),
            &2_u32.to_le_bytes(),
            &text("16UC1"),
            &[0],
            &4_u32.to_le_bytes(),
            &4_u32.to_le_bytes(),
            &[1, 2, 3, 4],
        ])
    }

    #[test]
    fn an_image_of_ros_1_is_read_field_by_field() {
        let bytes = image();
        let image = Image::parse(&bytes, WireFormat::Ros1).unwrap();
        assert_eq!(image.header, Header { utime: 12_345_678, frame: "optical" });
        assert_eq!((image.width, image.height, image.encoding), (2, 1, "16UC1"));
        assert_eq!((image.is_big_endian, image.step), (false, 4));
        assert_eq!(image.data, [1, 2, 3, 4]);
    }

    #[test]
    fn the_same_image_in_big_endian_cdr_is_the_same() {
        let mut bytes = vec![0, 0, 0, 0];
        bytes.extend(12_i32.to_be_bytes());
        bytes.extend(345_678_900_u32.to_be_bytes());
        bytes.extend(8_u32.to_be_bytes());
        bytes.extend(b"optical\0");
        bytes.extend(1_u32.to_be_bytes());
        bytes.extend(2_u32.to_be_bytes());
        bytes.extend(6_u32.to_be_bytes());
        bytes.extend(b"16UC1\0\0");
        // is_bigendian stands right behind the text; the step is aligned to 4 bytes.
        bytes.extend([0]);
        bytes.extend(4_u32.to_be_bytes());
        bytes.extend(4_u32.to_be_bytes());
        bytes.extend([1, 2, 3, 4]);
        let ros1 = image();
        let expected = Image::parse(&ros1, WireFormat::Ros1).unwrap();
        assert_eq!(Image::parse(&bytes, WireFormat::Cdr).unwrap(), expected);
    }

    #[test]
    fn an_image_that_is_cut_anywhere_is_an_error() {
        let bytes = image();
        for length in 0..bytes.len() {
            assert!(Image::parse(&bytes[..length], WireFormat::Ros1).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn a_stamp_with_too_many_nanoseconds_is_refused() {
        let mut bytes = image();
        bytes[8..12].copy_from_slice(&4_000_000_000_u32.to_le_bytes());
        let error = Image::parse(&bytes, WireFormat::Ros1).unwrap_err().to_string();
        assert!(error.contains("time stamp is 4000000000 ns"), "{error}");
    }
}
