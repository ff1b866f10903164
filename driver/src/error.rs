//! What can be wrong with a picture, a frame, or a source.

/// A frame whose parts do not fit each other.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
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

/// What is wrong with an encoded picture.
#[derive(Debug, thiserror::Error)]
pub enum PictureFault {
    /// It cannot be read, is damaged, or is of another format.
    #[error("{0}")]
    Damaged(String),
    /// It is not of the size that is expected.
    #[error("{0}")]
    Size(#[from] FrameError),
}

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
    /// A device or network cannot be used, or not any more.
    #[error("{name}: {reason}")]
    Device {
        /// The source.
        name: String,
        /// What is wrong and what to do.
        reason: String,
    },
}
