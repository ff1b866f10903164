//! What a service shows to a viewer in its own process: the frames that it looks at, and what it
//! finds in them.
//!
//! In: whatever the service's threads hand over. Out: two bounded queues. A viewer that is slow or
//! away loses the oldest; it never holds a thread of the service up. Without a viewer nothing is
//! kept.

use crate::plan::Prediction;
use linkage_driver::RgbdFrame;
use linkage_driver::live::{LatestReader, LatestWriter, RecvError, latest};
use linkage_skill::ObjectModel;
use linkage_skill::Pose;
use linkage_skill::recognise::Recognition;
use nalgebra::Point3;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

/// Frames that wait for a viewer; more push out the oldest.
const WAITING_FRAMES: usize = 4;
/// Findings that wait for it; more push out the oldest.
const WAITING_FINDINGS: usize = 64;

/// Something that a service found.
#[derive(Debug, Clone)]
pub struct Finding {
    /// Time of the frame that it was found in, microseconds.
    pub utime: i64,
    /// What it is.
    pub what: Found,
}

/// What a service finds.
#[derive(Debug, Clone)]
pub enum Found {
    /// Places that are followed in a demonstration, camera frame, metres.
    Followed(Vec<Point3<f64>>),
    /// The best guess while a demonstration runs.
    Estimated {
        /// Joints so far.
        model: ObjectModel,
        /// Where the object frame is in that frame.
        camera_from_object: Pose,
    },
    /// What came of a demonstration.
    Learned {
        /// The model, in this demonstration's object frame.
        model: ObjectModel,
        /// `camera_from_part` in that frame, where it is known.
        camera_from_part: Vec<Option<Pose>>,
        /// Places that were followed, camera frame, metres, with their parts where these are known.
        places: Vec<(Option<usize>, Point3<f64>)>,
    },
    /// What is recognised.
    Recognised(Recognition),
    /// How it is going to move.
    Predicted(Prediction),
    /// An answer to a command, or an error.
    Said {
        /// Something went wrong.
        is_warning: bool,
        /// What was said.
        text: String,
    },
}

/// The service's end; nothing is shown by one that was made by `default`.
#[derive(Clone, Default)]
pub struct Witness(Option<Queues>);

#[derive(Clone)]
struct Queues {
    frames: LatestWriter<RgbdFrame>,
    findings: LatestWriter<Finding>,
    /// Time of the newest frame that was shown.
    newest_utime: Arc<AtomicI64>,
}

/// The viewer's end.
pub struct Sights {
    frames: LatestReader<RgbdFrame>,
    findings: LatestReader<Finding>,
}

/// What a viewer is given.
pub enum Sight {
    /// A frame.
    Frame(RgbdFrame),
    /// What was found in one.
    Finding(Finding),
}

/// The two ends of what a service shows.
pub fn witness() -> (Witness, Sights) {
    let (frame_writer, frames) = latest(WAITING_FRAMES);
    let (finding_writer, findings) = latest(WAITING_FINDINGS);
    let newest_utime = Arc::new(AtomicI64::new(0));
    let queues = Queues { frames: frame_writer, findings: finding_writer, newest_utime };
    (Witness(Some(queues)), Sights { frames, findings })
}

impl Witness {
    /// Shows a frame.
    pub fn frame(&self, frame: RgbdFrame) {
        if let Some(queues) = &self.0 {
            queues.newest_utime.store(frame.utime, Ordering::Relaxed);
            queues.frames.push(frame);
        }
    }

    /// Shows what was found in a frame; it is made only where somebody looks.
    pub fn found(&self, utime: i64, what: impl FnOnce() -> Found) {
        if let Some(queues) = &self.0 {
            queues.findings.push(Finding { utime, what: what() });
        }
    }

    /// Says something, at the time of the newest frame; it is made only where somebody looks.
    pub fn say(&self, is_warning: bool, text: impl FnOnce() -> String) {
        if let Some(queues) = &self.0 {
            let utime = queues.newest_utime.load(Ordering::Relaxed);
            let what = Found::Said { is_warning, text: text() };
            queues.findings.push(Finding { utime, what });
        }
    }
}

impl Sights {
    /// The next finding, else the next frame.
    ///
    /// # Errors
    /// [`RecvError`]: none came in time, or none will come any more.
    pub fn next(&self, timeout: Duration) -> Result<Sight, RecvError> {
        match self.findings.pop(Duration::ZERO) {
            Ok(finding) => Ok(Sight::Finding(finding)),
            Err(_) => self.frames.pop(timeout).map(Sight::Frame),
        }
    }

    /// Frames and findings that a slow viewer lost.
    pub fn dropped(&self) -> u64 {
        self.frames.dropped() + self.findings.dropped()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera};

    fn frame(utime: i64) -> RgbdFrame {
        let camera =
            PinholeCamera { width: 2, height: 1, cx: 0.5, cy: 0.0, ..PinholeCamera::kinect() };
        let color = ColorImage::new(2, 1, vec![0; 6]).unwrap();
        let depth = DepthImage::from_raw(2, 1, &[1, 1], 1000.0).unwrap();
        RgbdFrame::new(utime, Arc::new(camera), color, depth).unwrap()
    }

    #[test]
    fn a_viewer_that_does_not_look_loses_the_oldest_frames_and_findings() {
        let (witness, sights) = witness();
        (0..100).for_each(|utime| witness.frame(frame(utime)));
        (0..100).for_each(|i| witness.say(false, || i.to_string()));
        let (mut frames, mut said) = (Vec::new(), Vec::new());
        while let Ok(sight) = sights.next(Duration::ZERO) {
            match sight {
                Sight::Frame(frame) => frames.push(frame.utime),
                Sight::Finding(finding) => said.push(finding.utime),
            }
        }
        assert_eq!(frames, [96, 97, 98, 99]);
        // What is said has the time of the newest frame.
        assert_eq!(said, vec![99; WAITING_FINDINGS]);
        assert_eq!(sights.dropped(), 96 + 100 - WAITING_FINDINGS as u64);
    }

    #[test]
    fn nothing_is_made_where_nobody_looks() {
        let witness = Witness::default();
        witness.found(0, || unreachable!("nobody looks"));
    }

    #[test]
    fn a_viewer_is_told_when_the_service_is_over() {
        let (witness, sights) = witness();
        drop(witness);
        assert_eq!(sights.next(Duration::ZERO).err(), Some(RecvError::Closed));
    }
}
