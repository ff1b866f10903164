//! What can be wrong with a frame.

/// A frame whose parts do not fit each other.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameError {
    /// A buffer does not hold as many values as its size asks for.
    #[error("{what} image of {width}x{height} needs {needed} values, {found} given")]
    BufferSize {
        /// Which image.
        what: &'static str,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Values that the size asks for.
        needed: usize,
        /// Values that were given.
        found: usize,
    },
    /// Colour, depth and camera must share one size: depth is registered to colour.
    #[error(
        "{what} is {found_width}x{found_height}, but the camera is {width}x{height}; \
         register depth to colour and describe both in camera.toml"
    )]
    SizeMismatch {
        /// Which image.
        what: &'static str,
        /// Its columns.
        found_width: usize,
        /// Its rows.
        found_height: usize,
        /// The camera's columns.
        width: usize,
        /// The camera's rows.
        height: usize,
    },
}
