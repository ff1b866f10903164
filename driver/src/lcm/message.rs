//! Messages that carry a frame: `kinect.frame_msg_t` in all its formats of colour and depth,
//! and `bot_core.images_t` with colour and millimetres of depth.

use crate::camera::PinholeCamera;
use crate::frame::{ColorImage, DepthImage, FrameError, RgbdFrame};
use crate::jpeg;
use crate::kinect;
use flate2::Compression;
use flate2::read::{ZlibDecoder, ZlibEncoder};
use linkage_lcm::messages::bot_core::{Image, Images};
use linkage_lcm::messages::kinect::{DepthMsg, FrameMsg, ImageMsg};
use linkage_lcm::{DecodeError, Message, decode};
use std::io::Read;
use std::sync::Arc;

/// Millimetres in a metre, which is how depth travels.
const MM_PER_METRE: f64 = 1000.0;
/// Most pixels of a picture that is believed: an 8K frame.
const MAX_PIXELS: usize = 7680 * 4320;
/// Quality of published JPEG, as the original system has it.
const JPEG_QUALITY: u8 = 94;

/// A message that is no frame.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// It is of another type.
    #[error(
        "fingerprint {0:016x} belongs to no message that carries frames (kinect.frame_msg_t, bot_core.images_t)"
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
/// [`MessageError`] says what of the message is wrong; nothing it claims is believed before
/// it is compared with what it holds.
pub fn decode_frame(bytes: &[u8], camera: &Arc<PinholeCamera>) -> Result<RgbdFrame, MessageError> {
    let fingerprint = bytes.first_chunk().map_or(0, |first: &[u8; 8]| u64::from_be_bytes(*first));
    if fingerprint == FrameMsg::fingerprint() {
        from_kinect(decode(bytes)?, camera)
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
    let (width, height) = (frame.color.width() as i16, frame.color.height() as i16);
    let (image_data, format) = if packing.jpeg {
        let bytes = jpeg::encode(&frame.color, JPEG_QUALITY).map_err(MessageError::Color)?;
        (bytes, ImageMsg::VIDEO_RGB_JPEG)
    } else {
        (frame.color.as_rgb().to_vec(), ImageMsg::VIDEO_RGB)
    };
    let raw: Vec<u8> =
        frame.depth.to_raw(MM_PER_METRE).iter().flat_map(|mm| mm.to_le_bytes()).collect();
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

fn from_kinect(message: FrameMsg, camera: &Arc<PinholeCamera>) -> Result<RgbdFrame, MessageError> {
    let color = kinect_color(&message.image)?;
    let (depth, registered) = kinect_depth(&message.depth)?;
    let depth = if registered { depth } else { kinect::registration().register(&depth, camera) };
    Ok(RgbdFrame::new(message.timestamp, Arc::clone(camera), color, depth)?)
}

fn kinect_color(image: &ImageMsg) -> Result<ColorImage, MessageError> {
    let (width, height) =
        size(image.width.into(), image.height.into()).map_err(MessageError::Color)?;
    match image.image_data_format {
        ImageMsg::VIDEO_RGB => raw_color(&image.image_data, width, height),
        ImageMsg::VIDEO_BAYER => {
            let rgb = kinect::demosaic(&image.image_data, width, height).ok_or_else(|| {
                MessageError::Color(format!(
                    "a mosaic of {width}x{height} in {} bytes",
                    image.image_data.len()
                ))
            })?;
            Ok(ColorImage::new(width, height, rgb)?)
        }
        ImageMsg::VIDEO_RGB_JPEG => jpeg::decode(&image.image_data).map_err(MessageError::Color),
        other => Err(MessageError::Color(format!("format {other} holds no colour"))),
    }
}

/// Depth, and whether its sender registered it.
fn kinect_depth(message: &DepthMsg) -> Result<(DepthImage, bool), MessageError> {
    let wrong = MessageError::Depth;
    let (width, height) = size(message.width.into(), message.height.into()).map_err(wrong)?;
    let count = width * height;
    let bytes = match message.compression {
        DepthMsg::COMPRESSION_NONE => message.depth_data.clone(),
        DepthMsg::COMPRESSION_ZLIB => inflated(&message.depth_data, 2 * count).map_err(wrong)?,
        other => return Err(wrong(format!("compression {other} is not known"))),
    };
    let little_endian = || values(&bytes, count, u16::from_le_bytes).map_err(wrong);
    let from_disparities = |disparities: Vec<u16>| {
        DepthImage::from_metres(
            width,
            height,
            disparities.into_iter().map(kinect::metres_of).collect(),
        )
    };
    match message.depth_data_format {
        DepthMsg::DEPTH_REGISTERED => {
            Ok((DepthImage::from_raw(width, height, &little_endian()?, MM_PER_METRE)?, true))
        }
        DepthMsg::DEPTH_MM => {
            Ok((DepthImage::from_raw(width, height, &little_endian()?, MM_PER_METRE)?, false))
        }
        DepthMsg::DEPTH_11BIT => Ok((from_disparities(little_endian()?)?, false)),
        DepthMsg::DEPTH_11BIT_PACKED => {
            let disparities = kinect::unpack_11bit(&bytes, count)
                .ok_or_else(|| wrong(format!("{} bytes hold no {count} values", bytes.len())))?;
            Ok((from_disparities(disparities)?, false))
        }
        other => Err(wrong(format!("format {other} holds no depth that is known"))),
    }
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
    let color = bot_core_color(color)?;
    let depth = bot_core_depth(depth, kind == Images::DEPTH_MM_ZIPPED)?;
    Ok(RgbdFrame::new(message.utime, Arc::clone(camera), color, depth)?)
}

fn bot_core_color(image: &Image) -> Result<ColorImage, MessageError> {
    let (width, height) = size(image.width, image.height).map_err(MessageError::Color)?;
    match image.pixelformat {
        Image::PIXEL_FORMAT_RGB => raw_color(&image.data, width, height),
        Image::PIXEL_FORMAT_MJPEG => jpeg::decode(&image.data).map_err(MessageError::Color),
        other => Err(MessageError::Color(format!("pixel format {other} is not known"))),
    }
}

fn bot_core_depth(image: &Image, zipped: bool) -> Result<DepthImage, MessageError> {
    let wrong = MessageError::Depth;
    let (width, height) = size(image.width, image.height).map_err(wrong)?;
    let count = width * height;
    let bytes =
        if zipped { &inflated(&image.data, 2 * count).map_err(wrong)? } else { &image.data };
    let order = match image.pixelformat {
        Image::PIXEL_FORMAT_BE_GRAY16 => u16::from_be_bytes,
        _ => u16::from_le_bytes,
    };
    let raw = values(bytes, count, order).map_err(wrong)?;
    Ok(DepthImage::from_raw(width, height, &raw, MM_PER_METRE)?)
}

fn size(width: i32, height: i32) -> Result<(usize, usize), String> {
    match (usize::try_from(width), usize::try_from(height)) {
        (Ok(w), Ok(h)) if w > 0 && h > 0 && w.checked_mul(h).is_some_and(|n| n <= MAX_PIXELS) => {
            Ok((w, h))
        }
        _ => Err(format!("a picture of {width}x{height} cannot be")),
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
        assert!(error(|m| m.image.width = 32000).contains("32000x6"));
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

    proptest! {
        #[test]
        fn no_packet_makes_the_decoder_panic(
            mut bytes in proptest::collection::vec(any::<u8>(), 0..300),
            kind in 0..2,
        ) {
            let first = [FrameMsg::fingerprint(), Images::fingerprint()][kind as usize];
            if bytes.len() >= 8 {
                bytes[..8].copy_from_slice(&first.to_be_bytes());
            }
            let _ = decode_frame(&bytes, &camera());
        }
    }
}
