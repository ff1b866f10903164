//! The thread that captures: a camera at its own pace, a recording at that of its time stamps.

use super::config::{Playback, SourceOpener};
use super::publisher::{Note, Outbox};
use linkage_driver::live::LatestWriter;
use linkage_driver::{Awaited, RgbdFrame, RgbdSource, SourceError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A frame, and when it came.
#[derive(Clone)]
pub struct Arrived {
    pub frame: RgbdFrame,
    pub at: Instant,
}

/// How many frames did not arrive, were damaged, or found no room before they were taken; and whether the camera
/// can give any.
#[derive(Debug, Clone, Default)]
pub struct Lost {
    count: Arc<AtomicU64>,
    hangs: Arc<AtomicBool>,
}

impl Lost {
    /// Their number since the service began.
    pub fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Its driver does not return: this process cannot help it.
    pub fn camera_hangs(&self) -> bool {
        self.hangs.load(Ordering::Relaxed)
    }

    fn set(&self, count: u64) {
        self.count.store(count, Ordering::Relaxed);
    }
}

pub struct Capture {
    source: Box<dyn RgbdSource>,
    open: Box<SourceOpener>,
    playback: Playback,
    frames: LatestWriter<Arrived>,
    out: Outbox,
    lost: Lost,
    /// Frames that were lost by sources that were closed.
    lost_before: u64,
    /// Time stamps of a recording that is repeated go on.
    clock: PlayClock,
}

/// Wait before a lost source is opened again.
const REOPEN_AFTER: Duration = Duration::from_secs(1);
/// Longest sleep before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(50);

impl Capture {
    pub fn new(
        source: Box<dyn RgbdSource>,
        open: Box<SourceOpener>,
        playback: Playback,
        frames: LatestWriter<Arrived>,
        out: Outbox,
    ) -> Self {
        let (lost, lost_before, clock) = (Lost::default(), 0, PlayClock::default());
        Self { source, open, playback, frames, out, lost, lost_before, clock }
    }

    /// The count of frames that do not arrive.
    pub fn lost(&self) -> Lost {
        self.lost.clone()
    }

    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) {
        let mut has_frames = false;
        while !is_stopped() {
            let next = self.source.next_frame_within(POLL);
            self.lost.set(self.lost_before + self.source.statistics().lost());
            let hangs = matches!(next, Err(SourceError::Hangs { .. }));
            self.lost.hangs.store(hangs, Ordering::Relaxed);
            match next {
                Ok(Awaited::Frame(frame)) => {
                    has_frames = true;
                    self.take(frame, is_stopped);
                }
                Ok(Awaited::Nothing) => {}
                Ok(Awaited::End) if is_stopped() => return,
                Ok(Awaited::End) if self.playback.repeat => {
                    // One without frames would be opened again and again.
                    let wait = if has_frames { Duration::ZERO } else { REOPEN_AFTER };
                    has_frames = false;
                    self.reopen(wait, is_stopped);
                }
                Ok(Awaited::End) => {
                    self.out.note(Note::Error(format!("{}: it is over", self.source.name())));
                    return;
                }
                Err(e) => {
                    self.out.note(Note::Error(e.to_string()));
                    if hangs {
                        // Its driver still has the camera: it cannot be opened a second time, and may come back.
                        sleep_until(Instant::now().checked_add(REOPEN_AFTER), is_stopped);
                        continue;
                    }
                    if !self.source.is_live() {
                        return;
                    }
                    self.reopen(REOPEN_AFTER, is_stopped);
                }
            }
        }
    }

    fn take(&mut self, mut frame: RgbdFrame, is_stopped: &dyn Fn() -> bool) {
        if !self.source.is_live() {
            frame.utime = self.clock.stamp(frame.utime);
            if self.playback.rate > 0.0 {
                sleep_until(self.clock.due(frame.utime, self.playback.rate), is_stopped);
            }
        }
        self.frames.push(Arrived { frame, at: Instant::now() });
    }

    fn reopen(&mut self, wait: Duration, is_stopped: &dyn Fn() -> bool) {
        sleep_until(Instant::now().checked_add(wait), is_stopped);
        while !is_stopped() {
            match (self.open)() {
                Ok(source) => {
                    self.source = source;
                    self.lost_before = self.lost.count();
                    self.clock.again();
                    return;
                }
                Err(e) => self.out.note(Note::Error(e.to_string())),
            }
            sleep_until(Instant::now().checked_add(REOPEN_AFTER), is_stopped);
        }
    }
}

/// `due` is `None` for what never comes.
fn sleep_until(due: Option<Instant>, is_stopped: &dyn Fn() -> bool) {
    while !is_stopped() {
        let left = due.map_or(POLL, |due| due.saturating_duration_since(Instant::now()));
        if left.is_zero() {
            return;
        }
        std::thread::sleep(left.min(POLL));
    }
}

/// Time of a recording that is played, perhaps more than once.
#[derive(Debug, Default)]
struct PlayClock {
    /// Added to the recording's own time stamps; not known before the first frame of a round.
    shift: Option<i64>,
    last: Option<i64>,
    period: i64,
    start: Option<(i64, Instant)>,
}

/// Time between rounds where a recording of one frame tells none.
const DEFAULT_PERIOD_US: i64 = 33_333;

impl PlayClock {
    /// The next frame begins a new round.
    fn again(&mut self) {
        self.shift = None;
    }

    /// A time stamp in time that goes on from round to round.
    fn stamp(&mut self, utime: i64) -> i64 {
        let period = if self.period > 0 { self.period } else { DEFAULT_PERIOD_US };
        let next = self.last.map(|last| last.saturating_add(period));
        let shift =
            *self.shift.get_or_insert_with(|| next.map_or(0, |next| next.saturating_sub(utime)));
        let stamp = utime.saturating_add(shift);
        if let Some(last) = self.last {
            self.period = stamp.saturating_sub(last);
        }
        self.last = Some(stamp);
        stamp
    }

    /// When a stamp is due at a rate; `None` where that is farther away than a clock goes.
    fn due(&mut self, stamp: i64, rate: f64) -> Option<Instant> {
        let (first, start) = *self.start.get_or_insert_with(|| (stamp, Instant::now()));
        let seconds = stamp.saturating_sub(first).max(0) as f64 * 1e-6 / rate;
        start.checked_add(Duration::try_from_secs_f64(seconds).ok()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_when_a_recording_is_played_again() {
        let mut clock = PlayClock::default();
        let mut stamps: Vec<i64> = [100, 200, 300].map(|t| clock.stamp(t)).to_vec();
        clock.again();
        stamps.extend([100, 200].map(|t| clock.stamp(t)));
        assert_eq!(stamps, [100, 200, 300, 400, 500]);
    }

    #[test]
    fn frames_are_due_in_the_recordings_time() {
        let mut clock = PlayClock::default();
        let first = clock.due(1_000_000, 2.0).unwrap();
        assert_eq!(clock.due(3_000_000, 2.0).unwrap() - first, Duration::from_secs(1));
        assert_eq!(clock.due(0, 2.0).unwrap(), first);
    }

    #[test]
    fn a_frame_that_is_never_due_is_waited_for_until_the_service_ends() {
        let mut clock = PlayClock::default();
        let [first, last] = [0, i64::MAX].map(|utime| clock.stamp(utime));
        assert!(clock.due(first, 1e-300).is_some());
        assert_eq!(clock.due(last, 1e-300), None);
        let start = Instant::now();
        sleep_until(None, &|| start.elapsed() > 3 * POLL);
        assert!(start.elapsed() > 3 * POLL);
    }
}
