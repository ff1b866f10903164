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

/// Decodes a picture of a motion-JPEG stream, whose cameras may leave out the Huffman tables that
/// are always the same.
pub fn decode_motion(bytes: &[u8]) -> Result<ColorImage, String> {
    const SAYS_MOTION_JPEG: &[u8] = b"\xff\xe0\x00\x07AVI1\0";
    let Some((start, rest)) = bytes.split_at_checked(2).filter(|_| lacks_tables(bytes)) else {
        return decode(bytes);
    };
    decode(&[start, SAYS_MOTION_JPEG, rest].concat())
}

/// No Huffman table stands before the first scan.
fn lacks_tables(bytes: &[u8]) -> bool {
    const HUFFMAN_TABLES: u8 = 0xc4;
    const SCAN: u8 = 0xda;
    let mut rest = bytes.get(2..).unwrap_or_default();
    while let [0xff, marker, high, low, ..] = *rest {
        match marker {
            HUFFMAN_TABLES => return false,
            SCAN => return true,
            _ => {}
        }
        let length = usize::from(u16::from_be_bytes([high, low]));
        rest = rest.get(2 + length..).unwrap_or_default();
    }
    false
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

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> ColorImage {
        ColorImage::new(16, 8, (0..16 * 8 * 3).map(|i| (i / 2) as u8).collect()).unwrap()
    }

    /// As a camera sends it that trusts the receiver to know the usual tables.
    fn without_tables(jpeg: &[u8]) -> Vec<u8> {
        let mut out = jpeg[..2].to_vec();
        let mut rest = &jpeg[2..];
        while rest[1] != 0xda {
            let (segment, after) =
                rest.split_at(2 + usize::from(rest[2]) * 256 + usize::from(rest[3]));
            if segment[1] != 0xc4 {
                out.extend(segment);
            }
            rest = after;
        }
        [&out, rest].concat()
    }

    #[test]
    fn motion_jpeg_needs_no_tables_of_its_own() {
        let whole = encode(&picture(), 90).unwrap();
        let lean = without_tables(&whole);
        assert!(lean.len() + 100 < whole.len() && decode(&lean).is_err());
        let expected = decode(&whole).unwrap();
        assert_eq!(decode_motion(&lean).unwrap(), expected);
        assert_eq!(decode_motion(&whole).unwrap(), expected);
    }

    #[test]
    fn damaged_motion_jpeg_is_an_error() {
        let lean = without_tables(&encode(&picture(), 90).unwrap());
        for length in 0..lean.len() - 8 {
            assert!(decode_motion(&lean[..length]).is_err(), "cut to {length} bytes");
        }
    }
}
