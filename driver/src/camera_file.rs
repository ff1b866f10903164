//! Reads the `camera.toml` of a source.

use crate::error::SourceError;
use linkage_frames::camera::PinholeCamera;
use std::path::Path;

/// Keys of the file.
const KEYS: &str = "width height fx fy cx cy depth_units_per_metre distortion depth_sensor";

/// Reads `camera.toml`, with the keys that it may hold in the error.
///
/// # Errors
/// [`SourceError::Recording`].
pub fn read_camera_file(path: &Path) -> Result<PinholeCamera, SourceError> {
    PinholeCamera::read(path).map_err(|e| SourceError::Recording {
        path: e.to_string(),
        reason: format!("known keys: {KEYS}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_frames::depth::DepthSensor;

    #[test]
    fn the_error_names_every_key_that_the_file_may_hold() {
        let camera = PinholeCamera { depth_sensor: DepthSensor::Stereo, ..PinholeCamera::kinect() };
        let table = toml::Table::try_from(&camera).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("camera.toml");
        std::fs::write(&path, "sensor = 3").unwrap();
        let error = read_camera_file(&path).unwrap_err().to_string();
        for key in table.keys() {
            assert!(error.split_whitespace().any(|word| word == key), "{key}: {error}");
        }
    }
}
