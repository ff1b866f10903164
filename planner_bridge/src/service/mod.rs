//! The live skill: watches a source, is told what to do over LCM, answers there.
//!
//! A thread captures, one perceives, one publishes, one listens for commands, and one streams
//! setpoints; bounded queues join them, and none of them waits for a slower one. What takes longer than a frame has
//! threads of its own: to look for an object, to recognise one again, to learn.

mod authority;
mod capture;
mod command;
mod config;
mod heartbeat;
mod learning;
mod log_rate_limit;
mod losses;
mod observer;
mod perception;
mod publisher;
mod reacquire;
mod search_turns;
mod searching;
mod stream;
pub mod watchdog;

pub use authority::{CommandKey, KeyError, Unauthorised};
pub use command::{Action, Command, Fault, Refusal, SCHEMA as COMMAND_SCHEMA};
pub use config::{Playback, ServiceConfig, SourceOpener};
pub use linkage_realtime::StreamReport;
pub use observer::{Event, EventKind, Observation, Observations, Observer, observer};
pub use stream::{Orders, Pulse, StreamError, StreamParts, Streamer};

use authority::Authority;
use capture::Capture;
use command::{Listener, PLACES_FOR_CANCEL};
use heartbeat::HeartbeatListener;
use linkage_driver::SourceError;
use linkage_driver::live::{host_utime, latest};
use linkage_lcm::{Lcm, LcmError};
use linkage_skill::store::{Library, Store, StoreError};
use perception::{Inbox, Perception};
use publisher::Publisher;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A service that cannot start, or not go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServiceError {
    /// The source.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The network.
    #[error(transparent)]
    Lcm(#[from] LcmError),
    /// The key of the commands.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The stream of setpoints.
    #[error(transparent)]
    Stream(#[from] StreamError),
    /// A thread that cannot be started.
    #[error("a thread cannot be started: {0}")]
    Thread(#[from] std::io::Error),
    /// A fault of this program.
    #[error("the {0} thread failed; what was stored is safe: start again, and report this")]
    Internal(&'static str),
}

/// What a service did.
#[derive(Debug, Clone, Default)]
pub struct ServiceReport {
    /// Frames that were looked at.
    pub frames: u64,
    /// Frames that were lost on the way, or came faster than they were taken.
    pub dropped_frames: u64,
    /// Commands and packets that were refused.
    pub refused: u64,
    /// How the stream kept its time.
    pub stream: Option<StreamReport>,
}

/// Frames that wait for perception; when more come, the oldest are dropped.
const WAITING_FRAMES: usize = 8;
/// Commands that wait for it, besides CANCEL; more are refused. Half of them may come from one host.
const WAITING_COMMANDS: usize = 32;
/// Packets that wait to be published; when more come, the oldest are dropped.
const WAITING_PACKETS: usize = 64;
/// The same of what the status is made of. A flood of refused commands makes some 200 a second, and no
/// answer may be lost where a busy machine publishes nothing for some seconds.
const WAITING_NOTES: usize = 4096;

/// Serves until `stop` is set.
///
/// # Errors
/// [`ServiceError`] when the source, the network or the store cannot be used at the start. What
/// fails later is told in the status, and the service goes on.
pub fn serve(
    open: Box<SourceOpener>,
    config: &ServiceConfig,
    stop: &Arc<AtomicBool>,
) -> Result<ServiceReport, ServiceError> {
    serve_observed(open, config, stop, Observer::default())
}

/// Serves like [`serve`]; `observer` receives the frames and the results.
///
/// # Errors
/// As [`serve`].
pub fn serve_observed(
    mut open: Box<SourceOpener>,
    config: &ServiceConfig,
    stop: &Arc<AtomicBool>,
    observer: Observer,
) -> Result<ServiceReport, ServiceError> {
    let library = known(&config.store)?;
    let lcm = Lcm::new(&config.url)?;
    if config.url.starts_with("udpm") {
        lcm.self_test(config::SELF_TEST)?;
    }
    let source = open()?;
    let (frame_writer, frames) = latest(WAITING_FRAMES);
    let (packet_writer, packets) = latest(WAITING_PACKETS);
    let (note_writer, notes) = latest(WAITING_NOTES);
    let (command_writer, commands) =
        crossbeam_channel::bounded(WAITING_COMMANDS + PLACES_FOR_CANCEL);
    let out = publisher::Outbox { packets: packet_writer, notes: note_writer, observer };

    let capture = Capture::new(source, open, config.playback, frame_writer, out.clone());
    // The time at which it begins names this run.
    let session = host_utime();
    let authority = Authority::new(session, config.rig.safety.command_age, &config.rig.access)?;
    let publisher = Publisher::new(lcm, session, packets, notes);
    let mut parts = StreamParts::default();
    let (streamer, orders) = config
        .stream_hz
        .map(|hz| parts.open(&config.url, hz, &config.rig))
        .transpose()?
        .map_or((None, None), |(streamer, orders)| (Some(streamer), Some(orders)));
    streamer.as_ref().map_or(Ok(()), Streamer::self_test)?;
    let pulse = orders.as_ref().map(Orders::pulse);
    let listener = Listener::new(&config.url, authority, command_writer, pulse, out.clone())?;
    let heartbeat = orders
        .as_ref()
        .map(|orders| HeartbeatListener::new(&config.url, orders.pulse(), out.clone()))
        .transpose()?;
    let inbox = Inbox { frames, lost: capture.lost(), commands };
    let perception = Perception::new(config, library, inbox, out, orders);
    Threads { capture, listener, publisher, streamer, heartbeat, perception }.run(stop)
}

/// What a store knows; nothing, where there is none yet.
fn known(store: &Path) -> Result<Library, StoreError> {
    match Store::open(store) {
        Ok(store) => store.load(),
        Err(StoreError::Missing { .. }) => Ok(Library::new(Vec::new())),
        Err(e) => Err(e),
    }
}

/// What each thread of a service does.
struct Threads<'q> {
    capture: Capture,
    listener: Listener<'q>,
    publisher: Publisher,
    streamer: Option<Streamer<'q>>,
    heartbeat: Option<HeartbeatListener<'q>>,
    perception: Perception<'q>,
}

impl Threads<'_> {
    /// Runs all until `stop` is set, or until one of them fails.
    fn run(self, stop: &AtomicBool) -> Result<ServiceReport, ServiceError> {
        let Self { capture, listener, publisher, streamer, heartbeat, perception } = self;
        let is_stopped = || stop.load(Ordering::Relaxed);
        std::thread::scope(|scope| {
            // The scope waits for those that run already when another cannot be started.
            let _stop_all = StopAll(stop);
            let start = |name: &str| std::thread::Builder::new().name(name.to_owned());
            let capturing = start("capture")
                .spawn_scoped(scope, || guarded(stop, || capture.run(&is_stopped)))?;
            let listening = start("commands")
                .spawn_scoped(scope, || guarded(stop, || listener.run(&is_stopped)))?;
            let publishing = start("publish")
                .spawn_scoped(scope, || guarded(stop, || publisher.run(&is_stopped)))?;
            let stream = |s: Streamer| guarded(stop, || s.run(&is_stopped));
            let streaming = streamer
                .map(|s| start("stream").spawn_scoped(scope, move || stream(s)))
                .transpose()?;
            let hear = |h: HeartbeatListener| guarded(stop, || h.run(&is_stopped));
            let hearing = heartbeat
                .map(|h| start("heart").spawn_scoped(scope, move || hear(h)))
                .transpose()?;
            let perceiving = start("perceive")
                .spawn_scoped(scope, || guarded(stop, || perception.run(&is_stopped)))?;

            let failed = ServiceError::Internal;
            let (frames, dropped_frames) = perceiving.join().map_err(|_| failed("perception"))?;
            capturing.join().map_err(|_| failed("capture"))?;
            listening.join().map_err(|_| failed("command"))?;
            hearing.map_or(Ok(()), |h| h.join().map_err(|_| failed("heartbeat")))?;
            let refused = publishing.join().map_err(|_| failed("publishing"))?;
            let stream = streaming.map(|s| s.join().map_err(|_| failed("stream"))).transpose()?;
            Ok(ServiceReport { frames, dropped_frames, refused, stream })
        })
    }
}

/// Stops all the others when one of the threads fails.
fn guarded<T>(stop: &AtomicBool, work: impl FnOnce() -> T) -> T {
    let stop_all = StopAll(stop);
    let done = work();
    std::mem::forget(stop_all);
    done
}

/// Stops all threads where it is dropped.
struct StopAll<'s>(&'s AtomicBool);

impl Drop for StopAll<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_ends_stops_no_other_and_one_that_fails_stops_all() {
        let stop = AtomicBool::new(false);
        assert_eq!(guarded(&stop, || 7), 7);
        assert!(!stop.load(Ordering::Relaxed));
        let failed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            guarded(&stop, || panic!("a test's own"))
        }));
        assert!(failed.is_err() && stop.load(Ordering::Relaxed));
    }

    #[test]
    fn a_store_that_is_not_there_yet_knows_nothing_and_is_not_made() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        assert!(known(&path).unwrap().is_empty());
        assert!(!path.exists());
    }

    #[test]
    fn what_is_no_store_is_refused_at_the_start() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("notes.txt");
        std::fs::write(&path, "no database. ".repeat(100)).unwrap();
        assert!(matches!(known(&path), Err(StoreError::NotAStore { .. })));
    }
}
