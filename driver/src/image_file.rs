//! Reading and writing picture files, strictly: a truncated file is an error, never a
//! picture whose lower half is grey. A picture of another size than expected is refused by its
//! header, before memory is taken for its pixels.

use crate::error::{FrameError, PictureFault};
use crate::jpeg;
use linkage_frames::camera::MAX_PIXELS;
use linkage_frames::frame::{ColorImage, same_size};
use linkage_frames::text_table;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Seek};
use std::path::Path;

/// Largest picture file that is read into memory, bytes.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// Bytes that a PNG's metadata may take; those of cameras have some 10 000.
const MAX_METADATA_BYTES: usize = 1 << 20;

/// A picture file that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {fault}")]
pub struct ImageFileError {
    /// The file.
    pub path: String,
    /// What is wrong with it.
    pub fault: PictureFault,
}

fn error(path: &Path, reason: impl ToString) -> ImageFileError {
    at(path)(PictureFault::Damaged(reason.to_string()))
}

fn at(path: &Path) -> impl FnOnce(PictureFault) -> ImageFileError {
    move |fault| ImageFileError { path: path.display().to_string(), fault }
}

/// Reads an 8-bit colour or grey picture of this many columns and rows, PNG or JPEG by its ending.
///
/// # Errors
/// Names the file when it is missing, truncated, corrupt, or of another size.
pub fn read_color(path: &Path, size: (usize, usize)) -> Result<ColorImage, ImageFileError> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("jpg" | "jpeg") => read_jpeg(path, size),
        Some("png") => {
            let file = opened(path)?;
            decode_png_color(file, size).map_err(at(path))
        }
        _ => Err(error(path, "colour pictures must end in .png, .jpg or .jpeg")),
    }
}

/// Reads a 16-bit grey PNG of this many columns and rows: raw depth, top row first.
///
/// # Errors
/// Names the file when it is missing, truncated, corrupt, not 16-bit grey, or of another size.
pub fn read_depth(path: &Path, size: (usize, usize)) -> Result<Vec<u16>, ImageFileError> {
    let file = opened(path)?;
    decode_png_depth(file, size).map_err(at(path))
}

/// Columns and rows that a picture's header tells, PNG or JPEG by its first bytes.
///
/// # Errors
/// Names the file when it is missing or neither.
pub fn read_size(path: &Path) -> Result<(usize, usize), ImageFileError> {
    let mut file = opened(path)?;
    let is_png = file.fill_buf().map_err(|e| error(path, e))?.starts_with(b"\x89PNG");
    if is_png {
        let mut decoder = png::Decoder::new(file);
        let header = decoder.read_header_info().map_err(|e| error(path, e))?;
        return Ok((header.width as usize, header.height as usize));
    }
    let mut bytes = Vec::new();
    file.take(MAX_FILE_BYTES).read_to_end(&mut bytes).map_err(|e| error(path, e))?;
    jpeg::size(&bytes).map_err(at(path))
}

/// Decodes a PNG to colour.
///
/// # Errors
/// [`PictureFault`].
pub fn decode_png_color(
    png: impl BufRead + Seek,
    size: (usize, usize),
) -> Result<ColorImage, PictureFault> {
    let transformations = png::Transformations::EXPAND | png::Transformations::STRIP_16;
    let (info, bytes) = decode_png(png, transformations, |found| same_size("colour", found, size))?;
    let rgb = match info.color_type {
        png::ColorType::Rgb => bytes,
        png::ColorType::Rgba => bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect(),
        png::ColorType::Grayscale => bytes.iter().flat_map(|&g| [g, g, g]).collect(),
        png::ColorType::GrayscaleAlpha => {
            bytes.chunks_exact(2).flat_map(|p| [p[0], p[0], p[0]]).collect()
        }
        png::ColorType::Indexed => {
            return Err(PictureFault::Damaged("palette was not expanded".to_owned()));
        }
    };
    Ok(ColorImage::new(size.0, size.1, rgb)?)
}

/// Decodes a 16-bit grey PNG to raw depth.
///
/// # Errors
/// [`PictureFault`].
pub fn decode_png_depth(
    png: impl BufRead + Seek,
    size: (usize, usize),
) -> Result<Vec<u16>, PictureFault> {
    let transformations = png::Transformations::IDENTITY;
    let (info, bytes) = decode_png(png, transformations, |found| same_size("depth", found, size))?;
    if (info.color_type, info.bit_depth) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err(PictureFault::Damaged(format!(
            "depth must be a 16-bit grey PNG, found {:?} {:?}",
            info.color_type, info.bit_depth
        )));
    }
    Ok(bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect())
}

/// Reads an 8-bit grey PNG (labels, confidence). Returns width, height and the values.
///
/// # Errors
/// Names the file when it is missing, truncated, corrupt, or not 8-bit grey.
pub fn read_labels(path: &Path) -> Result<(usize, usize, Vec<u8>), ImageFileError> {
    let any_size = |_| Ok(());
    let (info, bytes) =
        decode_png(opened(path)?, png::Transformations::IDENTITY, any_size).map_err(at(path))?;
    if (info.color_type, info.bit_depth) != (png::ColorType::Grayscale, png::BitDepth::Eight) {
        return Err(error(path, "must be an 8-bit grey PNG"));
    }
    Ok((info.width as usize, info.height as usize, bytes))
}

/// Writes an RGB picture as PNG.
///
/// # Errors
/// Names the file when it cannot be written (a full disk, a missing folder).
pub fn write_color(path: &Path, image: &ColorImage) -> Result<(), ImageFileError> {
    write_png(
        path,
        image.width(),
        image.height(),
        png::ColorType::Rgb,
        png::BitDepth::Eight,
        image.as_rgb(),
    )
}

/// Writes raw depth as a 16-bit grey PNG.
///
/// # Errors
/// Names the file when it cannot be written.
pub fn write_depth(
    path: &Path,
    width: usize,
    height: usize,
    raw: &[u16],
) -> Result<(), ImageFileError> {
    let bytes: Vec<u8> = raw.iter().flat_map(|r| r.to_be_bytes()).collect();
    write_png(path, width, height, png::ColorType::Grayscale, png::BitDepth::Sixteen, &bytes)
}

/// Encodes raw depth as a 16-bit grey PNG in memory.
///
/// # Errors
/// What the encoder says, for a buffer that does not fit the size.
pub fn encode_png_depth(width: usize, height: usize, raw: &[u16]) -> Result<Vec<u8>, String> {
    let bytes: Vec<u8> = raw.iter().flat_map(|r| r.to_be_bytes()).collect();
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(&bytes).map_err(|e| e.to_string())?;
    writer.finish().map_err(|e| e.to_string())?;
    Ok(out)
}

/// Writes labels as an 8-bit grey PNG.
///
/// # Errors
/// Names the file when it cannot be written.
pub fn write_labels(
    path: &Path,
    width: usize,
    height: usize,
    labels: &[u8],
) -> Result<(), ImageFileError> {
    write_png(path, width, height, png::ColorType::Grayscale, png::BitDepth::Eight, labels)
}

fn write_png(
    path: &Path,
    width: usize,
    height: usize,
    color: png::ColorType,
    depth: png::BitDepth,
    bytes: &[u8],
) -> Result<(), ImageFileError> {
    let file = File::create(path).map_err(|e| error(path, e))?;
    let mut encoder = png::Encoder::new(BufWriter::new(file), width as u32, height as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(|e| error(path, e))?;
    writer.write_image_data(bytes).map_err(|e| error(path, e))?;
    writer.finish().map_err(|e| error(path, e))
}

fn opened(path: &Path) -> Result<BufReader<File>, ImageFileError> {
    Ok(BufReader::new(text_table::regular_file(path).map_err(|e| error(path, e))?))
}

/// Decodes a PNG whose size `fits` and is below [`MAX_PIXELS`]. Its colour profile and texts are passed over: a
/// small one could unpack to 100 MB.
fn decode_png(
    png: impl BufRead + Seek,
    transformations: png::Transformations,
    fits: impl Fn((usize, usize)) -> Result<(), FrameError>,
) -> Result<(png::OutputInfo, Vec<u8>), PictureFault> {
    let damaged = |e: png::DecodingError| match e {
        png::DecodingError::LimitsExceeded => PictureFault::Damaged(format!(
            "has more than {MAX_METADATA_BYTES} bytes of metadata; remove them"
        )),
        e => PictureFault::Damaged(format!("damaged PNG: {e}")),
    };
    let mut decoder = png::Decoder::new(png);
    decoder.set_transformations(transformations);
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_ignore_text_chunk(true);
    let header = decoder.read_header_info().map_err(damaged)?;
    let (width, height) = (header.width as usize, header.height as usize);
    fits((width, height))?;
    if width.saturating_mul(height) > MAX_PIXELS {
        return Err(PictureFault::Damaged(format!(
            "{width}x{height} pixels are more than {MAX_PIXELS}; shrink the pictures"
        )));
    }
    // The limit counts a row too, of 8 bytes a pixel at most.
    decoder.set_limits(png::Limits { bytes: 8 * width + MAX_METADATA_BYTES });
    let mut reader = decoder.read_info().map_err(damaged)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| PictureFault::Damaged("the picture is too large".to_owned()))?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(damaged)?;
    bytes.truncate(info.buffer_size());
    Ok((info, bytes))
}

fn read_jpeg(path: &Path, size: (usize, usize)) -> Result<ColorImage, ImageFileError> {
    let mut bytes = Vec::new();
    let read = opened(path)?.take(MAX_FILE_BYTES).read_to_end(&mut bytes);
    read.map_err(|e: io::Error| error(path, e))?;
    jpeg::decode(&bytes, size).map_err(at(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    #[test]
    fn depth_survives_a_round_trip_bit_for_bit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.png");
        let raw: Vec<u16> = (0..48).map(|i| i * 1365).collect();
        write_depth(&path, 8, 6, &raw).unwrap();
        assert_eq!(read_depth(&path, (8, 6)).unwrap(), raw);
    }

    #[test]
    fn a_truncated_png_is_an_error_that_names_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("cut.png");
        let noise = (0..64 * 64).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 16) as u16);
        write_depth(&path, 64, 64, &noise.collect::<Vec<_>>()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let message = read_depth(&path, (64, 64)).unwrap_err().to_string();
        assert!(message.contains("cut.png") && message.contains("damaged PNG"), "{message}");
    }

    /// A PNG of a few bytes: a header that claims this many pixels, and no pixel.
    fn claiming(width: u32, height: u32, color: png::ColorType, depth: png::BitDepth) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(color);
        encoder.set_depth(depth);
        encoder.write_header().unwrap();
        bytes
    }

    #[test]
    fn a_picture_of_another_size_is_refused_by_its_header() {
        let size = (64, 48);
        for (width, height) in [(100_000, 100_000), (u32::MAX >> 1, 1), (48, 64), (65, 48)] {
            let png = claiming(width, height, png::ColorType::Rgb, png::BitDepth::Eight);
            let error = decode_png_color(Cursor::new(&png), size).unwrap_err().to_string();
            assert!(error.contains(&format!("colour is {width}x{height}")), "{error}");
            let png = claiming(width, height, png::ColorType::Grayscale, png::BitDepth::Sixteen);
            let error = decode_png_depth(Cursor::new(&png), size).unwrap_err().to_string();
            assert!(error.contains(&format!("depth is {width}x{height}")), "{error}");
        }
    }

    #[test]
    fn labels_above_the_limit_are_refused_by_their_header() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("labels.png");
        let png = claiming(100_000, 100_000, png::ColorType::Grayscale, png::BitDepth::Eight);
        assert!(png.len() < 80, "{} bytes", png.len());
        std::fs::write(&path, png).unwrap();
        let error = read_labels(&path).unwrap_err().to_string();
        assert!(error.contains("100000x100000") && error.contains("shrink"), "{error}");
    }

    #[test]
    fn colour_of_any_png_format_is_read_as_rgb() {
        use png::{BitDepth, ColorType};
        for (color, depth, pixel, palette) in [
            (ColorType::Rgb, BitDepth::Eight, &[90, 90, 90][..], None),
            (ColorType::Rgb, BitDepth::Sixteen, &[90, 1, 90, 2, 90, 3], None),
            (ColorType::Rgba, BitDepth::Eight, &[90, 90, 90, 17], None),
            (ColorType::Rgba, BitDepth::Sixteen, &[90, 1, 90, 2, 90, 3, 4, 5], None),
            (ColorType::Grayscale, BitDepth::Eight, &[90], None),
            (ColorType::Grayscale, BitDepth::Sixteen, &[90, 200], None),
            (ColorType::GrayscaleAlpha, BitDepth::Eight, &[90, 3], None),
            (ColorType::Indexed, BitDepth::Eight, &[1], Some(vec![0, 0, 0, 90, 90, 90])),
        ] {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 4, 2);
            encoder.set_color(color);
            encoder.set_depth(depth);
            if let Some(palette) = palette {
                encoder.set_palette(palette);
            }
            let mut writer = encoder.write_header().unwrap();
            writer.write_image_data(&pixel.repeat(8)).unwrap();
            writer.finish().unwrap();
            let read = decode_png_color(Cursor::new(&bytes), (4, 2)).unwrap();
            assert_eq!(read.as_rgb(), [90; 24], "{color:?} {depth:?}");
        }
    }

    /// A PNG of 4x2 grey pixels of 16 bits with one chunk between its header and its pixels.
    fn with_chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 4, 2);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let mut writer = encoder.write_header().unwrap();
        writer.write_chunk(png::chunk::ChunkType(*kind), data).unwrap();
        writer.write_image_data(&[7; 16]).unwrap();
        writer.finish().unwrap();
        bytes
    }

    #[test]
    fn what_a_png_holds_beside_its_pixels_takes_no_memory() {
        const MOST_BYTES: u64 = 4 << 20;
        let zeros = vec![0; 60 << 20];
        let mut deflated = Vec::new();
        flate2::read::ZlibEncoder::new(&zeros[..], flate2::Compression::fast())
            .read_to_end(&mut deflated)
            .unwrap();
        let bomb = [&b"name\0\0"[..], &deflated].concat();
        let text = [&b"name\0"[..], &vec![b'x'; 20 << 20]].concat();
        for (kind, data) in [(b"iCCP", &bomb), (b"zTXt", &bomb), (b"tEXt", &text), (b"eXIf", &text)]
        {
            let png = with_chunk(kind, data);
            let mut read = None;
            let memory = allocation_counter::measure(|| {
                read = Some(decode_png_depth(Cursor::new(&png), (4, 2)));
            });
            let kind = String::from_utf8_lossy(kind);
            assert!(memory.bytes_max < MOST_BYTES, "{kind}: {} bytes", memory.bytes_max);
            // Metadata of a camera that has no end are the one thing that is refused.
            assert_eq!(read.unwrap().is_ok(), kind != "eXIf", "{kind}");
        }
        let small = with_chunk(b"eXIf", &[0; 60_000]);
        assert_eq!(decode_png_depth(Cursor::new(&small), (4, 2)).unwrap(), [0x0707; 8]);
    }

    #[test]
    fn depth_of_another_format_is_refused_by_name() {
        use png::{BitDepth, ColorType};
        for (color, depth, told) in [
            (ColorType::Grayscale, BitDepth::Eight, "Grayscale Eight"),
            (ColorType::Rgb, BitDepth::Sixteen, "Rgb Sixteen"),
            (ColorType::GrayscaleAlpha, BitDepth::Sixteen, "GrayscaleAlpha Sixteen"),
        ] {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
            encoder.set_color(color);
            encoder.set_depth(depth);
            let mut writer = encoder.write_header().unwrap();
            writer.write_image_data(&vec![1; 2 * color.samples() * depth as usize / 8]).unwrap();
            writer.finish().unwrap();
            let error = decode_png_depth(Cursor::new(&bytes), (2, 1)).unwrap_err().to_string();
            assert!(error.contains("16-bit grey") && error.contains(told), "{error}");
        }
    }

    #[test]
    fn what_is_no_regular_file_is_refused_and_does_not_wait() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("folder.png");
        std::fs::create_dir(&folder).unwrap();
        let pipe = dir.path().join("pipe.png");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [&folder, &pipe] {
            let error = read_color(path, (4, 2)).unwrap_err().to_string();
            assert!(error.contains("no regular file"), "{error}");
            assert!(read_depth(path, (4, 2)).is_err());
        }
    }
}
