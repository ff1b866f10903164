//! JPEG in memory, strictly: a truncated picture is an error.

use crate::error::PictureFault;
use linkage_frames::frame::{ColorImage, same_size};
use zune_jpeg::zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};

/// Decodes a picture of this many columns and rows to RGB. One of another size is refused by its
/// header, before memory is taken for its pixels.
///
/// # Errors
/// [`PictureFault`] says what is damaged, or which size it has.
pub fn decode(bytes: &[u8], size: (usize, usize)) -> Result<ColorImage, PictureFault> {
    // Any size that a header can say: ours is asked for before a pixel is decoded.
    let any = usize::from(u16::MAX);
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(any)
        .set_max_height(any)
        .set_strict_mode(true);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let damaged =
        |e: zune_jpeg::errors::DecodeErrors| PictureFault::Damaged(format!("damaged JPEG: {e}"));
    decoder.decode_headers().map_err(damaged)?;
    same_size("colour", decoder.dimensions().unwrap_or_default(), size)?;
    let rgb = decoder.decode().map_err(damaged)?;
    Ok(ColorImage::new(size.0, size.1, rgb)?)
}

/// Columns and rows that a picture's header tells.
///
/// # Errors
/// [`PictureFault::Damaged`] where it is none.
pub fn size(bytes: &[u8]) -> Result<(usize, usize), PictureFault> {
    let mut decoder = zune_jpeg::JpegDecoder::new(ZCursor::new(bytes));
    decoder.decode_headers().map_err(|e| PictureFault::Damaged(format!("damaged JPEG: {e}")))?;
    decoder.dimensions().ok_or_else(|| PictureFault::Damaged("a JPEG without size".to_owned()))
}

/// Decodes a picture of a motion-JPEG stream, whose cameras may leave out the Huffman tables that
/// are always the same.
///
/// # Errors
/// As [`decode`].
pub fn decode_motion(bytes: &[u8], size: (usize, usize)) -> Result<ColorImage, PictureFault> {
    const SAYS_MOTION_JPEG: &[u8] = b"\xff\xe0\x00\x07AVI1\0";
    let Some((start, rest)) = bytes.split_at_checked(2).filter(|_| lacks_tables(bytes)) else {
        return decode(bytes, size);
    };
    decode(&[start, SAYS_MOTION_JPEG, rest].concat(), size)
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
///
/// # Errors
/// What the encoder says, or that JPEG cannot hold this many pixels.
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

    const SIZE: (usize, usize) = (16, 8);

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
        assert!(lean.len() + 100 < whole.len() && decode(&lean, SIZE).is_err());
        let expected = decode(&whole, SIZE).unwrap();
        assert_eq!(decode_motion(&lean, SIZE).unwrap(), expected);
        assert_eq!(decode_motion(&whole, SIZE).unwrap(), expected);
    }

    #[test]
    fn damaged_motion_jpeg_is_an_error() {
        let lean = without_tables(&encode(&picture(), 90).unwrap());
        for length in 0..lean.len() - 8 {
            assert!(decode_motion(&lean[..length], SIZE).is_err(), "cut to {length} bytes");
        }
    }

    /// The picture, with other columns and rows in its header.
    fn claiming(jpeg: &[u8], width: u16, height: u16) -> Vec<u8> {
        const FRAME_HEADERS: [u8; 2] = [0xc0, 0xc2];
        let mut bytes = jpeg.to_vec();
        let mut at = 2;
        while !FRAME_HEADERS.contains(&bytes[at + 1]) {
            at += 2 + usize::from(bytes[at + 2]) * 256 + usize::from(bytes[at + 3]);
        }
        bytes[at + 5..at + 7].copy_from_slice(&height.to_be_bytes());
        bytes[at + 7..at + 9].copy_from_slice(&width.to_be_bytes());
        bytes
    }

    #[test]
    fn a_picture_of_another_size_is_refused_by_its_header() {
        let whole = encode(&picture(), 90).unwrap();
        assert!(decode(&claiming(&whole, 16, 8), SIZE).is_ok());
        for (width, height) in [(65_500, 65_500), (8, 16), (17, 8), (16, 7), (1, 65_500)] {
            let error = decode(&claiming(&whole, width, height), SIZE).unwrap_err().to_string();
            assert!(error.contains(&format!("{width}x{height}")), "{error}");
        }
        assert!(decode(&claiming(&whole, 0, 8), SIZE).is_err());
        assert!(decode(&claiming(&whole, 16, 0), SIZE).is_err());
    }
}
