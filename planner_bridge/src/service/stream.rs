//! The clock and the network around the real-time half, and perception's end of it.

use super::config::SELF_TEST;
use crate::channel;
use crate::limits::Rig;
use linkage_driver::live::host_utime;
use linkage_lcm::LcmError;
use linkage_lcm::udpm::{DatagramSender, Network, NetworkError};
use linkage_realtime::{
    Cycle, Motion, Moving, NotNow, Notice, OrderQueue, Phase, Port, Reason, Shared, Stream,
    StreamReport, Watch,
};
use linkage_skill::recognise::Recognised;
use std::num::NonZeroU64;
use std::time::{Duration, Instant};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// A stream that cannot start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// A rate that is not valid.
    #[error("{hz} setpoints a second cannot be streamed: 1 to 2000 can")]
    Rate {
        /// As asked.
        hz: f64,
    },
    /// A network that is no multicast group.
    #[error("{url}: setpoints need a multicast network: {source}")]
    Url {
        /// As given.
        url: String,
        /// Why.
        source: NetworkError,
    },
    /// The error of the operating system.
    #[error("setpoints cannot be sent: {0}")]
    Socket(#[from] std::io::Error),
    /// What this socket sends is not heard.
    #[error(transparent)]
    Lcm(#[from] LcmError),
}

/// What both ends of a stream borrow.
#[derive(Default)]
pub struct StreamParts {
    queue: OrderQueue,
    shared: Shared,
}

impl StreamParts {
    /// Opens both ends of a stream to an LCM network of `hz` setpoints a second.
    ///
    /// # Errors
    /// [`StreamError`].
    pub fn open(
        &mut self,
        url: &str,
        hz: f64,
        rig: &Rig,
    ) -> Result<(Streamer<'_>, Orders<'_>), StreamError> {
        if !(1.0..=2000.0).contains(&hz) {
            return Err(StreamError::Rate { hz });
        }
        let network = Network::parse(url)
            .map_err(|source| StreamError::Url { url: url.to_owned(), source })?;
        let socket = network.sender()?;
        socket.set_nonblocking(true)?;
        let period = Duration::from_secs_f64(1.0 / hz);
        let clock = Clock { epoch: Instant::now() };
        let (given, taken) = self.queue.split();
        let stream = Stream::new(taken, &self.shared, channel::SETPOINT, watch(rig, period))
            .counting_from(host_utime());
        let period_ns = u64::try_from(period.as_nanos()).ok().and_then(NonZeroU64::new);
        let cycle = Cycle::new(stream, period_ns.ok_or(StreamError::Rate { hz })?);
        let orders = Orders {
            orders: linkage_realtime::Orders::new(given, &self.shared),
            shared: &self.shared,
            clock,
            lead: Duration::from_secs_f64(rig.streaming.lead_time).max(2 * period),
            newest_frame: None,
        };
        Ok((Streamer { cycle, network, socket, clock }, orders))
    }
}

/// When a rig wants what moves to be braked.
fn watch(rig: &Rig, period: Duration) -> Watch {
    let us = |seconds: f64| microseconds(Duration::from_secs_f64(seconds));
    let streaming = &rig.streaming;
    Watch {
        frame_age_us: us(rig.safety.frame_age),
        heartbeat_age_us: streaming.heartbeat_required.then(|| us(streaming.heartbeat_age)),
        // A slow stream may miss a tick.
        longest_gap_us: us(streaming.longest_gap).max(microseconds(2 * period)),
    }
}

fn microseconds(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

/// The stream's monotonic clock: microseconds since the service began, a second ahead so that
/// nothing is older than it.
#[derive(Debug, Clone, Copy)]
struct Clock {
    epoch: Instant,
}

impl Clock {
    fn at(&self, instant: Instant) -> u64 {
        microseconds(instant.saturating_duration_since(self.epoch) + Duration::from_secs(1))
    }

    fn now(&self) -> u64 {
        self.at(Instant::now())
    }
}

/// Sends setpoints at a fixed rate.
pub struct Streamer<'q> {
    cycle: Cycle<'q>,
    network: Network,
    socket: DatagramSender,
    clock: Clock,
}

impl Streamer<'_> {
    /// Proves that what this very socket sends is heard on the network.
    ///
    /// # Errors
    /// [`StreamError::Lcm`] with what to do.
    pub fn self_test(&self) -> Result<(), StreamError> {
        Ok(self.network.self_test(&self.socket, SELF_TEST)?)
    }

    /// Streams until it is stopped and what moved has been braked to rest.
    pub fn run(self, is_stopped: &(dyn Fn() -> bool + Sync)) -> StreamReport {
        go_before_others();
        let mut port = Host { socket: self.socket, clock: self.clock, is_stopped };
        self.cycle.run(&mut port)
    }
}

/// This machine's clocks, and a socket.
struct Host<'s> {
    socket: DatagramSender,
    clock: Clock,
    is_stopped: &'s (dyn Fn() -> bool + Sync),
}

impl Port for Host<'_> {
    fn monotonic_us(&mut self) -> u64 {
        self.clock.now()
    }

    fn utime(&mut self) -> i64 {
        host_utime()
    }

    fn sleep(&mut self, us: u64) {
        std::thread::sleep(Duration::from_micros(us));
    }

    fn send(&mut self, datagram: &[u8]) -> bool {
        self.socket.send(datagram).is_ok()
    }

    fn is_stopped(&mut self) -> bool {
        (self.is_stopped)()
    }
}

/// Lets this thread run as soon as it is due. Needs CAP_SYS_NICE or an rtprio limit; without them
/// setpoints come late where perception keeps all cores busy.
fn go_before_others() {
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let priority = ThreadPriorityValue::try_from(REALTIME_PRIORITY)
        .map(ThreadPriority::Crossplatform)
        .unwrap_or(ThreadPriority::Max);
    if let Err(e) = set_thread_priority_and_policy(thread_native_id(), priority, policy) {
        tracing::warn!(
            "the stream has no real-time priority ({e}): give it with setcap cap_sys_nice+ep, or an rtprio limit"
        );
    }
}

/// Above ordinary threads, below those that drive hardware; 0 to 99.
const REALTIME_PRIORITY: u8 = 50;

/// Perception's end: what is to be streamed, and what is seen of it.
pub struct Orders<'q> {
    orders: linkage_realtime::Orders<'q>,
    shared: &'q Shared,
    clock: Clock,
    lead: Duration,
    /// The capture time of the frame that was seen last.
    newest_frame: Option<i64>,
}

impl<'q> Orders<'q> {
    /// What will be commanded when a plan that is made now takes over; none where nothing moves.
    ///
    /// # Errors
    /// [`NotNow`] while that cannot be said: ask again with the next frame.
    pub fn commanded(&self) -> Result<Option<Moving>, NotNow> {
        self.orders.commanded_at(self.clock.at(Instant::now() + self.lead))
    }

    /// Runs a motion: from `start_us` on where it goes on from what [`Self::commanded`] told, else
    /// at once.
    ///
    /// # Errors
    /// [`NotNow`] where orders come faster than they are followed.
    pub fn run(&mut self, motion: &Motion, start_us: Option<u64>) -> Result<(), NotNow> {
        self.orders.run(motion, start_us)
    }

    /// Brakes what moves, and drops what was ordered.
    pub fn brake(&mut self, why: Reason) {
        self.orders.brake(why);
    }

    /// Tells what a frame showed that was captured at `utime` and arrived at an instant: what moves
    /// runs on only as long as new frames show all of its joints. A frame that comes again, from a
    /// camera that is stuck, is none.
    pub fn frame_seen(&mut self, recognised: &Recognised, utime: i64, arrived: Instant) {
        if self.newest_frame.replace(utime) == Some(utime) {
            return;
        }
        match shows(recognised, self.orders.running()) {
            Ok(()) => self.shared.frame_seen(self.clock.at(arrived)),
            Err(why) => self.shared.frame_rejected(why),
        }
    }

    /// Tells that a frame did not show the object.
    pub fn frame_missed_it(&self) {
        self.shared.frame_rejected(Reason::ObjectLost);
    }

    /// The result of an order since this was asked last.
    pub fn poll(&mut self) -> Option<Notice> {
        self.orders.poll()
    }

    /// The stream has followed the newest order, or refused it, which [`Self::poll`] tells.
    pub fn is_decided(&self) -> bool {
        self.orders.is_decided()
    }

    /// True while something moves or is about to.
    pub fn is_running(&self) -> bool {
        self.orders.running().is_some()
    }

    /// True while what moves is brought to rest before its target.
    pub fn is_braking(&self) -> bool {
        self.orders.status().is_some_and(|s| s.phase == Phase::Braking)
    }

    /// What a heartbeat feeds.
    pub fn pulse(&self) -> Pulse<'q> {
        Pulse { shared: self.shared, clock: self.clock }
    }
}

/// Refuses a frame that does not tell where all joints are that move.
fn shows(recognised: &Recognised, moving: Option<&Motion>) -> Result<(), Reason> {
    let Some(moving) = moving else { return Ok(()) };
    if moving.object() != recognised.object {
        return Err(Reason::ObjectLost);
    }
    let is_known =
        |name: &str| recognised.joints.iter().any(|j| j.name == name && j.configuration.is_some());
    let all_known = moving.joints().iter().all(|j| is_known(j.name()));
    if all_known { Ok(()) } else { Err(Reason::JointLost) }
}

/// Tells a stream that the consumer of its setpoints is alive, or that what moves is to be braked.
#[derive(Clone, Copy)]
pub struct Pulse<'q> {
    shared: &'q Shared,
    clock: Clock,
}

impl Pulse<'_> {
    /// Reports that the consumer is alive now.
    pub fn beat(&self) {
        self.shared.heartbeat(self.clock.now());
    }

    /// Brakes what moves at once.
    pub fn halt(&self) {
        self.shared.halt(Reason::Cancelled);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Request, predict, test_data::fridge};
    use linkage_lcm::messages::linkage::Setpoint;
    use linkage_lcm::{Lcm, decode};
    use linkage_skill::predict::Target;
    use std::sync::atomic::{AtomicBool, Ordering};

    const URL: &str = "udpm://239.255.76.71:7699?ttl=0";

    /// Stops a stream when it is dropped, so that a test that fails does not wait for it.
    struct Stop<'s>(&'s AtomicBool);

    impl Drop for Stop<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::Relaxed);
        }
    }

    fn received(listener: &mut Lcm) -> Vec<Setpoint> {
        let mut all: Vec<Setpoint> = Vec::new();
        while all.last().is_none_or(|s| !s.last) {
            let packet = listener.receive(Duration::from_secs(2)).unwrap();
            let next: Setpoint = decode(&packet.expect("a setpoint").bytes).unwrap();
            // The last one of the motion before is sent several times.
            if !(all.is_empty() && next.last) {
                all.push(next);
            }
        }
        all
    }

    #[test]
    fn a_stream_on_a_real_network_brakes_when_no_frame_comes_and_when_it_is_stopped() {
        let mut listener = Lcm::new(URL).unwrap();
        listener.subscribe(channel::SETPOINT).unwrap();
        let rig = Rig::default();
        let (model, recognised) = fridge();
        let plan = predict(&model, &recognised, &Request::to(Target::Open), &rig).unwrap();
        let (mut parts, stop) = (StreamParts::default(), AtomicBool::new(false));
        let begun = host_utime();
        let (streamer, mut orders) = parts.open(URL, 200.0, &rig).unwrap();
        streamer.self_test().unwrap();
        std::thread::scope(|scope| {
            let _stop = Stop(&stop);
            let running = scope.spawn(|| streamer.run(&|| stop.load(Ordering::Relaxed)));
            for (stops, reason) in [(false, "no new frame"), (true, "the service ends")] {
                orders.frame_seen(&recognised, host_utime(), Instant::now());
                orders.run(&plan.motion().unwrap(), plan.start_us).unwrap();
                if stops {
                    std::thread::sleep(Duration::from_millis(200));
                    stop.store(true, Ordering::Relaxed);
                }
                let setpoints = received(&mut listener);
                let last = setpoints.last().unwrap();
                assert_eq!((last.reason.as_str(), last.velocity[0]), (reason, 0.0));
                assert!(setpoints.windows(2).all(|s| s[1].sequence == s[0].sequence + 1));
                // One that is started again counts on above all that were sent before.
                assert!(setpoints[0].sequence >= begun);
                assert!((last.utime - host_utime()).abs() < 500_000);
                assert!((0.3..1.0).contains(&last.position[0]), "{last:?}");
            }
            assert_eq!(orders.poll(), Some(Notice::Ended(Some(Reason::ServiceEnds))));
            assert!(running.join().unwrap().sent > 100);
        });
    }

    #[test]
    fn a_frame_that_does_not_show_what_moves_does_not_keep_it_moving() {
        let (model, recognised) = fridge();
        let plan = predict(&model, &recognised, &Request::to(Target::Open), &Rig::default());
        let motion = plan.unwrap().motion().unwrap();
        assert_eq!(shows(&recognised, Some(&motion)), Ok(()));
        let mut hidden = recognised.clone();
        hidden.joints[0].configuration = None;
        assert_eq!(shows(&hidden, Some(&motion)), Err(Reason::JointLost));
        assert_eq!(shows(&hidden, None), Ok(()), "nothing moves");
        let other = Recognised { object: "drawer".into(), ..recognised };
        assert_eq!(shows(&other, Some(&motion)), Err(Reason::ObjectLost));
    }

    #[test]
    fn a_frame_that_comes_again_is_none() {
        let (_, recognised) = fridge();
        let mut parts = StreamParts::default();
        let (_streamer, mut orders) = parts.open(URL, 200.0, &Rig::default()).unwrap();
        orders.shared.frame_rejected(Reason::JointLost);
        let state_of = |orders: &Orders| format!("{:?}", orders.shared);
        let before = state_of(&orders);
        orders.frame_seen(&recognised, 7, Instant::now());
        let seen = state_of(&orders);
        assert_ne!(seen, before);
        orders.frame_seen(&recognised, 7, Instant::now() + Duration::from_secs(1));
        assert_eq!(state_of(&orders), seen);
        orders.frame_seen(&recognised, 8, Instant::now() + Duration::from_secs(1));
        assert_ne!(state_of(&orders), seen);
    }

    #[test]
    fn what_cannot_be_streamed_to_is_refused_in_words() {
        let mut parts = StreamParts::default();
        let rig = Rig::default();
        let said = |r: Result<(Streamer, Orders), StreamError>| r.err().unwrap().to_string();
        assert!(said(parts.open("udpm://10.0.0.1:7667", 200.0, &rig)).contains("multicast"));
        assert!(said(parts.open("memq://", 200.0, &rig)).contains("multicast"));
        for hz in [0.0, 0.5, 3000.0, f64::NAN] {
            assert!(said(parts.open(URL, hz, &rig)).contains("cannot be streamed"));
        }
    }
}
