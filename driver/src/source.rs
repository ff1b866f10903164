//! Where frames come from.

use crate::frame::{FrameError, RgbdFrame};
use crate::tum::TumRecording;
use std::path::Path;

/// A source that cannot be opened or read.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// No source goes by that name.
    #[error("{name}: {reason}")]
    Name {
        /// As it was given.
        name: String,
        /// What would be right.
        reason: String,
    },
    /// A file of a recording is missing, damaged or contradicts another.
    #[error("{path}: {reason}")]
    Recording {
        /// The file or folder.
        path: String,
        /// What is wrong and what to do.
        reason: String,
    },
    /// The frames of a recording do not fit its camera.
    #[error("{path}")]
    Frame {
        /// The picture.
        path: String,
        /// How it does not fit.
        source: FrameError,
    },
}

/// Where frames come from: a live camera or a recording.
pub trait RgbdSource: Send {
    /// Blocks until the next frame; `Ok(None)` once a recording has ended.
    ///
    /// # Errors
    /// [`SourceError`] names what could not be read.
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError>;

    /// Frames in all, where that is known.
    fn frame_count(&self) -> Option<usize>;

    /// Name for logs and provenance.
    fn name(&self) -> &str;
}

/// Opens a source by name: `tum:DIR`, or a bare directory (DESIGN 4.2).
///
/// # Errors
/// [`SourceError::Name`] for a scheme that is not known, [`SourceError::Recording`] for a
/// folder that is no recording.
pub fn open(name: &str) -> Result<Box<dyn RgbdSource>, SourceError> {
    let path = match name.split_once(':') {
        Some(("tum", rest)) => rest,
        Some((scheme, _)) if !Path::new(name).exists() => {
            return Err(SourceError::Name {
                name: name.to_owned(),
                reason: format!("no source of kind \"{scheme}:\"; give tum:DIR or a directory"),
            });
        }
        _ => name,
    };
    Ok(Box::new(TumRecording::open(Path::new(path))?))
}
