//! Around every live camera: a thread that captures, a bounded queue that drops the oldest, a
//! watchdog, and reconnection with exponential back-off.

mod clock;
mod pairing;
mod queue;

pub use clock::{DeviceClock, host_utime};
pub use pairing::{Paired, Pairing};

use crate::error::SourceError;
use crate::rgbd_source::{Awaited, RgbdSource};
use crate::statistics::SourceStatistics;
use crate::timestamp_filter::{Timeline, TimestampFilter};
use linkage_frames::frame::RgbdFrame;
use queue::{FrameReader, FrameWriter, frame_queue};
pub use queue::{LatestReader, LatestWriter, RecvError, latest};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A camera that is open.
pub trait Camera: Send {
    /// Waits for the next frame, at most about as long as it is told; `None` when none came.
    ///
    /// # Errors
    /// Why the camera is lost.
    fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault>;

    /// Pictures of colour or depth that found no partner so far, and the largest difference
    /// of time within a pair, microseconds.
    fn pairing(&self) -> (u64, i64) {
        (0, 0)
    }

    /// Frames that were sent to this camera and did not arrive, as far as it can tell.
    fn missing(&self) -> u64 {
        0
    }
}

/// What a camera says when it delivers no frame.
#[derive(Debug)]
pub enum CameraFault {
    /// One frame could not be read; the next may.
    Damaged(String),
    /// The camera is gone and must be opened again.
    Lost(String),
    /// What it delivers cannot be used, however often it is opened.
    Unusable(String),
    /// It has come to its end, as recordings do.
    Ended,
}

/// Opens a camera, again after it was lost.
pub type Opener = dyn FnMut() -> Result<Box<dyn Camera>, SourceError> + Send;

/// How a live camera is watched.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveConfig {
    /// Frames that wait to be taken; when more come, the oldest are dropped.
    pub queue: usize,
    /// Silence after which the camera is closed and opened again.
    pub stall: Duration,
    /// First and longest wait before it is opened again; each failure doubles it.
    pub backoff: [Duration; 2],
    /// A camera that gives no frame for this long, however often it is opened, ends the source
    /// with an error.
    pub give_up: Duration,
    /// A capture thread that is held up for this long hangs in its camera's driver: to open a camera takes some seconds.
    pub hangs: Duration,
}

impl LiveConfig {
    /// For a network, where silence is no fault: the camera may be switched on later.
    pub fn for_network(&self) -> Self {
        Self { stall: Duration::MAX, give_up: Duration::MAX, ..self.clone() }
    }
}

impl Default for LiveConfig {
    fn default() -> Self {
        Self {
            queue: 4,
            stall: Duration::from_secs(2),
            backoff: [Duration::from_millis(100), Duration::from_secs(5)],
            give_up: Duration::from_secs(30),
            hangs: Duration::from_secs(20),
        }
    }
}

/// A camera with its thread and queue.
pub struct LiveSource {
    name: String,
    queue: FrameReader,
    dropped: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    hangs: Duration,
    stop: Arc<AtomicBool>,
}

/// Longest wait for a frame before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(100);

/// How long a reader waits at a time; it is woken as soon as there is something.
const WAIT: Duration = Duration::from_secs(1);

/// How long the end of a capture thread is waited for: one that hangs is left alone.
const LONGEST_END: Duration = Duration::from_secs(2);

/// How often the log is told what was delivered and lost.
const REPORT_EVERY: Duration = Duration::from_secs(10);

impl LiveSource {
    /// Opens the camera and starts to capture; once `stop` is set the source ends as a
    /// recording does.
    ///
    /// # Errors
    /// What the opener says the first time; later failures are retried.
    pub fn start(
        name: &str,
        mut opener: Box<Opener>,
        config: LiveConfig,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let camera = opener()?;
        let (writer, reader) = frame_queue(config.queue);
        let (hangs, user_stop) = (config.hangs, Arc::clone(&stop));
        let dropped = Arc::new(AtomicBool::new(false));
        let watch = Watch {
            name: name.to_owned(),
            opener,
            config,
            queue: writer,
            stop: [stop, Arc::clone(&dropped)],
            timestamps: TimestampFilter::new(Timeline::AsSent),
            unpaired_before: 0,
            missing_before: 0,
            last_frame: Instant::now(),
            last_report: Instant::now(),
            last_damage: None,
        };
        let thread = std::thread::Builder::new()
            .name("capture".to_owned())
            .spawn(move || watch.run(camera))
            .map_err(|e| SourceError::Device { name: name.to_owned(), reason: e.to_string() })?;
        let (name, thread) = (name.to_owned(), Some(thread));
        Ok(Self { name, queue: reader, dropped, thread, hangs, stop: user_stop })
    }
}

impl RgbdSource for LiveSource {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        loop {
            match self.next_frame_within(WAIT)? {
                Awaited::Frame(frame) => return Ok(Some(frame)),
                Awaited::Nothing => {}
                Awaited::End => return Ok(None),
            }
        }
    }

    fn next_frame_within(&mut self, timeout: Duration) -> Result<Awaited, SourceError> {
        let fault = |reason| SourceError::Device { name: self.name.clone(), reason };
        let awaited = self.queue.pop(timeout).map_err(fault)?;
        let silent = self.queue.silent_for().unwrap_or_default();
        if !matches!(awaited, Awaited::Nothing) {
            return Ok(awaited);
        }
        if self.stop.load(Ordering::Relaxed) && silent > LONGEST_END {
            return Ok(Awaited::End);
        }
        if silent > self.hangs {
            return Err(SourceError::Hangs { name: self.name.clone(), seconds: silent.as_secs() });
        }
        Ok(awaited)
    }

    fn frame_count(&self) -> Option<usize> {
        None
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn is_live(&self) -> bool {
        true
    }

    fn statistics(&self) -> SourceStatistics {
        self.queue.statistics()
    }
}

impl Drop for LiveSource {
    fn drop(&mut self) {
        self.dropped.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else { return };
        let start = Instant::now();
        while !thread.is_finished() && start.elapsed() < LONGEST_END {
            std::thread::sleep(Duration::from_millis(5));
        }
        if !thread.is_finished() {
            tracing::error!(
                source = self.name,
                "the camera's driver hangs; its thread is left alone"
            );
        } else if thread.join().is_err() {
            tracing::error!(source = self.name, "the capture thread failed");
        }
    }
}

/// What the capture thread owns.
struct Watch {
    name: String,
    opener: Box<Opener>,
    config: LiveConfig,
    queue: FrameWriter,
    /// Either one ends it: the user's, or that nobody takes frames any more.
    stop: [Arc<AtomicBool>; 2],
    timestamps: TimestampFilter,
    /// Pictures without partner of cameras that were closed.
    unpaired_before: u64,
    /// Frames that did not arrive at cameras that were closed.
    missing_before: u64,
    last_frame: Instant,
    last_report: Instant,
    /// When damage was last told.
    last_damage: Option<Instant>,
}

/// Why a camera is not asked any more.
enum End {
    Stopped,
    Ended,
    Lost(String),
    Unusable(String),
}

impl Watch {
    fn run(mut self, mut camera: Box<dyn Camera>) {
        loop {
            let end = self.capture(&mut *camera);
            self.unpaired_before += camera.pairing().0;
            self.missing_before += camera.missing();
            drop(camera);
            match end {
                End::Stopped | End::Ended => return self.queue.close(None),
                End::Unusable(reason) => return self.queue.close(Some(reason)),
                End::Lost(reason) => {
                    tracing::warn!(source = self.name, reason, "camera lost; it is opened again");
                    match self.reopen(reason) {
                        Ok(again) => camera = again,
                        Err(reason) => return self.queue.close(reason),
                    }
                }
            }
        }
    }

    fn capture(&mut self, camera: &mut dyn Camera) -> End {
        let mut last = Instant::now();
        while !self.is_stopped() {
            self.queue.beat();
            let next = camera.next_frame(POLL);
            self.note_missing(camera.missing());
            match next {
                Ok(Some(frame)) => {
                    last = Instant::now();
                    self.take(frame, camera.pairing());
                }
                Ok(None) if last.elapsed() > self.config.stall => {
                    return End::Lost(format!("no frame for {:?}", self.config.stall));
                }
                Ok(None) => {}
                Err(CameraFault::Damaged(reason)) => {
                    last = Instant::now();
                    self.note_damage(&reason);
                }
                Err(CameraFault::Lost(reason)) => return End::Lost(reason),
                Err(CameraFault::Unusable(reason)) => return End::Unusable(reason),
                Err(CameraFault::Ended) => return End::Ended,
            }
        }
        End::Stopped
    }

    /// Tells what did not arrive, also where nothing arrives at all.
    fn note_missing(&mut self, missing: u64) {
        let missing = self.missing_before + missing;
        if missing != self.timestamps.statistics.missing {
            self.timestamps.statistics.missing = missing;
            self.queue.note(&self.timestamps.statistics);
        }
    }

    /// Counts a damaged frame, and says so now and then: all of them may be.
    fn note_damage(&mut self, reason: &str) {
        self.timestamps.statistics.damaged += 1;
        self.queue.note(&self.timestamps.statistics);
        if self.last_damage.is_none_or(|told| told.elapsed() > REPORT_EVERY) {
            self.last_damage = Some(Instant::now());
            let damaged = self.timestamps.statistics.damaged;
            tracing::warn!(source = self.name, damaged, reason, "damaged frame");
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.iter().any(|s| s.load(Ordering::Relaxed))
    }

    fn take(&mut self, frame: RgbdFrame, (unpaired, gap_us): (u64, i64)) {
        self.last_frame = Instant::now();
        let frame = self.timestamps.pass(frame, host_utime());
        let statistics = &mut self.timestamps.statistics;
        statistics.unpaired = self.unpaired_before + unpaired;
        statistics.largest_pair_gap_us = statistics.largest_pair_gap_us.max(gap_us);
        self.queue.note(statistics);
        if self.last_report.elapsed() > REPORT_EVERY {
            self.last_report = Instant::now();
            let statistics = SourceStatistics { dropped: self.queue.dropped(), ..*statistics };
            tracing::info!(source = self.name, ?statistics, "capturing");
        }
        if let Some(frame) = frame {
            self.queue.push(frame);
        }
    }

    /// Opens the camera again, with exponential back-off; `Err(None)` when told to stop.
    fn reopen(&mut self, lost: String) -> Result<Box<dyn Camera>, Option<String>> {
        let [mut wait, longest] = self.config.backoff;
        let mut reason = lost;
        while self.last_frame.elapsed() < self.config.give_up {
            let until = Instant::now() + wait.min(self.config.give_up);
            while Instant::now() < until {
                self.queue.beat();
                if self.is_stopped() {
                    return Err(None);
                }
                std::thread::sleep(POLL.min(until.saturating_duration_since(Instant::now())));
            }
            match (self.opener)() {
                Ok(camera) => {
                    self.timestamps.statistics.reconnections += 1;
                    self.queue.note(&self.timestamps.statistics);
                    tracing::info!(source = self.name, "camera is back");
                    return Ok(camera);
                }
                Err(e) => reason = e.to_string(),
            }
            wait = (2 * wait).min(longest);
        }
        Err(Some(format!("no frame for {:?}: {reason}", self.config.give_up)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_frames::camera::PinholeCamera;
    use linkage_frames::frame::{ColorImage, DepthImage};
    use std::collections::VecDeque;
    use std::sync::Mutex;

    /// What a scripted camera does next.
    #[derive(Clone, Copy)]
    enum Act {
        Frame(i64),
        Damaged,
        /// Frames do not arrive.
        Missing(u64),
        Unusable,
        Vanish,
        Silence,
        /// The driver does not return.
        Hang,
    }

    /// Acts that are left, shared by each opening of the same camera, and frames that did not
    /// arrive at this one.
    struct Scripted(Arc<Mutex<VecDeque<Act>>>, u64);

    impl Camera for Scripted {
        fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault> {
            let Some(act) = self.0.lock().unwrap().pop_front() else {
                return Err(CameraFault::Ended);
            };
            match act {
                Act::Frame(utime) => Ok(Some(frame(utime))),
                Act::Damaged => Err(CameraFault::Damaged("half a JPEG".to_owned())),
                Act::Missing(frames) => {
                    self.1 += frames;
                    Ok(None)
                }
                Act::Unusable => Err(CameraFault::Unusable("in feet".to_owned())),
                Act::Vanish => Err(CameraFault::Lost("unplugged".to_owned())),
                Act::Hang => {
                    std::thread::sleep(Duration::from_secs(60));
                    Ok(None)
                }
                Act::Silence => {
                    std::thread::sleep(timeout);
                    Ok(None)
                }
            }
        }

        fn missing(&self) -> u64 {
            self.1
        }
    }

    fn frame(utime: i64) -> RgbdFrame {
        let camera =
            PinholeCamera { width: 2, height: 2, cx: 0.5, cy: 0.5, ..PinholeCamera::kinect() };
        let color = ColorImage::new(2, 2, vec![7; 12]).unwrap();
        let depth = DepthImage::from_metres(2, 2, vec![1.0; 4]).unwrap();
        RgbdFrame::new(utime, Arc::new(camera), color, depth).unwrap()
    }

    fn config() -> LiveConfig {
        LiveConfig {
            queue: 100,
            stall: Duration::from_millis(150),
            backoff: [Duration::from_millis(5), Duration::from_millis(20)],
            give_up: Duration::from_millis(300),
            ..LiveConfig::default()
        }
    }

    /// Times that come out of a script, how it ends, and what is counted.
    fn play(
        acts: &[Act],
        refusals: usize,
        config: LiveConfig,
    ) -> (Vec<i64>, Result<(), String>, SourceStatistics) {
        let acts = Arc::new(Mutex::new(VecDeque::from(acts.to_vec())));
        let mut openings = 0;
        let opener = move || {
            openings += 1;
            if openings > 1 && openings <= 1 + refusals {
                return Err(SourceError::Device { name: "it".into(), reason: "not there".into() });
            }
            Ok(Box::new(Scripted(Arc::clone(&acts), 0)) as Box<dyn Camera>)
        };
        let mut source =
            LiveSource::start("scripted", Box::new(opener), config, Arc::default()).unwrap();
        let mut times = Vec::new();
        let end = loop {
            match source.next_frame() {
                Ok(Some(frame)) => times.push(frame.utime),
                Ok(None) => break Ok(()),
                Err(e) => break Err(e.to_string()),
            }
        };
        (times, end, source.statistics())
    }

    #[test]
    fn a_camera_that_vanishes_and_returns_goes_on() {
        let acts = [Act::Frame(1), Act::Frame(2), Act::Vanish, Act::Frame(3)];
        let (times, end, statistics) = play(&acts, 3, config());
        assert_eq!((times, end), (vec![1, 2, 3], Ok(())));
        assert_eq!((statistics.reconnections, statistics.lost()), (1, 0));
    }

    #[test]
    fn frames_that_did_not_arrive_are_counted_over_each_opening() {
        let acts = [
            Act::Frame(1),
            Act::Missing(2),
            Act::Missing(3),
            Act::Vanish,
            Act::Missing(4),
            Act::Frame(2),
        ];
        let (times, end, statistics) = play(&acts, 0, config());
        assert_eq!((times, end), (vec![1, 2], Ok(())));
        assert_eq!((statistics.missing, statistics.lost()), (9, 9));
    }

    #[test]
    fn a_camera_that_stays_away_ends_the_source_with_its_reason() {
        let (times, end, _) = play(&[Act::Frame(1), Act::Vanish], usize::MAX - 1, config());
        let reason = end.unwrap_err();
        assert_eq!(times, [1]);
        assert!(reason.contains("scripted") && reason.contains("not there"), "{reason}");
    }

    #[test]
    fn a_camera_that_stalls_is_opened_again() {
        let acts = [Act::Frame(1), Act::Silence, Act::Silence, Act::Frame(2)];
        let (times, end, statistics) = play(&acts, 0, config());
        assert_eq!((times, end, statistics.reconnections), (vec![1, 2], Ok(()), 1));
    }

    #[test]
    fn a_camera_that_can_be_opened_but_stays_silent_ends_the_source() {
        let acts = [&[Act::Frame(1)][..], &[Act::Silence; 50]].concat();
        let (times, end, _) = play(&acts, 0, config());
        assert_eq!(times, [1]);
        assert!(end.unwrap_err().contains("no frame for"));
    }

    #[test]
    fn what_is_damaged_repeated_or_out_of_order_is_left_out_and_counted() {
        let acts = [10, 20, 20, 15, 30].map(Act::Frame);
        let (times, _, statistics) =
            play(&[&acts[..], &[Act::Damaged, Act::Frame(40)]].concat(), 0, config());
        assert_eq!(times, [10, 20, 30, 40]);
        assert_eq!((statistics.out_of_order, statistics.damaged), (2, 1));
        assert_eq!((statistics.delivered, statistics.lost()), (4, 3));
    }

    #[test]
    fn a_camera_that_cannot_be_used_ends_the_source_at_once() {
        let acts = [Act::Frame(1), Act::Unusable, Act::Frame(2)];
        let (times, end, statistics) = play(&acts, 0, config());
        assert_eq!((times, statistics.reconnections), (vec![1], 0));
        assert!(end.unwrap_err().contains("in feet"));
    }

    #[test]
    fn one_stamp_far_ahead_does_not_end_a_camera() {
        let far = 1_000_000_000_000_000_000;
        let acts = [9_000_000, 9_033_000, far, 9_099_000, 9_133_000].map(Act::Frame);
        let (times, _, statistics) = play(&acts, 0, config());
        assert_eq!((times.len(), times[3..].to_vec()), (5, vec![9_099_000, 9_133_000]));
        assert_eq!((statistics.restamped, statistics.lost()), (1, 0));
    }

    #[test]
    fn a_camera_whose_clock_begins_again_goes_on() {
        let acts = [9_000_000, 9_100_000, 2_000_000, 2_100_000].map(Act::Frame);
        let (times, _, statistics) = play(&acts, 0, config());
        assert_eq!((times.len(), times[3]), (4, 2_100_000));
        // The first one might have been a single wrong stamp.
        assert!((9_100_001..=9_200_000).contains(&times[2]), "{times:?}");
        assert_eq!((statistics.reconnections, statistics.lost()), (1, 0));
    }

    #[test]
    fn a_slow_consumer_loses_the_oldest_and_the_count_is_right() {
        let (writer, mut queue) = frame_queue(3);
        (1..=10).for_each(|utime| writer.push(frame(utime)));
        writer.close(None);
        let mut times = Vec::new();
        while let Awaited::Frame(frame) = queue.pop(WAIT).unwrap() {
            times.push(frame.utime);
        }
        assert_eq!(times, [8, 9, 10]);
        let statistics = queue.statistics();
        assert_eq!((statistics.dropped, statistics.delivered), (7, 3));
    }

    #[test]
    fn waiting_for_a_silent_camera_ends_at_the_timeout() {
        let acts = Arc::new(Mutex::new(VecDeque::from(vec![Act::Silence; 1000])));
        let opener = move || Ok(Box::new(Scripted(Arc::clone(&acts), 0)) as Box<dyn Camera>);
        let for_network = config().for_network();
        let mut source =
            LiveSource::start("it", Box::new(opener), for_network, Arc::default()).unwrap();
        let start = Instant::now();
        let wait = Duration::from_millis(200);
        assert!(matches!(source.next_frame_within(wait), Ok(Awaited::Nothing)));
        assert!((wait..Duration::from_secs(20)).contains(&start.elapsed()));
    }

    #[test]
    fn a_camera_that_hangs_in_its_driver_is_told_and_keeps_nobody_who_drops_it() {
        let acts = Arc::new(Mutex::new(VecDeque::from(vec![Act::Hang])));
        let opener = move || Ok(Box::new(Scripted(Arc::clone(&acts), 0)) as Box<dyn Camera>);
        let (hangs, stop) = (Duration::from_millis(300), Arc::new(AtomicBool::new(false)));
        let config = LiveConfig { hangs, ..config() };
        let mut source =
            LiveSource::start("it", Box::new(opener), config, Arc::clone(&stop)).unwrap();
        assert!(matches!(source.next_frame(), Err(SourceError::Hangs { .. })));
        // Who is told to stop does not wait for it.
        stop.store(true, Ordering::Relaxed);
        std::thread::sleep(LONGEST_END);
        assert!(matches!(source.next_frame(), Ok(None)));
        let start = Instant::now();
        drop(source);
        assert!((LONGEST_END..Duration::from_secs(30)).contains(&start.elapsed()));
    }

    #[test]
    fn a_source_that_is_dropped_stops_its_thread() {
        let acts = Arc::new(Mutex::new(VecDeque::from(vec![Act::Silence; 1000])));
        let kept = Arc::clone(&acts);
        let opener = move || Ok(Box::new(Scripted(Arc::clone(&acts), 0)) as Box<dyn Camera>);
        drop(LiveSource::start("it", Box::new(opener), config(), Arc::default()).unwrap());
        assert_eq!(Arc::strong_count(&kept), 1, "the thread is gone");
    }
}
