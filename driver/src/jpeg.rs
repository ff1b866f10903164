//! JPEG in memory, strictly: a truncated picture is an error.

use crate::frame::ColorImage;
use zune_jpeg::zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};

/// Largest side of a picture that is decoded.
const MAX_SIDE: usize = 8192;

/// Decodes a picture to RGB; the message says what is damaged.
pub fn decode(bytes: &[u8]) -> Result<ColorImage, String> {
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(MAX_SIDE)
        .set_max_height(MAX_SIDE)
        .set_strict_mode(true);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let rgb = decoder.decode().map_err(|e| format!("damaged JPEG: {e}"))?;
    let (width, height) = decoder.dimensions().ok_or("damaged JPEG: no size")?;
    ColorImage::new(width, height, rgb).map_err(|e| e.to_string())
}

/// Encodes a picture; `quality` from 1 to 100.
pub fn encode(image: &ColorImage, quality: u8) -> Result<Vec<u8>, String> {
    let side = |n: usize| u16::try_from(n).map_err(|_| format!("{n} pixels are too many for JPEG"));
    let (width, height) = (side(image.width())?, side(image.height())?);
    let mut bytes = Vec::new();
    jpeg_encoder::Encoder::new(&mut bytes, quality)
        .encode(image.as_rgb(), width, height, jpeg_encoder::ColorType::Rgb)
        .map_err(|e| e.to_string())?;
    Ok(bytes)
}
