//! What every source of frames offers.

use crate::error::SourceError;
use crate::statistics::SourceStatistics;
use linkage_frames::frame::RgbdFrame;
use std::time::Duration;

/// What waiting for a frame gave.
#[derive(Debug)]
pub enum Awaited {
    /// A frame.
    Frame(RgbdFrame),
    /// None came in time; one may come later.
    Nothing,
    /// None will come any more.
    End,
}

/// Where frames come from: a live camera or a recording.
pub trait RgbdSource: Send {
    /// Blocks until the next frame; `Ok(None)` once a recording has ended.
    ///
    /// # Errors
    /// [`SourceError`] names what could not be read.
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError>;

    /// The same, but waits no longer than it is told for a live camera that is silent.
    /// Recordings do not wait: theirs is the next frame.
    ///
    /// # Errors
    /// As [`Self::next_frame`].
    fn next_frame_within(&mut self, _timeout: Duration) -> Result<Awaited, SourceError> {
        Ok(self.next_frame()?.map_or(Awaited::End, Awaited::Frame))
    }

    /// Frames in all, where that is known.
    fn frame_count(&self) -> Option<usize>;

    /// Name for logs and provenance.
    fn name(&self) -> &str;

    /// True for a camera that goes on until it is stopped.
    fn is_live(&self) -> bool {
        false
    }

    /// What was delivered and what was lost so far.
    fn statistics(&self) -> SourceStatistics;
}
