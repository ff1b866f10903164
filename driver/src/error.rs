//! What can be wrong with a picture or a source.

pub use linkage_frames::FrameError;

/// What is wrong with an encoded picture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
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
#[non_exhaustive]
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
    /// A camera's driver does not return.
    #[error(
        "{name}: its driver has not returned for {seconds} s: unplug the camera and start again"
    )]
    Hangs {
        /// The source.
        name: String,
        /// For how long.
        seconds: u64,
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
