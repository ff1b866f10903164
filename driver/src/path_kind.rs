//! What a recording's path is: one look at it decides which reader opens it.

use crate::error::SourceError;
use std::path::Path;

/// The kinds of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathKind {
    /// A folder in the layout of the TUM RGB-D benchmark.
    Tum,
    /// An MCAP file.
    Mcap,
}

/// Looks at a path.
///
/// # Errors
/// [`SourceError::Recording`] lists what was looked for.
pub fn kind_of_path(path: &Path) -> Result<PathKind, SourceError> {
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    if path.is_dir() {
        return Ok(PathKind::Tum);
    }
    match ending.as_deref() {
        Some("mcap") => Ok(PathKind::Mcap),
        _ => Ok(PathKind::Tum),
    }
}
