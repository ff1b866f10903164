//! A source whose frames are shown as they are taken.

use linkage_driver::{RgbdFrame, RgbdSource, WrappedSource};

/// Shows each frame of a source before it is handed on.
pub fn watched(
    source: impl RgbdSource + 'static,
    mut show: impl FnMut(&RgbdFrame) + Send,
) -> impl RgbdSource {
    WrappedSource::new(Box::new(source), move |source| {
        let frame = source.next_frame()?;
        frame.iter().for_each(&mut show);
        Ok(frame)
    })
}
