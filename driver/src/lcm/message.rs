//! Messages that carry a frame: `kinect.frame_msg_t` in all its formats of colour and depth,
//! `openni.frame_msg_t`, and `bot_core.images_t` with colour and millimetres of depth.
//!
//! The columns and rows that a message claims are compared with the camera's before anything
//! is decoded or inflated.

use crate::error::FrameError;
use crate::{jpeg, kinect};
use flate2::Compression;
use flate2::read::{ZlibDecoder, ZlibEncoder};
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::Registration;
use linkage_frames::frame::{ColorImage, DepthImage, RgbdFrame, same_size};
use linkage_lcm::messages::bot_core::{Image, Images};
use linkage_lcm::messages::kinect::{DepthMsg, FrameMsg, ImageMsg};
use linkage_lcm::messages::openni;
use linkage_lcm::{DecodeError, Message, decode};
use std::borrow::Cow;
use std::io::Read;
use std::sync::Arc;

/// Millimetres in a metre, which is how depth travels.
pub const LCM_UNITS_PER_METRE: f64 = 1000.0;
/// Focal lengths of an infrared camera of 640x480 pixels that are accepted, pixels.
const FOCAL_LENGTHS: std::ops::Range<f64> = 200.0..2000.0;
/// Quality of published JPEG, as the original system has it.
const JPEG_QUALITY: u8 = 94;

/// A message that is no frame.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MessageError {
    /// It is of another type.
    #[error(
        "fingerprint {0:016x} belongs to no message that carries frames (kinect.frame_msg_t, openni.frame_msg_t, bot_core.images_t)"
    )]
    Type(u64),
    /// It does not hold what its type says.
    #[error("{0}")]
    Decode(#[from] DecodeError),
    /// Its colour cannot be read.
    #[error("colour: {0}")]
    Color(String),
    /// Its depth cannot be read.
    #[error("depth: {0}")]
    Depth(String),
    /// Its pictures do not fit the camera.
    #[error("{0}")]
    Frame(#[from] FrameError),
}

/// How a frame is packed into a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packing {
    /// Colour as JPEG instead of raw RGB.
    pub jpeg: bool,
    /// Depth deflated.
    pub zlib: bool,
}

impl Packing {
    /// Nothing is lost but what lies below a millimetre.
    pub const LOSSLESS: Self = Self { jpeg: false, zlib: true };
    /// Little to carry: some 150 kB a frame.
    pub const SMALL: Self = Self { jpeg: true, zlib: true };
}

/// Reads a frame out of a packet. Depth that was not registered by its sender is, with the
/// Kinect's usual values.
///
/// # Errors
/// [`MessageError`] says what of the message is wrong; nothing that it claims is used before it is
/// compared with the camera and with what the message holds.
pub fn decode_frame(bytes: &[u8], camera: &Arc<PinholeCamera>) -> Result<RgbdFrame, MessageError> {
    let fingerprint = bytes.first_chunk().map_or(0, |first: &[u8; 8]| u64::from_be_bytes(*first));
    if fingerprint == FrameMsg::fingerprint() {
        from_kinect(&decode(bytes)?, camera)
    } else if fingerprint == openni::FrameMsg::fingerprint() {
        from_openni(&decode(bytes)?, camera)
    } else if fingerprint == Images::fingerprint() {
        from_bot_core(&decode(bytes)?, camera)
    } else {
        Err(MessageError::Type(fingerprint))
    }
}

/// Packs a frame: registered millimetres, colour as asked.
///
/// # Errors
/// [`MessageError::Color`] when the JPEG encoder fails.
pub fn encode_frame(frame: &RgbdFrame, packing: Packing) -> Result<FrameMsg, MessageError> {
    let side = |n: usize| {
        i16::try_from(n).map_err(|_| MessageError::Color(format!("{n} pixels in a row or column")))
    };
    let (width, height) = (side(frame.color.width())?, side(frame.color.height())?);
    let (image_data, format) = if packing.jpeg {
        let bytes = jpeg::encode(&frame.color, JPEG_QUALITY).map_err(MessageError::Color)?;
        (bytes, ImageMsg::VIDEO_RGB_JPEG)
    } else {
        (frame.color.as_rgb().to_vec(), ImageMsg::VIDEO_RGB)
    };
    let raw: Vec<u8> =
        frame.depth.to_raw(LCM_UNITS_PER_METRE).iter().flat_map(|mm| mm.to_le_bytes()).collect();
    let uncompressed_size = raw.len() as i32;
    let (depth_data, compression) = if packing.zlib {
        (deflated(&raw), DepthMsg::COMPRESSION_ZLIB)
    } else {
        (raw, DepthMsg::COMPRESSION_NONE)
    };
    Ok(FrameMsg {
        timestamp: frame.utime,
        image: ImageMsg {
            timestamp: frame.utime,
            width,
            height,
            image_data,
            image_data_format: format,
        },
        depth: DepthMsg {
            timestamp: frame.utime,
            width,
            height,
            depth_data,
            depth_data_format: DepthMsg::DEPTH_REGISTERED,
            compression,
            uncompressed_size,
        },
        ..Default::default()
    })
}

fn from_kinect(message: &FrameMsg, camera: &Arc<PinholeCamera>) -> Result<RgbdFrame, MessageError> {
    let image = &message.image;
    let size = checked_size("colour", image.width.into(), image.height.into(), camera)?;
    let color = kinect_color(&image.image_data, image.image_data_format, size)?;
    let (depth, registered) = kinect_depth(&message.depth, camera)?;
    let depth = if registered { depth } else { kinect::registration().register(&depth, camera) };
    Ok(RgbdFrame::new(message.timestamp, Arc::clone(camera), color, depth)?)
}

/// Colour in one of the formats that `kinect` and `openni` share.
fn kinect_color(
    bytes: &[u8],
    format: i8,
    (width, height): (usize, usize),
) -> Result<ColorImage, MessageError> {
    match format {
        ImageMsg::VIDEO_RGB => raw_color(bytes, width, height),
        ImageMsg::VIDEO_BAYER => {
            let rgb = kinect::demosaic(bytes, width, height).ok_or_else(|| {
                MessageError::Color(format!(
                    "a mosaic of {width}x{height} in {} bytes",
                    bytes.len()
                ))
            })?;
            Ok(ColorImage::new(width, height, rgb)?)
        }
        ImageMsg::VIDEO_RGB_JPEG => jpeg_color(bytes, (width, height)),
        other => Err(MessageError::Color(format!("format {other} holds no colour"))),
    }
}

/// Depth, and whether its sender registered it. What was not registered is the Kinect's.
fn kinect_depth(
    message: &DepthMsg,
    camera: &PinholeCamera,
) -> Result<(DepthImage, bool), MessageError> {
    let wrong = MessageError::Depth;
    let registered = message.depth_data_format == DepthMsg::DEPTH_REGISTERED;
    let seen_by = if registered { camera } else { &kinect::infrared_camera() };
    let (width, height) =
        checked_size("depth", message.width.into(), message.height.into(), seen_by)?;
    let count = width * height;
    let bytes = unpacked(&message.depth_data, message.compression, 2 * count)?;
    let little_endian = || values(&bytes, count, u16::from_le_bytes).map_err(wrong);
    let from_disparities = |disparities: Vec<u16>| {
        DepthImage::from_metres(
            width,
            height,
            disparities.into_iter().map(kinect::metres_of).collect(),
        )
    };
    let depth = match message.depth_data_format {
        DepthMsg::DEPTH_REGISTERED | DepthMsg::DEPTH_MM => {
            DepthImage::from_raw(width, height, &little_endian()?, LCM_UNITS_PER_METRE)?
        }
        DepthMsg::DEPTH_11BIT => from_disparities(little_endian()?)?,
        DepthMsg::DEPTH_11BIT_PACKED => {
            let disparities = kinect::unpack_11bit(&bytes, count)
                .ok_or_else(|| wrong(format!("{} bytes hold no {count} values", bytes.len())))?;
            from_disparities(disparities)?
        }
        other => return Err(wrong(format!("format {other} holds no depth that is known"))),
    };
    Ok((depth, registered))
}

fn from_openni(
    message: &openni::FrameMsg,
    camera: &Arc<PinholeCamera>,
) -> Result<RgbdFrame, MessageError> {
    let image = &message.image;
    let size = checked_size("colour", image.width.into(), image.height.into(), camera)?;
    let color = kinect_color(&image.image_data, image.image_data_format, size)?;
    let depth = openni_depth(&message.depth, camera)?;
    Ok(RgbdFrame::new(message.timestamp, Arc::clone(camera), color, depth)?)
}

/// Depth as the colour camera sees it. Some senders leave `uncompressed_size` unset: the size
/// of the picture tells it too.
fn openni_depth(
    message: &openni::DepthMsg,
    camera: &PinholeCamera,
) -> Result<DepthImage, MessageError> {
    let infrared = match message.viewpoint {
        openni::DepthMsg::VIEWPOINT_RGB => None,
        openni::DepthMsg::VIEWPOINT_IR => Some(infrared_camera(message.focal_length)?),
        other => {
            return Err(MessageError::Depth(format!(
                "viewpoint {other} is neither that of the infrared camera (0) nor of colour (1)"
            )));
        }
    };
    let seen_by = infrared.as_ref().unwrap_or(camera);
    let (width, height) =
        checked_size("depth", message.width.into(), message.height.into(), seen_by)?;
    let bytes = unpacked(&message.depth_data, message.compression, 2 * width * height)?;
    let raw = values(&bytes, width * height, u16::from_le_bytes).map_err(MessageError::Depth)?;
    let depth = DepthImage::from_raw(width, height, &raw, LCM_UNITS_PER_METRE)?;
    Ok(match infrared {
        None => depth,
        Some(depth_camera) => {
            Registration { depth_camera, ..kinect::registration() }.register(&depth, camera)
        }
    })
}

/// The Kinect's infrared camera, of a focal length in pixels; the usual one where it is 0.
fn infrared_camera(focal_length: f64) -> Result<PinholeCamera, MessageError> {
    let usual = kinect::infrared_camera();
    if focal_length == 0.0 {
        return Ok(usual);
    }
    if !FOCAL_LENGTHS.contains(&focal_length) {
        return Err(MessageError::Depth(format!("a focal length of {focal_length} pixels")));
    }
    Ok(PinholeCamera { fx: focal_length, fy: focal_length, ..usual })
}

fn from_bot_core(message: &Images, camera: &Arc<PinholeCamera>) -> Result<RgbdFrame, MessageError> {
    let of_type = |wanted: &[i16]| {
        message
            .image_types
            .iter()
            .zip(&message.images)
            .find(|(kind, _)| wanted.contains(*kind))
            .map(|(kind, image)| (*kind, image))
    };
    let (_, color) = of_type(&[Images::LEFT])
        .ok_or_else(|| MessageError::Color("no picture of type LEFT".to_owned()))?;
    let (kind, depth) = of_type(&[Images::DEPTH_MM, Images::DEPTH_MM_ZIPPED])
        .ok_or_else(|| MessageError::Depth("no picture of type DEPTH_MM".to_owned()))?;
    let color = bot_core_color(color, camera)?;
    let depth = bot_core_depth(depth, kind == Images::DEPTH_MM_ZIPPED, camera)?;
    Ok(RgbdFrame::new(message.utime, Arc::clone(camera), color, depth)?)
}

fn bot_core_color(image: &Image, camera: &PinholeCamera) -> Result<ColorImage, MessageError> {
    let size = checked_size("colour", image.width, image.height, camera)?;
    match image.pixelformat {
        Image::PIXEL_FORMAT_RGB => raw_color(&image.data, size.0, size.1),
        Image::PIXEL_FORMAT_MJPEG => jpeg_color(&image.data, size),
        other => Err(MessageError::Color(format!("pixel format {other} is not known"))),
    }
}

fn bot_core_depth(
    image: &Image,
    zipped: bool,
    camera: &PinholeCamera,
) -> Result<DepthImage, MessageError> {
    let wrong = MessageError::Depth;
    let (width, height) = checked_size("depth", image.width, image.height, camera)?;
    let count = width * height;
    let bytes =
        if zipped { &inflated(&image.data, 2 * count).map_err(wrong)? } else { &image.data };
    let order = match image.pixelformat {
        Image::PIXEL_FORMAT_BE_GRAY16 => u16::from_be_bytes,
        _ => u16::from_le_bytes,
    };
    let raw = values(bytes, count, order).map_err(wrong)?;
    Ok(DepthImage::from_raw(width, height, &raw, LCM_UNITS_PER_METRE)?)
}

/// Columns and rows that a message claims, if they are the camera's.
fn checked_size(
    what: &'static str,
    width: i32,
    height: i32,
    camera: &PinholeCamera,
) -> Result<(usize, usize), MessageError> {
    let (Ok(w), Ok(h)) = (usize::try_from(width), usize::try_from(height)) else {
        let reason = format!("a picture of {width}x{height} cannot be");
        let is_color = what == "colour";
        return Err(if is_color { MessageError::Color } else { MessageError::Depth }(reason));
    };
    same_size(what, (w, h), (camera.width, camera.height))?;
    Ok((w, h))
}

fn jpeg_color(bytes: &[u8], size: (usize, usize)) -> Result<ColorImage, MessageError> {
    jpeg::decode(bytes, size).map_err(|e| MessageError::Color(e.to_string()))
}

/// The bytes of a picture, at most this many.
fn unpacked(bytes: &[u8], compression: i8, limit: usize) -> Result<Cow<'_, [u8]>, MessageError> {
    match compression {
        DepthMsg::COMPRESSION_NONE => Ok(Cow::Borrowed(bytes)),
        DepthMsg::COMPRESSION_ZLIB => {
            inflated(bytes, limit).map(Cow::Owned).map_err(MessageError::Depth)
        }
        other => Err(MessageError::Depth(format!("compression {other} is not known"))),
    }
}

fn raw_color(rgb: &[u8], width: usize, height: usize) -> Result<ColorImage, MessageError> {
    Ok(ColorImage::new(width, height, rgb.to_vec())?)
}

fn values(bytes: &[u8], count: usize, order: fn([u8; 2]) -> u16) -> Result<Vec<u16>, String> {
    if bytes.len() != 2 * count {
        return Err(format!("{} bytes given, {} needed", bytes.len(), 2 * count));
    }
    Ok(bytes.chunks_exact(2).map(|b| order([b[0], b[1]])).collect())
}

/// Inflates to at most `limit` bytes, whatever the stream would grow to.
fn inflated(bytes: &[u8], limit: usize) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    ZlibDecoder::new(bytes)
        .take(limit as u64 + 1)
        .read_to_end(&mut out)
        .map_err(|e| format!("damaged zlib stream: {e}"))?;
    if out.len() > limit {
        return Err(format!("the zlib stream holds more than {limit} bytes"));
    }
    Ok(out)
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    ZlibEncoder::new(bytes, Compression::fast())
        .read_to_end(&mut out)
        .expect("deflating from memory into memory");
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_lcm::encode;
    use proptest::prelude::*;

    fn camera() -> Arc<PinholeCamera> {
        Arc::new(PinholeCamera {
            width: 8,
            height: 6,
            fx: 8.0,
            fy: 8.0,
            cx: 3.5,
            cy: 2.5,
            ..PinholeCamera::kinect()
        })
    }

    fn frame() -> RgbdFrame {
        let color = ColorImage::new(8, 6, (0..8 * 6 * 3).collect()).unwrap();
        let metres = (0..48).map(|i| if i % 7 == 0 { 0.0 } else { 0.5 + 0.05 * i as f32 });
        let depth = DepthImage::from_metres(8, 6, metres.collect()).unwrap();
        RgbdFrame::new(1_234_567, camera(), color, depth).unwrap()
    }

    #[test]
    fn a_frame_comes_back_from_its_message() {
        for packing in [Packing::LOSSLESS, Packing { jpeg: false, zlib: false }] {
            let bytes = encode(&encode_frame(&frame(), packing).unwrap()).unwrap();
            let back = decode_frame(&bytes, &camera()).unwrap();
            assert_eq!(back.utime, 1_234_567);
            assert_eq!(back.color, frame().color);
            assert_eq!(back.depth.to_raw(1000.0), frame().depth.to_raw(1000.0));
        }
    }

    #[test]
    fn jpeg_is_near_the_colour_that_was_sent() {
        let grey = ColorImage::new(8, 6, vec![90; 8 * 6 * 3]).unwrap();
        let sent = RgbdFrame { color: grey, ..frame() };
        let bytes = encode(&encode_frame(&sent, Packing::SMALL).unwrap()).unwrap();
        let back = decode_frame(&bytes, &camera()).unwrap();
        assert!(back.color.as_rgb().iter().all(|c| c.abs_diff(90) < 3));
    }

    #[test]
    fn disparities_of_the_original_system_are_registered() {
        let wide = Arc::new(PinholeCamera::kinect());
        let disparities: Vec<u8> =
            std::iter::repeat_n(800_u16.to_le_bytes(), 640 * 480).flatten().collect();
        let mut message = FrameMsg::default();
        (message.image.width, message.image.height) = (640, 480);
        message.image.image_data = vec![50; 640 * 480];
        message.image.image_data_format = ImageMsg::VIDEO_BAYER;
        (message.depth.width, message.depth.height) = (640, 480);
        message.depth.depth_data = disparities;
        message.depth.depth_data_format = DepthMsg::DEPTH_11BIT;
        let frame = decode_frame(&encode(&message).unwrap(), &wide).unwrap();
        assert!(frame.depth.at(320, 240).is_some_and(|z| (z - 1.19).abs() < 0.02));
    }

    #[test]
    fn what_is_wrong_with_a_message_is_said() {
        let whole = encode_frame(&frame(), Packing::LOSSLESS).unwrap();
        let error = |change: fn(&mut FrameMsg)| {
            let mut message = whole.clone();
            change(&mut message);
            decode_frame(&encode(&message).unwrap(), &camera()).unwrap_err().to_string()
        };
        assert!(error(|m| m.depth.depth_data[5] ^= 0x55).contains("zlib"));
        assert!(error(|m| m.depth.width = -3).contains("-3x6"));
        assert!(error(|m| m.image.width = 32000).contains("colour is 32000x6"));
        assert!(error(|m| m.depth.height = 7).contains("depth is 8x7"));
        assert!(error(|m| m.image.image_data_format = 100).contains("JPEG"));
        assert!(error(|m| m.image.image_data_format = 2).contains("format 2"));
        assert!(decode_frame(&[1; 20], &camera()).unwrap_err().to_string().contains("fingerprint"));
    }

    #[test]
    fn a_stream_that_inflates_without_end_is_cut_off() {
        let mut message = encode_frame(&frame(), Packing::LOSSLESS).unwrap();
        message.depth.depth_data = deflated(&vec![0; 50_000_000]);
        let error = decode_frame(&encode(&message).unwrap(), &camera()).unwrap_err();
        assert!(error.to_string().contains("more than 96 bytes"), "{error}");
    }

    /// The frame as an OpenNI driver sends it.
    fn of_openni(viewpoint: i8, focal_length: f64, zlib: bool) -> openni::FrameMsg {
        let sent = encode_frame(&frame(), Packing { jpeg: false, zlib }).unwrap();
        openni::FrameMsg {
            timestamp: sent.timestamp,
            image: openni::ImageMsg {
                width: sent.image.width,
                height: sent.image.height,
                image_data: sent.image.image_data,
                image_data_format: openni::ImageMsg::VIDEO_RGB,
                ..Default::default()
            },
            depth: openni::DepthMsg {
                width: sent.depth.width,
                height: sent.depth.height,
                depth_data: sent.depth.depth_data,
                compression: sent.depth.compression,
                viewpoint,
                focal_length,
                ..Default::default()
            },
            ..Default::default()
        }
    }

    #[test]
    fn a_frame_of_an_openni_driver_is_read() {
        for zlib in [false, true] {
            let message = of_openni(openni::DepthMsg::VIEWPOINT_RGB, 0.0, zlib);
            let back = decode_frame(&encode(&message).unwrap(), &camera()).unwrap();
            assert_eq!((back.utime, &back.color), (1_234_567, &frame().color));
            assert_eq!(back.depth.to_raw(1000.0), frame().depth.to_raw(1000.0));
        }
    }

    #[test]
    fn depth_of_the_infrared_camera_is_registered_by_its_focal_length() {
        let wide = Arc::new(PinholeCamera::kinect());
        let place = |focal_length: f64| {
            let mut mm = vec![0_u16; 640 * 480];
            for v in 200..280 {
                mm[v * 640 + 500] = 1000;
            }
            let mut message = of_openni(openni::DepthMsg::VIEWPOINT_IR, focal_length, false);
            (message.image.width, message.image.height) = (640, 480);
            message.image.image_data = vec![90; 640 * 480 * 3];
            (message.depth.width, message.depth.height) = (640, 480);
            message.depth.depth_data = mm.iter().flat_map(|mm| mm.to_le_bytes()).collect();
            let frame = decode_frame(&encode(&message).unwrap(), &wide).unwrap();
            (0..640).find(|&u| frame.depth.at(u, 240).is_some()).unwrap() as f64
        };
        for (sent, used) in [(600.0, 600.0), (0.0, 575.8)] {
            let expected = 525.0 * ((500.0 - 319.5) / used - 0.023) + 319.5;
            assert!((place(sent) - expected).abs() <= 1.0, "{} {expected}", place(sent));
        }
    }

    #[test]
    fn what_is_wrong_with_a_message_of_an_openni_driver_is_said() {
        let error = |message: &openni::FrameMsg| {
            decode_frame(&encode(message).unwrap(), &camera()).unwrap_err().to_string()
        };
        // Some senders leave these unset: 32616, -111, ... were seen.
        assert!(error(&of_openni(-111, 0.0, true)).contains("viewpoint -111"));
        assert!(error(&of_openni(0, f64::NAN, true)).contains("focal length of NaN"));
        assert!(error(&of_openni(0, 575.8, true)).contains("depth is 8x6"));
        let whole = of_openni(1, 0.0, false);
        let mut message = whole.clone();
        message.depth.depth_data.pop();
        assert!(error(&message).contains("95 bytes given, 96 needed"));
        let mut message = whole.clone();
        message.image.image_data_format = openni::ImageMsg::VIDEO_NONE;
        assert!(error(&message).contains("format 101 holds no colour"));
        let mut message = whole;
        message.depth.compression = 3;
        assert!(error(&message).contains("compression 3"));
    }

    #[test]
    fn pictures_of_another_size_are_refused_before_they_are_unpacked() {
        // A picture of 32767x32767 would take 2 GB when inflated, and a second.
        let bomb = deflated(&vec![0; 4_000_000]);
        let mut kinect = encode_frame(&frame(), Packing::LOSSLESS).unwrap();
        (kinect.depth.width, kinect.depth.height) = (i16::MAX, i16::MAX);
        kinect.depth.depth_data = bomb.clone();
        let mut openni = of_openni(1, 0.0, true);
        (openni.depth.width, openni.depth.height) = (i16::MAX, i16::MAX);
        openni.depth.depth_data = bomb;
        for bytes in [encode(&kinect).unwrap(), encode(&openni).unwrap()] {
            let error = decode_frame(&bytes, &camera()).unwrap_err().to_string();
            assert!(error.contains("depth is 32767x32767"), "{error}");
        }
    }

    proptest! {
        #[test]
        fn no_packet_makes_the_decoder_panic(
            mut bytes in proptest::collection::vec(any::<u8>(), 0..300),
            kind in 0..3,
        ) {
            let first = [
                FrameMsg::fingerprint(),
                Images::fingerprint(),
                openni::FrameMsg::fingerprint(),
            ][kind as usize];
            if bytes.len() >= 8 {
                bytes[..8].copy_from_slice(&first.to_be_bytes());
            }
            let _ = decode_frame(&bytes, &camera());
        }
    }
}
