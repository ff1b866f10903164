//! A source whose frames are shown as they are taken.

use linkage_driver::{RgbdFrame, RgbdSource, SourceError, SourceStatistics};

/// A source, and who is shown its frames.
pub struct Watched<S, F> {
    source: S,
    show: F,
}

impl<S: RgbdSource, F: FnMut(&RgbdFrame) + Send> Watched<S, F> {
    /// Shows each frame of a source before it is handed on.
    pub fn new(source: S, show: F) -> Self {
        Self { source, show }
    }
}

impl<S: RgbdSource, F: FnMut(&RgbdFrame) + Send> RgbdSource for Watched<S, F> {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        let frame = self.source.next_frame()?;
        if let Some(frame) = &frame {
            (self.show)(frame);
        }
        Ok(frame)
    }

    fn frame_count(&self) -> Option<usize> {
        self.source.frame_count()
    }

    fn name(&self) -> &str {
        self.source.name()
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }

    fn statistics(&self) -> SourceStatistics {
        self.source.statistics()
    }
}
