//! Pictures of messages as colour and depth.

use super::messages::{CompressedImage, Image};
use crate::bayer::{BayerPattern, demosaic, to_8_bits};
use crate::error::PictureFault;
use crate::yuv::yuv_to_rgb;
use crate::{image_file, jpeg, rvl};
use linkage_frames::frame::{ColorImage, DepthImage, same_size};
use std::io::Cursor;

/// Columns and rows.
type Size = (usize, usize);

/// What `compressed_depth_image_transport` writes before the picture: the kind of compression, then
/// two coefficients of inverse depth.
const DEPTH_HEADER_BYTES: usize = 12;
/// The first bytes of any PNG.
const PNG_MAGIC: &[u8] = b"\x89PNG";
/// The first bytes of any JPEG.
const JPEG_MAGIC: &[u8] = b"\xff\xd8";

fn damaged(reason: impl Into<String>) -> PictureFault {
    PictureFault::Damaged(reason.into())
}

/// Colour of an uncompressed picture.
///
/// # Errors
/// [`PictureFault`] for another size, missing bytes, or an encoding that is not read.
pub fn color_of_image(image: &Image<'_>, size: Size) -> Result<ColorImage, PictureFault> {
    same_size("colour", (image.width, image.height), size)?;
    let encoding = image.encoding.to_ascii_lowercase();
    if let Some((pattern, bits)) = BayerPattern::of_encoding(&encoding) {
        return color_of_mosaic(image, pattern, bits);
    }
    let bytes_per_pixel = match encoding.as_str() {
        "rgb8" | "bgr8" | "8uc3" => 3,
        "rgba8" | "bgra8" | "8uc4" => 4,
        "mono8" | "8uc1" => 1,
        "yuv422" | "uyvy" | "yuv422_yuy2" | "yuyv" | "yuy2" => 2,
        _ => {
            return Err(damaged(format!(
                "colour of encoding \"{}\" is not read; rgb8, bgr8, rgba8, bgra8, mono8, yuv422, yuv422_yuy2 and bayer_rggb8, bayer_bggr8, bayer_gbrg8, bayer_grbg8 (or 16) are",
                image.encoding
            )));
        }
    };
    let rows = rows(image, bytes_per_pixel)?;
    let mut rgb = Vec::with_capacity(size.0 * size.1 * 3);
    for row in rows {
        match encoding.as_str() {
            "rgb8" => rgb.extend_from_slice(row),
            "bgr8" | "8uc3" => rgb.extend(row.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]])),
            "rgba8" => rgb.extend(row.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]])),
            "bgra8" | "8uc4" => rgb.extend(row.chunks_exact(4).flat_map(|p| [p[2], p[1], p[0]])),
            "mono8" | "8uc1" => rgb.extend(row.iter().flat_map(|&y| [y, y, y])),
            "yuv422" | "uyvy" => rgb.extend(row.chunks_exact(4).flat_map(|p| {
                [yuv_to_rgb(p[1], p[0], p[2]), yuv_to_rgb(p[3], p[0], p[2])].concat()
            })),
            _ => rgb.extend(row.chunks_exact(4).flat_map(|p| {
                [yuv_to_rgb(p[0], p[1], p[3]), yuv_to_rgb(p[2], p[1], p[3])].concat()
            })),
        }
    }
    Ok(ColorImage::new(size.0, size.1, rgb)?)
}

/// Colour of a camera's mosaic; 16 bits are taken as the whole range.
fn color_of_mosaic(
    image: &Image<'_>,
    pattern: BayerPattern,
    bits: usize,
) -> Result<ColorImage, PictureFault> {
    let Image { width, height, is_big_endian, .. } = *image;
    let order = if is_big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
    let rows = rows(image, bits / 8)?;
    let mosaic: Vec<u8> = if bits == 8 {
        rows.flatten().copied().collect()
    } else {
        rows.flat_map(|row| row.as_chunks::<2>().0).map(|b| to_8_bits(order(*b))).collect()
    };
    let rgb = demosaic(pattern, &mosaic, width, height)
        .ok_or_else(|| damaged(format!("{width}x{height} pixels are no mosaic of 2x2 cells")))?;
    Ok(ColorImage::new(width, height, rgb)?)
}

/// Colour of a compressed picture, JPEG or PNG.
///
/// # Errors
/// [`PictureFault`].
pub fn color_of_compressed(
    image: &CompressedImage<'_>,
    size: Size,
) -> Result<ColorImage, PictureFault> {
    if image.data.starts_with(JPEG_MAGIC) {
        return jpeg::decode(image.data, size);
    }
    if image.data.starts_with(PNG_MAGIC) {
        return image_file::decode_png_color(Cursor::new(image.data), size);
    }
    Err(damaged(format!("colour of format \"{}\" is neither JPEG nor PNG", image.format)))
}

/// Depth of an uncompressed picture; 16 bits hold this many units in a metre.
///
/// # Errors
/// [`PictureFault`].
pub fn depth_of_image(
    image: &Image<'_>,
    size: Size,
    units_per_metre: f64,
) -> Result<DepthImage, PictureFault> {
    same_size("depth", (image.width, image.height), size)?;
    let is_big_endian = image.is_big_endian;
    match image.encoding.to_ascii_lowercase().as_str() {
        "16uc1" | "mono16" | "z16" => {
            let order = if is_big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
            let rows = rows(image, 2)?;
            let raw: Vec<u16> =
                rows.flat_map(|r| r.chunks_exact(2).map(|b| order([b[0], b[1]]))).collect();
            Ok(DepthImage::from_raw(size.0, size.1, &raw, units_per_metre)?)
        }
        "32fc1" => {
            let order = if is_big_endian { f32::from_be_bytes } else { f32::from_le_bytes };
            let rows = rows(image, 4)?;
            let metres =
                rows.flat_map(|r| r.chunks_exact(4).map(|b| order([b[0], b[1], b[2], b[3]])));
            Ok(DepthImage::from_metres(size.0, size.1, metres.collect())?)
        }
        _ => Err(damaged(format!(
            "depth of encoding \"{}\" is not read; 16UC1 (millimetres) and 32FC1 (metres) are",
            image.encoding
        ))),
    }
}

/// Depth of a compressed picture: a PNG of 16 bits, or what `compressed_depth_image_transport`
/// writes, with PNG or RVL.
///
/// # Errors
/// [`PictureFault`].
pub fn depth_of_compressed(
    image: &CompressedImage<'_>,
    size: Size,
    units_per_metre: f64,
) -> Result<DepthImage, PictureFault> {
    if image.data.starts_with(PNG_MAGIC) {
        let raw = image_file::decode_png_depth(Cursor::new(image.data), size)?;
        return Ok(DepthImage::from_raw(size.0, size.1, &raw, units_per_metre)?);
    }
    let Some((header, picture)) = image.data.split_at_checked(DEPTH_HEADER_BYTES) else {
        return Err(damaged("the header of the compressed depth is cut"));
    };
    let raw = if picture.starts_with(PNG_MAGIC) {
        image_file::decode_png_depth(Cursor::new(picture), size)?
    } else if image.format.to_ascii_lowercase().contains("rvl") {
        decode_rvl(picture, size)?
    } else {
        return Err(damaged(format!(
            "depth of format \"{}\" is not read; compressedDepth as PNG or RVL is",
            image.format
        )));
    };
    if !image.format.trim_start().starts_with("32FC1") {
        return Ok(DepthImage::from_raw(size.0, size.1, &raw, units_per_metre)?);
    }
    // A value v stands for the inverse depth (v - b) / a.
    let number = |at: usize| {
        f32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
    };
    let (a, b) = (number(4), number(8));
    let metres = |v: &u16| if *v == 0 { f32::NAN } else { a / (f32::from(*v) - b) };
    Ok(DepthImage::from_metres(size.0, size.1, raw.iter().map(metres).collect())?)
}

/// RVL behind its columns and rows, each of 32 bits.
fn decode_rvl(picture: &[u8], size: Size) -> Result<Vec<u16>, PictureFault> {
    let cut = || damaged("the size of the RVL picture is cut");
    let (columns, rest) = picture.split_first_chunk().ok_or_else(cut)?;
    let (rows, numbers) = rest.split_first_chunk().ok_or_else(cut)?;
    let found = [columns, rows].map(|side| u32::from_le_bytes(*side) as usize);
    // Memory is taken for what the camera says, not the message.
    same_size("depth", found.into(), size)?;
    rvl::decode(numbers, size.0 * size.1)
}

/// The rows of a picture without what pads them.
fn rows<'b>(
    image: &Image<'b>,
    bytes_per_pixel: usize,
) -> Result<impl Iterator<Item = &'b [u8]> + use<'b>, PictureFault> {
    let row_bytes = image.width.saturating_mul(bytes_per_pixel);
    let step = if image.step == 0 { row_bytes } else { image.step };
    let needed = step.saturating_mul(image.height.saturating_sub(1)).saturating_add(row_bytes);
    if step < row_bytes || image.data.len() < needed {
        return Err(damaged(format!(
            "{}x{} pixels of {} in rows of {step} bytes need {needed} bytes, {} given",
            image.width,
            image.height,
            image.encoding,
            image.data.len()
        )));
    }
    let data = image.data;
    Ok((0..image.height).map(move |v| &data[v * step..v * step + row_bytes]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::messages::Header;

    const HEADER: Header<'static> = Header { utime: 0, frame: "" };

    fn image<'b>(encoding: &'b str, step: usize, data: &'b [u8]) -> Image<'b> {
        let (width, height, is_big_endian) = (2, 1, false);
        Image { header: HEADER, width, height, encoding, is_big_endian, step, data }
    }

    #[test]
    fn colour_of_all_encodings_is_read_as_rgb() {
        for (encoding, bytes, expected) in [
            ("rgb8", &[1, 2, 3, 4, 5, 6][..], [1, 2, 3, 4, 5, 6]),
            ("bgr8", &[3, 2, 1, 6, 5, 4], [1, 2, 3, 4, 5, 6]),
            ("rgba8", &[1, 2, 3, 9, 4, 5, 6, 9], [1, 2, 3, 4, 5, 6]),
            ("bgra8", &[3, 2, 1, 9, 6, 5, 4, 9], [1, 2, 3, 4, 5, 6]),
            ("mono8", &[7, 8], [7, 7, 7, 8, 8, 8]),
            ("yuv422", &[128, 16, 128, 235], [0, 0, 0, 255, 255, 255]),
            ("yuv422_yuy2", &[16, 128, 235, 128], [0, 0, 0, 255, 255, 255]),
        ] {
            let padded = [bytes, &[99; 5]].concat();
            for (step, data) in [(0, bytes), (bytes.len(), bytes), (bytes.len() + 5, &padded)] {
                let color = color_of_image(&image(encoding, step, data), (2, 1)).unwrap();
                assert_eq!(color.as_rgb(), expected, "{encoding}, rows of {step} bytes");
            }
        }
        let error = color_of_image(&image("nv12", 2, &[0; 2]), (2, 1)).unwrap_err().to_string();
        assert!(error.contains("\"nv12\"") && error.contains("bayer_rggb8"), "{error}");
    }

    #[test]
    fn depth_is_millimetres_in_16_bits_and_metres_in_floats() {
        let metres = [1.5_f32, 0.25];
        let of = |image: &Image<'_>| depth_of_image(image, (2, 1), 1000.0).unwrap().to_raw(1000.0);
        let little = [1500_u16.to_le_bytes(), 250_u16.to_le_bytes()].concat();
        assert_eq!(of(&image("16UC1", 4, &little)), [1500, 250]);
        let big = [1500_u16.to_be_bytes(), 250_u16.to_be_bytes()].concat();
        let big = Image { is_big_endian: true, ..image("16UC1", 4, &big) };
        assert_eq!(of(&big), [1500, 250]);
        let floats: Vec<u8> = metres.iter().flat_map(|z| z.to_le_bytes()).collect();
        assert_eq!(of(&image("32FC1", 8, &floats)), [1500, 250]);
    }

    #[test]
    fn a_mosaic_of_8_or_16_bits_in_rows_with_padding_is_read_in_colour() {
        // Red 200, green 100, blue 50: blue and green in the first row, green and red in the second.
        let (wide, flat) = ([50_u16, 100, 100, 200], [50_u8, 100, 9, 9, 100, 200]);
        let sixteen = |bytes: fn(u16) -> [u8; 2]| wide.map(|v| bytes(257 * v)).concat();
        let (little, big) = (sixteen(u16::to_le_bytes), sixteen(u16::to_be_bytes));
        let read = |encoding, step, is_big_endian, data| {
            let image = Image { height: 2, is_big_endian, ..image(encoding, step, data) };
            color_of_image(&image, (2, 2))
        };
        for (encoding, step, is_big_endian, data) in [
            ("bayer_bggr8", 4, false, &flat[..]),
            ("bayer_bggr16", 4, false, &little),
            ("bayer_bggr16", 4, true, &big),
        ] {
            let color = read(encoding, step, is_big_endian, data).unwrap();
            assert_eq!(color.as_rgb(), [200, 100, 50].repeat(4), "{encoding}");
        }
        let cut = read("bayer_bggr8", 2, false, &flat[..3]).unwrap_err().to_string();
        assert!(cut.contains("need 4 bytes, 3 given"), "{cut}");
        let row = color_of_image(&image("bayer_rggb8", 2, &[0; 2]), (2, 1)).unwrap_err();
        assert!(row.to_string().contains("2x1 pixels are no mosaic"), "{row}");
    }

    #[test]
    fn compressed_depth_is_read_with_its_header() {
        let png = image_file::encode_png_depth(2, 1, &[1500, 0]).unwrap();
        let (a, b) = (100.0_f32, -10.0_f32);
        let header = [&0_u32.to_le_bytes()[..], &a.to_le_bytes(), &b.to_le_bytes()].concat();
        let data = [header, png.clone()].concat();
        let read = |format, data| {
            let image = CompressedImage { header: HEADER, format, data };
            depth_of_compressed(&image, (2, 1), 1000.0)
        };
        for (format, data, expected) in [
            ("16UC1; compressedDepth png", &data, 1500),
            ("16UC1; png compressed", &png, 1500),
            // 100 / (1500 + 10) m
            ("32FC1; compressedDepth", &data, 66),
        ] {
            let depth = read(format, data).unwrap();
            assert_eq!(depth.to_raw(1000.0), [expected, 0], "{format}");
        }
        for length in 0..data.len() - 16 {
            assert!(read("16UC1; compressedDepth png", &data[..length]).is_err(), "{length}");
        }
        let error = read("16UC1; compressedDepth qoi", &[0; 40]).unwrap_err().to_string();
        assert!(error.contains("qoi") && error.contains("RVL"), "{error}");
    }

    #[test]
    fn compressed_depth_as_rvl_is_read_behind_its_size() {
        let (a, b) = (100.0_f32, -10.0_f32);
        let header = [&0_u32.to_le_bytes()[..], &a.to_le_bytes(), &b.to_le_bytes()].concat();
        let message = |[columns, rows]: [u32; 2]| {
            let sides = [columns.to_le_bytes(), rows.to_le_bytes()].concat();
            [header.clone(), sides, rvl::tests::encode(&[1500, 0])].concat()
        };
        let read = |format, data: &[u8]| {
            let image = CompressedImage { header: HEADER, format, data };
            depth_of_compressed(&image, (2, 1), 1000.0)
        };
        let whole = message([2, 1]);
        for (format, expected) in [
            ("16UC1; compressedDepth rvl", 1500),
            // 100 / (1500 + 10) m
            ("32FC1; compressedDepth rvl", 66),
        ] {
            let depth = read(format, &whole).unwrap();
            assert_eq!(depth.to_raw(1000.0), [expected, 0], "{format}");
        }
        for length in 0..whole.len() {
            assert!(read("16UC1; compressedDepth rvl", &whole[..length]).is_err(), "{length}");
        }
        for sides in [[1, 2], [u32::MAX; 2]] {
            let error = read("16UC1; compressedDepth rvl", &message(sides)).unwrap_err();
            assert!(matches!(error, PictureFault::Size(_)), "{error}");
        }
    }

    #[test]
    fn a_picture_without_all_its_bytes_or_of_another_size_is_refused() {
        let short = color_of_image(&image("rgb8", 6, &[0; 5]), (2, 1)).unwrap_err();
        assert!(short.to_string().contains("need 6 bytes, 5 given"), "{short}");
        let narrow = color_of_image(&image("rgb8", 5, &[0; 60]), (2, 1)).unwrap_err();
        assert!(narrow.to_string().contains("rows of 5 bytes"), "{narrow}");
        let huge = Image { width: usize::MAX, height: usize::MAX, ..image("rgb8", 6, &[]) };
        assert!(matches!(color_of_image(&huge, (2, 1)), Err(PictureFault::Size(_))));
        assert!(color_of_image(&huge, (usize::MAX, usize::MAX)).is_err());
    }
}
