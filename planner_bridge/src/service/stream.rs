//! The clock and the socket around the real-time half: a setpoint each period, sent when it is
//! due. Nothing in the loop allocates, locks or waits for anything but the clock.

use crate::channel;
use linkage_driver::live::host_utime;
use linkage_realtime::{DATAGRAM_CAPACITY, Lateness, Motion, Stream, Tick};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// A stream that cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// A rate that is none.
    #[error("{hz} setpoints a second cannot be streamed: 1 to 2000 can")]
    Rate {
        /// As asked.
        hz: f64,
    },
    /// A network that is no multicast group.
    #[error("{url}: setpoints need an address such as udpm://239.255.76.67:7667?ttl=0")]
    Url {
        /// As given.
        url: String,
    },
    /// The system's word.
    #[error("setpoints cannot be sent: {0}")]
    Socket(#[from] std::io::Error),
}

/// How a stream kept its time.
#[derive(Debug, Clone)]
pub struct StreamReport {
    /// How late its ticks came.
    pub lateness: Lateness,
    /// Setpoints that were sent.
    pub sent: u64,
    /// Setpoints that the network did not take.
    pub failed: u64,
}

/// Sends setpoints at a fixed rate.
pub struct Streamer<'q> {
    stream: Stream<'q>,
    socket: UdpSocket,
    period: Duration,
    running: Arc<AtomicBool>,
    buffer: [u8; DATAGRAM_CAPACITY],
    report: StreamReport,
}

/// Longest wait for a tick without a look whether to stop.
const POLL: Duration = Duration::from_millis(50);

impl<'q> Streamer<'q> {
    /// A stream to an LCM network of `hz` setpoints a second.
    ///
    /// # Errors
    /// [`StreamError`].
    pub fn new(
        url: &str,
        hz: f64,
        orders: linkage_realtime::Orders<'q>,
    ) -> Result<Self, StreamError> {
        if !(1.0..=2000.0).contains(&hz) {
            return Err(StreamError::Rate { hz });
        }
        let (address, ttl) =
            multicast_of(url).ok_or_else(|| StreamError::Url { url: url.to_owned() })?;
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_multicast_ttl_v4(ttl)?;
        socket.set_multicast_loop_v4(true)?;
        socket.set_nonblocking(true)?;
        socket.connect(address)?;
        Ok(Self {
            stream: Stream::new(orders, channel::SETPOINT),
            socket,
            period: Duration::from_secs_f64(1.0 / hz),
            running: Arc::default(),
            buffer: [0; DATAGRAM_CAPACITY],
            report: StreamReport { lateness: Lateness::default(), sent: 0, failed: 0 },
        })
    }

    /// Streams until it is stopped.
    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) -> StreamReport {
        go_before_others();
        let (start, start_utime) = (Instant::now(), host_utime());
        let mut due = start;
        while !is_stopped() {
            let wait = due.saturating_duration_since(Instant::now());
            if !wait.is_zero() {
                std::thread::sleep(wait.min(POLL));
                continue;
            }
            let utime = start_utime + (due - start).as_micros() as i64;
            self.tick(utime, due.elapsed());
            due += self.period;
            // Periods that have passed altogether are not made up for.
            while due.elapsed() > self.period {
                due += self.period;
            }
        }
        self.report
    }

    /// One period's work, `late` after it was due at `utime`, microseconds since 1970.
    pub fn tick(&mut self, utime: i64, late: Duration) {
        if let Ok(Tick::Send(length)) = self.stream.tick(utime, &mut self.buffer) {
            self.report.lateness.note(late.as_micros() as u64, self.period.as_micros() as u64);
            let datagram = self.buffer.get(..length).unwrap_or_default();
            match self.socket.send(datagram) {
                Ok(_) => self.report.sent += 1,
                Err(_) => self.report.failed += 1,
            }
        }
        self.running.store(self.stream.is_running(), Ordering::Relaxed);
    }

    /// What was streamed so far.
    pub fn report(&self) -> &StreamReport {
        &self.report
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

/// Perception's end: what is to be streamed.
pub struct Orders<'q> {
    queue: heapless::spsc::Producer<'q, Option<Motion>>,
    running: Arc<AtomicBool>,
}

impl<'q> Orders<'q> {
    pub fn new(queue: heapless::spsc::Producer<'q, Option<Motion>>, streamer: &Streamer) -> Self {
        Self { queue, running: Arc::clone(&streamer.running) }
    }

    /// Runs a motion instead of what runs now; false when orders come faster than ticks.
    pub fn run(&mut self, motion: &Motion) -> bool {
        let taken = self.queue.enqueue(Some(motion.clone())).is_ok();
        if taken {
            self.running.store(true, Ordering::Relaxed);
        }
        taken
    }

    /// Stops where it is; false when orders come faster than ticks.
    pub fn stop(&mut self) -> bool {
        self.queue.enqueue(None).is_ok()
    }

    pub fn is_running(&self) -> bool {
        self.running.load(Ordering::Relaxed)
    }
}

/// Group and time to live of `udpm://ADDRESS:PORT?ttl=N`; 0, this host only, where none is given.
fn multicast_of(url: &str) -> Option<(SocketAddrV4, u32)> {
    let rest = url.strip_prefix("udpm://")?;
    let (address, options) = rest.split_once('?').unwrap_or((rest, ""));
    let ttl = options.split('&').find_map(|o| o.strip_prefix("ttl="));
    let address: SocketAddrV4 = address.parse().ok()?;
    let ttl = ttl.map_or(Some(0), |t| t.parse().ok())?;
    address.ip().is_multicast().then_some((address, ttl))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_is_told_by_its_url() {
        let group = SocketAddrV4::new(Ipv4Addr::new(239, 255, 76, 67), 7667);
        assert_eq!(multicast_of("udpm://239.255.76.67:7667?ttl=1"), Some((group, 1)));
        let with_buffer = "udpm://239.255.76.67:7667?recv_buf_size=1&ttl=0";
        assert_eq!(multicast_of(with_buffer), Some((group, 0)));
        assert_eq!(multicast_of("udpm://239.255.76.67:7667"), Some((group, 0)));
        assert_eq!(multicast_of("udpm://10.0.0.1:7667"), None);
        assert_eq!(multicast_of("memq://"), None);
    }
}
