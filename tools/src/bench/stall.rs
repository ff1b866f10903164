//! A source whose frames stop coming for a while, as those of a camera that stalls.

use linkage_driver::WrappedSource;
use linkage_planner_bridge::service::SourceOpener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between two looks whether frames come again.
const POLL: Duration = Duration::from_millis(10);

/// Frames do not come while it is set.
#[derive(Clone, Default)]
pub struct Stall(Arc<AtomicBool>);

impl Stall {
    pub fn set(&self, is_stalled: bool) {
        self.0.store(is_stalled, Ordering::Relaxed);
    }

    /// Opens a source that stalls.
    pub fn opener(&self, mut open: Box<SourceOpener>) -> Box<SourceOpener> {
        let stall = self.clone();
        Box::new(move || {
            let stall = stall.clone();
            Ok(Box::new(WrappedSource::new(open()?, move |source| {
                while stall.0.load(Ordering::Relaxed) {
                    std::thread::sleep(POLL);
                }
                source.next_frame()
            })))
        })
    }
}
