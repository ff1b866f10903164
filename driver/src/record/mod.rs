//! Recordings of what a source delivers: the TUM layout, an LCM log, an MCAP
//! file, or a dump for fakenect.
//!
//! What was written is readable at any moment: pictures come before the lines that name them, and
//! what a full disk cuts short is removed.

mod fakenect;
mod lcm_log;
mod mcap;
mod recorder;
mod ros2_messages;
mod tum;

pub use fakenect::FakenectRecorder;
pub use lcm_log::LogRecorder;
pub use mcap::McapRecorder;
pub use recorder::{RecordError, Recorder};
pub use tum::TumRecorder;

use std::path::Path;

/// How a recording is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordFormat {
    /// TUM layout with PNG pictures: nothing is lost.
    Tum,
    /// TUM layout with JPEG colour.
    TumJpeg,
    /// LCM event log of `kinect.frame_msg_t`.
    LcmLog,
    /// MCAP file of ROS 2 messages.
    Mcap,
    /// A folder that fakenect plays: disparities of 11 bits.
    Fakenect,
}

/// Starts a recording at a path: a folder, or a file for a log.
///
/// # Errors
/// [`RecordError`] when something is there already or nothing can be written.
pub fn create(path: &Path, format: RecordFormat) -> Result<Box<dyn Recorder>, RecordError> {
    Ok(match format {
        RecordFormat::Tum => Box::new(TumRecorder::create(path, "png")?),
        RecordFormat::TumJpeg => Box::new(TumRecorder::create(path, "jpg")?),
        RecordFormat::LcmLog => Box::new(LogRecorder::create(path)?),
        RecordFormat::Mcap => Box::new(McapRecorder::create(path)?),
        RecordFormat::Fakenect => Box::new(FakenectRecorder::create(path)?),
    })
}
