//! Reading and writing picture files, strictly: a truncated file is an error, never a
//! picture whose lower half is grey.

use crate::frame::ColorImage;
use crate::jpeg;
use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::path::Path;

/// A picture file that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct ImageFileError {
    path: String,
    reason: String,
}

fn error(path: &Path, reason: impl ToString) -> ImageFileError {
    ImageFileError { path: path.display().to_string(), reason: reason.to_string() }
}

/// Reads an 8-bit colour or grey picture, PNG or JPEG by its ending.
///
/// # Errors
/// Names the file when it is missing, truncated, corrupt, or of another bit depth.
pub fn read_color(path: &Path) -> Result<ColorImage, ImageFileError> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("jpg" | "jpeg") => read_jpeg(path),
        Some("png") => read_png_color(path),
        _ => Err(error(path, "colour pictures must end in .png, .jpg or .jpeg")),
    }
}

/// Reads a 16-bit grey PNG: raw depth. Returns width, height and the values, top row first.
///
/// # Errors
/// Names the file when it is missing, truncated, corrupt, or not 16-bit grey.
pub fn read_depth(path: &Path) -> Result<(usize, usize, Vec<u16>), ImageFileError> {
    let (info, bytes) = decode_png(path, png::Transformations::IDENTITY)?;
    if (info.color_type, info.bit_depth) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err(error(
            path,
            format!(
                "depth must be a 16-bit grey PNG, found {:?} {:?}",
                info.color_type, info.bit_depth
            ),
        ));
    }
    let raw = bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
    Ok((info.width as usize, info.height as usize, raw))
}

/// Reads an 8-bit grey PNG (label pictures). Returns width, height and the values.
///
/// # Errors
/// Names the file when it is missing, truncated, corrupt, or not 8-bit grey.
pub fn read_labels(path: &Path) -> Result<(usize, usize, Vec<u8>), ImageFileError> {
    let (info, bytes) = decode_png(path, png::Transformations::IDENTITY)?;
    if (info.color_type, info.bit_depth) != (png::ColorType::Grayscale, png::BitDepth::Eight) {
        return Err(error(path, "labels must be an 8-bit grey PNG"));
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

fn read_png_color(path: &Path) -> Result<ColorImage, ImageFileError> {
    let (info, bytes) =
        decode_png(path, png::Transformations::EXPAND | png::Transformations::STRIP_16)?;
    let rgb = match info.color_type {
        png::ColorType::Rgb => bytes,
        png::ColorType::Rgba => bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect(),
        png::ColorType::Grayscale => bytes.iter().flat_map(|&g| [g, g, g]).collect(),
        png::ColorType::GrayscaleAlpha => {
            bytes.chunks_exact(2).flat_map(|p| [p[0], p[0], p[0]]).collect()
        }
        png::ColorType::Indexed => return Err(error(path, "palette was not expanded")),
    };
    ColorImage::new(info.width as usize, info.height as usize, rgb).map_err(|e| error(path, e))
}

fn decode_png(
    path: &Path,
    transformations: png::Transformations,
) -> Result<(png::OutputInfo, Vec<u8>), ImageFileError> {
    let file = File::open(path).map_err(|e| error(path, e))?;
    let mut decoder = png::Decoder::new(BufReader::new(file));
    decoder.set_transformations(transformations);
    let damaged = |e: png::DecodingError| error(path, format!("damaged PNG: {e}"));
    let mut reader = decoder.read_info().map_err(damaged)?;
    let size =
        reader.output_buffer_size().ok_or_else(|| error(path, "the picture is too large"))?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(damaged)?;
    bytes.truncate(info.buffer_size());
    Ok((info, bytes))
}

fn read_jpeg(path: &Path) -> Result<ColorImage, ImageFileError> {
    let bytes = std::fs::read(path).map_err(|e| error(path, e))?;
    jpeg::decode(&bytes).map_err(|e| error(path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_survives_a_round_trip_bit_for_bit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.png");
        let raw: Vec<u16> = (0..48).map(|i| i * 1365).collect();
        write_depth(&path, 8, 6, &raw).unwrap();
        assert_eq!(read_depth(&path).unwrap(), (8, 6, raw));
    }

    #[test]
    fn a_truncated_png_is_an_error_that_names_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("cut.png");
        let noise = (0..64 * 64).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 16) as u16);
        write_depth(&path, 64, 64, &noise.collect::<Vec<_>>()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let message = read_depth(&path).unwrap_err().to_string();
        assert!(message.contains("cut.png") && message.contains("damaged PNG"), "{message}");
    }
}
