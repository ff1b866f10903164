//! An observer of the service in the same process: it receives the frames that the service processes,
//! and an event for each result.
//!
//! In: what the threads of the service hand over. Out: two bounded queues. A viewer that reads slowly
//! or not at all loses the oldest entries; it never blocks a thread of the service. Without a viewer
//! nothing is kept.

use crate::plan::Prediction;
use linkage_driver::RgbdFrame;
use linkage_driver::live::{LatestReader, LatestWriter, RecvError, latest};
use linkage_skill::recognise::Recognition;
use linkage_skill::{ObjectModel, Pose};
use nalgebra::Point3;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

/// Frames that wait for the viewer; when more come, the oldest are dropped.
const WAITING_FRAMES: usize = 4;
/// Events that wait for the viewer; when more come, the oldest are dropped.
const WAITING_EVENTS: usize = 64;

/// A result of the service.
#[derive(Debug, Clone)]
pub struct Event {
    /// Time of the frame that it is about, microseconds.
    pub utime: i64,
    /// Which result.
    pub kind: EventKind,
}

/// The kinds of results.
#[derive(Debug, Clone)]
pub enum EventKind {
    /// Points that are tracked in a demonstration, camera frame, metres.
    Tracked(Vec<Point3<f64>>),
    /// The current estimate while a demonstration runs.
    Estimated {
        /// The joints that are found so far.
        model: ObjectModel,
        /// Pose of the object in that frame.
        camera_from_object: Pose,
    },
    /// The result of a demonstration.
    Learned {
        /// The model, in this demonstration's object frame.
        model: ObjectModel,
        /// `camera_from_part` in that frame, where it is known.
        camera_from_part: Vec<Option<Pose>>,
        /// Points that were tracked, camera frame, metres, with their parts where these are known.
        points: Vec<(Option<usize>, Point3<f64>)>,
    },
    /// The objects that are recognised.
    Recognised(Recognition),
    /// How a recognised object will move.
    Predicted(Prediction),
    /// An answer to a command, or an error.
    Message {
        /// It is an error, or the command was refused.
        is_warning: bool,
        /// The text.
        text: String,
    },
}

/// The service's end of the queues. One that is made by `default` has no viewer.
#[derive(Clone, Default)]
pub struct Observer(Option<Queues>);

#[derive(Clone)]
struct Queues {
    frames: LatestWriter<RgbdFrame>,
    events: LatestWriter<Event>,
    /// Time of the newest frame.
    newest_utime: Arc<AtomicI64>,
}

/// The viewer's end of the queues.
pub struct Observations {
    frames: LatestReader<RgbdFrame>,
    events: LatestReader<Event>,
}

/// What the viewer reads.
pub enum Observation {
    /// A frame.
    Frame(RgbdFrame),
    /// A result.
    Event(Event),
}

/// Makes the queues: the service's end and the viewer's.
pub fn observer() -> (Observer, Observations) {
    let (frame_writer, frames) = latest(WAITING_FRAMES);
    let (event_writer, events) = latest(WAITING_EVENTS);
    let newest_utime = Arc::new(AtomicI64::new(0));
    let queues = Queues { frames: frame_writer, events: event_writer, newest_utime };
    (Observer(Some(queues)), Observations { frames, events })
}

impl Observer {
    /// Hands over a frame.
    pub fn frame(&self, frame: RgbdFrame) {
        if let Some(queues) = &self.0 {
            queues.newest_utime.store(frame.utime, Ordering::Relaxed);
            queues.frames.push(frame);
        }
    }

    /// Hands over the result for a frame. `kind` is called only where there is a viewer.
    pub fn event(&self, utime: i64, kind: impl FnOnce() -> EventKind) {
        if let Some(queues) = &self.0 {
            queues.events.push(Event { utime, kind: kind() });
        }
    }

    /// Hands over a message, with the time of the newest frame. `text` is called only where there is a
    /// viewer.
    pub fn message(&self, is_warning: bool, text: impl FnOnce() -> String) {
        if let Some(queues) = &self.0 {
            let utime = queues.newest_utime.load(Ordering::Relaxed);
            let kind = EventKind::Message { is_warning, text: text() };
            queues.events.push(Event { utime, kind });
        }
    }
}

impl Observations {
    /// The next event, else the next frame.
    ///
    /// # Errors
    /// [`RecvError`] when none came in time, or when the service has ended.
    pub fn next(&self, timeout: Duration) -> Result<Observation, RecvError> {
        match self.events.pop(Duration::ZERO) {
            Ok(event) => Ok(Observation::Event(event)),
            Err(_) => self.frames.pop(timeout).map(Observation::Frame),
        }
    }

    /// Number of frames and events that were dropped.
    pub fn dropped(&self) -> u64 {
        self.frames.dropped() + self.events.dropped()
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
    fn a_viewer_that_does_not_read_loses_the_oldest_frames_and_events() {
        let (observer, observations) = observer();
        (0..100).for_each(|utime| observer.frame(frame(utime)));
        (0..100).for_each(|i| observer.message(false, || i.to_string()));
        let (mut frames, mut messages) = (Vec::new(), Vec::new());
        while let Ok(observation) = observations.next(Duration::ZERO) {
            match observation {
                Observation::Frame(frame) => frames.push(frame.utime),
                Observation::Event(event) => messages.push(event.utime),
            }
        }
        assert_eq!(frames, [96, 97, 98, 99]);
        // A message has the time of the newest frame.
        assert_eq!(messages, vec![99; WAITING_EVENTS]);
        assert_eq!(observations.dropped(), 96 + 100 - WAITING_EVENTS as u64);
    }

    #[test]
    fn no_event_is_made_without_a_viewer() {
        let observer = Observer::default();
        observer.event(0, || unreachable!("there is no viewer"));
    }

    #[test]
    fn a_viewer_is_told_when_the_service_has_ended() {
        let (observer, observations) = observer();
        drop(observer);
        assert_eq!(observations.next(Duration::ZERO).err(), Some(RecvError::Closed));
    }
}
