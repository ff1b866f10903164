//! How sure a scanner is of its depth, as pictures beside it tell: `confidence/000017.png`.
//!
//! In: raw depth and the picture of its confidence, of 0 (low) to 2 (high). Out: depth without its low readings.

use crate::error::PictureFault;
use crate::image_file::{self, ImageFileError};
use std::path::Path;

/// The lowest confidence: such a reading is none.
const LOW: u8 = 0;

/// Sets the readings to 0 that the picture calls low.
///
/// # Errors
/// Names the picture where it is damaged, not 8-bit grey, or of another size than depth.
pub fn remove_low(
    raw: &mut [u16],
    size: (usize, usize),
    picture: &Path,
) -> Result<(), ImageFileError> {
    let (width, height, confidence) = image_file::read_labels(picture)?;
    if (width, height) != size {
        let reason = format!("confidence is {width}x{height}, but depth is {}x{}", size.0, size.1);
        let fault = PictureFault::Damaged(reason);
        return Err(ImageFileError { path: picture.display().to_string(), fault });
    }
    let low = raw.iter_mut().zip(confidence).filter(|(_, confidence)| *confidence == LOW);
    low.for_each(|(reading, _)| *reading = 0);
    Ok(())
}
