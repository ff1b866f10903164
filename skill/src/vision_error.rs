//! The error of the vision library, without its type in the skill's own interface.

/// The vision library (OpenCV) failed: a fault of the program or of the machine, not of the picture.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct VisionError(opencv::Error);

impl VisionError {
    pub(crate) fn new(error: opencv::Error) -> Self {
        Self(error)
    }
}
