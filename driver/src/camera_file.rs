//! Reads the `camera.toml` of a source.

use crate::error::SourceError;
use linkage_frames::camera::PinholeCamera;
use std::path::Path;

/// Reads `camera.toml`, with the keys that it may hold in the error.
///
/// # Errors
/// [`SourceError::Recording`].
pub fn read_camera_file(path: &Path) -> Result<PinholeCamera, SourceError> {
    PinholeCamera::read(path).map_err(|e| SourceError::Recording {
        path: e.to_string(),
        reason: "known keys: width height fx fy cx cy depth_units_per_metre distortion".to_owned(),
    })
}
