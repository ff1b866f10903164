//! Bounded queues without locks whose writer never waits, and the one between the capture thread
//! and whoever takes the frames.

use crate::rgbd_source::Awaited;
use crate::statistics::SourceStatistics;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use linkage_frames::frame::RgbdFrame;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// What is told where the capture thread ended without a word.
const FAILED: &str =
    "its capture thread failed, which is a fault of this program: report it with the log";

/// A queue with room for this many, at least one; when it is full, a new one replaces the oldest.
pub fn latest<T>(capacity: usize) -> (LatestWriter<T>, LatestReader<T>) {
    let (sender, receiver) = bounded(capacity.max(1));
    let dropped = Arc::new(AtomicU64::new(0));
    let reader = LatestReader { receiver: receiver.clone(), dropped: Arc::clone(&dropped) };
    (LatestWriter { sender, oldest: receiver, dropped }, reader)
}

/// The writer's end; the queue is closed once every one is gone.
pub struct LatestWriter<T> {
    sender: Sender<T>,
    oldest: Receiver<T>,
    dropped: Arc<AtomicU64>,
}

impl<T> Clone for LatestWriter<T> {
    fn clone(&self) -> Self {
        Self {
            sender: self.sender.clone(),
            oldest: self.oldest.clone(),
            dropped: Arc::clone(&self.dropped),
        }
    }
}

impl<T> LatestWriter<T> {
    /// Adds one; never waits.
    pub fn push(&self, value: T) {
        let mut value = value;
        while let Err(full) = self.sender.try_send(value) {
            value = full.into_inner();
            if self.oldest.try_recv().is_ok() {
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

/// The reader's end.
pub struct LatestReader<T> {
    receiver: Receiver<T>,
    dropped: Arc<AtomicU64>,
}

/// Why a reader was given nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecvError {
    /// None came in time.
    Timeout,
    /// None will come any more.
    Closed,
}

impl<T> LatestReader<T> {
    /// The oldest, as soon as there is one.
    ///
    /// # Errors
    /// [`RecvError`]: none came in time, or none will any more.
    pub fn pop(&self, timeout: Duration) -> Result<T, RecvError> {
        self.receiver.recv_timeout(timeout).map_err(|e| match e {
            RecvTimeoutError::Timeout => RecvError::Timeout,
            RecvTimeoutError::Disconnected => RecvError::Closed,
        })
    }

    /// How many were dropped.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

/// What the two ends share besides the frames.
#[derive(Default)]
struct Shared {
    /// Why no more came, nothing at a recording's end; unset where the capture thread has failed.
    end: OnceLock<Option<String>>,
    source: Mutex<SourceStatistics>,
    /// When the capture thread was last seen to work.
    beat: Mutex<Option<Instant>>,
}

/// The capture thread's end of the queue of frames.
pub struct FrameWriter {
    frames: LatestWriter<RgbdFrame>,
    shared: Arc<Shared>,
}

/// The other end.
pub struct FrameReader {
    frames: LatestReader<RgbdFrame>,
    shared: Arc<Shared>,
    delivered: u64,
}

/// A queue of frames.
pub fn frame_queue(capacity: usize) -> (FrameWriter, FrameReader) {
    let (writer, reader) = latest(capacity);
    let shared = Arc::new(Shared::default());
    let reader = FrameReader { frames: reader, shared: Arc::clone(&shared), delivered: 0 };
    (FrameWriter { frames: writer, shared }, reader)
}

impl FrameWriter {
    /// Adds a frame; never waits.
    pub fn push(&self, frame: RgbdFrame) {
        self.frames.push(frame);
    }

    /// Keeps what the capture thread has counted.
    pub fn note(&self, source: &SourceStatistics) {
        *self.shared.source.lock().unwrap_or_else(PoisonError::into_inner) = *source;
    }

    /// No more will come; what waits can still be taken.
    pub fn close(self, failure: Option<String>) {
        // Only this end sets it, and it ends here.
        let _ = self.shared.end.set(failure);
    }

    /// The capture thread works: it is not held up by the camera's driver.
    pub fn beat(&self) {
        *self.shared.beat.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    }

    /// Frames that were dropped for newer ones.
    pub fn dropped(&self) -> u64 {
        self.frames.dropped.load(Ordering::Relaxed)
    }
}

impl FrameReader {
    /// Waits for the next frame; `Err` with the reason after a failure.
    pub fn pop(&mut self, timeout: Duration) -> Result<Awaited, String> {
        match self.frames.pop(timeout) {
            Ok(frame) => {
                self.delivered += 1;
                Ok(Awaited::Frame(frame))
            }
            Err(RecvError::Timeout) => Ok(Awaited::Nothing),
            Err(RecvError::Closed) => match self.shared.end.get() {
                Some(None) => Ok(Awaited::End),
                Some(Some(reason)) => Err(reason.clone()),
                None => Err(FAILED.to_owned()),
            },
        }
    }

    /// For how long the capture thread has been held up; `None` before it began.
    pub fn silent_for(&self) -> Option<Duration> {
        let beat = *self.shared.beat.lock().unwrap_or_else(PoisonError::into_inner);
        Some(beat?.elapsed())
    }

    /// All counts.
    pub fn statistics(&self) -> SourceStatistics {
        let source = *self.shared.source.lock().unwrap_or_else(PoisonError::into_inner);
        SourceStatistics { delivered: self.delivered, dropped: self.frames.dropped(), ..source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Duration = Duration::from_millis(1);

    #[test]
    fn the_oldest_gives_way_when_there_is_no_room() {
        let (writer, reader) = latest(2);
        (1..=4).for_each(|n| writer.push(n));
        assert_eq!((reader.pop(SHORT), reader.pop(SHORT)), (Ok(3), Ok(4)));
        assert_eq!(reader.dropped(), 2);
    }

    #[test]
    fn an_empty_queue_is_told_from_a_closed_one() {
        let (writer, reader) = latest::<u8>(0);
        assert_eq!(reader.pop(SHORT), Err(RecvError::Timeout));
        let another = writer.clone();
        drop(writer);
        assert_eq!(reader.pop(SHORT), Err(RecvError::Timeout), "one writer is left");
        another.push(7);
        drop(another);
        assert_eq!(reader.pop(SHORT), Ok(7), "what waits can still be taken");
        assert_eq!(reader.pop(SHORT), Err(RecvError::Closed));
    }

    #[test]
    fn a_failure_is_told_once_the_frames_are_taken() {
        let (writer, mut reader) = frame_queue(1);
        writer.close(Some("the cable was pulled".to_owned()));
        assert_eq!(reader.pop(SHORT).err().as_deref(), Some("the cable was pulled"));
        let (writer, mut reader) = frame_queue(1);
        writer.close(None);
        assert!(matches!(reader.pop(SHORT), Ok(Awaited::End)));
    }

    #[test]
    fn a_capture_thread_that_failed_is_no_end_of_a_recording() {
        let (writer, mut reader) = frame_queue(1);
        drop(writer);
        assert_eq!(reader.pop(SHORT).err().as_deref(), Some(FAILED));
    }
}
