//! The loop that keeps time: a setpoint each period, sent when it is due. All of it but the clock
//! and the network is here, so that what is proved of this crate holds for what is shipped.

use crate::datagram::DATAGRAM_CAPACITY;
use crate::host_clock::{HostClock, Reading};
use crate::lateness::Lateness;
use crate::stream::{Stream, Tick};
use core::num::NonZeroU64;

/// The clock and the network around the loop.
pub trait Port {
    /// Microseconds of a clock that is never corrected.
    fn monotonic_us(&mut self) -> u64;
    /// The host's clock, microseconds since 1970; it may be corrected at any time.
    fn utime(&mut self) -> i64;
    /// Waits for this many microseconds at most.
    fn sleep(&mut self, us: u64);
    /// Sends a datagram; false when the network does not take it.
    fn send(&mut self, datagram: &[u8]) -> bool;
    /// True once the loop is to end.
    fn is_stopped(&mut self) -> bool;
}

/// How a stream kept its time.
#[derive(Debug, Clone, Default)]
pub struct StreamReport {
    /// How late its ticks came while something moved.
    pub lateness: Lateness,
    /// Setpoints that were sent.
    pub sent: u64,
    /// Setpoints that the network did not take.
    pub failed: u64,
}

/// Longest wait before the loop checks whether it is to end, microseconds.
const LONGEST_SLEEP_US: u64 = 50_000;

/// The last setpoint of a motion is sent again for this long, and for longer where the network takes none, up to the
/// second time: a consumer that missed it would not know that the motion is over, nor why. Microseconds.
const REPEAT_US: [u64; 2] = [100_000, 2_000_000];
/// Time between two of these, microseconds.
const REPEAT_EVERY_US: u64 = 10_000;

/// The last setpoint of a motion.
#[derive(Clone, Copy)]
struct LastSetpoint {
    /// When it was due.
    due_us: u64,
    /// When it was sent again.
    again_us: u64,
    was_taken: bool,
}

impl LastSetpoint {
    /// It is sent once more, by a loop of this period, microseconds.
    fn is_repeated(&self, due_us: u64, period_us: u64) -> bool {
        let [taken, not_taken] = REPEAT_US;
        let time = if self.was_taken { taken } else { not_taken };
        // A slow loop sends it again, too.
        due_us.saturating_sub(self.due_us) <= time.max(period_us.saturating_mul(3))
    }
}

/// Sends setpoints at a fixed rate.
pub struct Cycle<'q> {
    stream: Stream<'q>,
    period_ns: NonZeroU64,
    buffer: [u8; DATAGRAM_CAPACITY],
    host_clock: HostClock,
    report: StreamReport,
    /// What is sent again while nothing moves.
    last: Option<LastSetpoint>,
}

impl<'q> Cycle<'q> {
    /// A loop of this many nanoseconds a period.
    pub fn new(stream: Stream<'q>, period_ns: NonZeroU64) -> Self {
        let buffer = [0; DATAGRAM_CAPACITY];
        let (host_clock, report) = (HostClock::default(), StreamReport::default());
        Self { stream, period_ns, buffer, host_clock, report, last: None }
    }

    /// Streams until it is stopped and what moved has been braked to rest.
    pub fn run(mut self, port: &mut impl Port) -> StreamReport {
        let start_us = port.monotonic_us();
        let mut periods = 0;
        loop {
            if port.is_stopped() {
                self.stream.end();
                if self.stream.is_at_rest() && self.last.is_none() {
                    return self.report;
                }
            }
            let due_us = self.due_us(start_us, periods);
            let wait_us = due_us.saturating_sub(port.monotonic_us());
            if wait_us > 0 {
                port.sleep(wait_us.min(LONGEST_SLEEP_US));
                continue;
            }
            self.step(due_us, port);
            periods = self.next(start_us, periods, port.monotonic_us());
        }
    }

    /// One period's work.
    fn step(&mut self, due_us: u64, port: &mut impl Port) {
        let before_us = port.monotonic_us();
        let late_us = before_us.saturating_sub(due_us);
        let reading = Reading { before_us, utime: port.utime(), after_us: port.monotonic_us() };
        let utime = self.host_clock.at(due_us, &reading);
        match self.stream.tick(due_us, utime, &mut self.buffer) {
            Ok(Tick::Idle) => self.repeat_last(due_us, utime, port),
            Ok(Tick::Send(length)) => {
                let datagram = self.buffer.get(..length).unwrap_or_default();
                let was_sent = port.send(datagram);
                self.stream.sent(due_us, was_sent);
                self.report.sent += u64::from(was_sent);
                self.report.failed += u64::from(!was_sent);
                self.report.lateness.note(late_us, self.period_ns.get() / 1000);
                let last = LastSetpoint { due_us, again_us: due_us, was_taken: was_sent };
                self.last = self.stream.is_at_rest().then_some(last);
            }
            Err(_) => self.report.failed += 1,
        }
    }

    /// Sends the last setpoint of a motion again, from time to time.
    fn repeat_last(&mut self, due_us: u64, utime: i64, port: &mut impl Port) {
        let Some(last) = &mut self.last else { return };
        if due_us.saturating_sub(last.again_us) < REPEAT_EVERY_US {
            return;
        }
        if !last.is_repeated(due_us, self.period_ns.get() / 1000) {
            self.last = None;
            return;
        }
        last.again_us = due_us;
        if let Ok(Tick::Send(length)) = self.stream.repeat_last(due_us, utime, &mut self.buffer) {
            last.was_taken |= port.send(self.buffer.get(..length).unwrap_or_default());
        }
    }

    /// The period after some, or the newest that is due where some have passed altogether: those
    /// are not made up for.
    fn next(&self, start_us: u64, periods: u64, now_us: u64) -> u64 {
        let begun = now_us.saturating_sub(start_us).saturating_mul(1000) / self.period_ns;
        begun.max(periods.saturating_add(1))
    }

    fn due_us(&self, start_us: u64, periods: u64) -> u64 {
        start_us.saturating_add(periods.saturating_mul(self.period_ns.get()) / 1000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use crate::motion::tests::there;
    use crate::orders::Orders;
    use crate::shared::Shared;
    use crate::stream::{OrderQueue, Watch};
    use heapless::Vec;

    const WATCH: Watch =
        Watch { frame_age_us: 500_000, heartbeat_age_us: None, longest_gap_us: 50_000 };
    const CHANNEL: &str = "S";

    /// A clock that each sleep advances, and a network that remembers stamps and positions.
    struct FakePort<'q> {
        now_us: u64,
        until_us: u64,
        /// The host's clock is behind by this until half of the time, and then right.
        behind_us: i64,
        /// Period after which another program takes the processor for 3 ms, microseconds.
        busy_us: u64,
        /// Readings of the host's clock after one of which another program does.
        busy_readings: u64,
        readings: u64,
        shared: &'q Shared,
        sent: Vec<(i64, f64), 4096>,
        /// When the last setpoint was sent again, and where it says that the door is.
        again: Vec<(u64, f64), 512>,
        /// The network takes nothing before this time.
        deaf_until_us: u64,
        /// The last setpoint was sent.
        is_over: bool,
    }

    impl Port for FakePort<'_> {
        fn monotonic_us(&mut self) -> u64 {
            self.now_us
        }

        fn utime(&mut self) -> i64 {
            self.readings += 1;
            if self.readings.is_multiple_of(self.busy_readings) {
                self.now_us += 3000;
            }
            let is_corrected = self.now_us > self.until_us / 2;
            1_700_000_000_000_000 + self.now_us as i64
                - if is_corrected { 0 } else { self.behind_us }
        }

        fn sleep(&mut self, us: u64) {
            let before = self.now_us;
            self.now_us += us;
            if self.now_us / self.busy_us > before / self.busy_us {
                self.now_us += 3000;
            }
            self.shared.frame_seen(self.now_us);
        }

        fn send(&mut self, datagram: &[u8]) -> bool {
            let stamp = 8 + CHANNEL.len() + 1 + 8;
            let position = stamp + 8 + 4 + 8 + 1 + (4 + 5) + 4 + (4 + 7);
            let eight = |at: usize| datagram[at..at + 8].try_into().unwrap();
            let (stamp, position) =
                (i64::from_be_bytes(eight(stamp)), f64::from_be_bytes(eight(position)));
            let number = i64::from_be_bytes(eight(8 + CHANNEL.len() + 1 + 8 + 8 + 4));
            assert_eq!(number as usize, self.sent.len() + self.again.len(), "it counts up by one");
            if self.is_over {
                self.again.push((self.now_us, position)).unwrap();
            } else {
                self.sent.push((stamp, position)).unwrap();
            }
            self.is_over |= datagram[8 + CHANNEL.len() + 1 + 8 + 8 + 4 + 8] == 1;
            self.now_us >= self.deaf_until_us
        }

        fn is_stopped(&mut self) -> bool {
            self.now_us >= self.until_us
        }
    }

    /// What is sent while a motion of two seconds is streamed at a kilohertz.
    fn streamed(
        until_us: u64,
        behind_us: i64,
        busy_us: u64,
        busy_readings: u64,
    ) -> (Vec<(i64, f64), 4096>, StreamReport) {
        let (port, report) = streamed_to(until_us, behind_us, busy_us, busy_readings, 0);
        (port.sent, report)
    }

    /// Setpoints that are sent, and those that are sent again.
    struct Sent {
        sent: Vec<(i64, f64), 4096>,
        again: Vec<(u64, f64), 512>,
    }

    /// The same to a network that takes nothing for some time.
    fn streamed_to(
        until_us: u64,
        behind_us: i64,
        busy_us: u64,
        busy_readings: u64,
        deaf_until_us: u64,
    ) -> (Sent, StreamReport) {
        let (mut queue, shared) = (OrderQueue::new(), Shared::default());
        let (given, taken) = queue.split();
        let mut orders = Orders::new(given, &shared);
        let mut motion = Motion::new("door").unwrap();
        motion.push(there(1.0, 0.5)).unwrap();
        shared.frame_seen(0);
        orders.run(&motion, None).unwrap();
        let cycle = Cycle::new(
            Stream::new(taken, &shared, CHANNEL, WATCH),
            NonZeroU64::new(1_000_000).unwrap(),
        );
        let mut port = FakePort {
            now_us: 0,
            until_us,
            behind_us,
            busy_us,
            busy_readings,
            readings: 0,
            shared: &shared,
            sent: Vec::new(),
            again: Vec::new(),
            deaf_until_us,
            is_over: false,
        };
        let report = cycle.run(&mut port);
        (Sent { sent: port.sent, again: port.again }, report)
    }

    #[test]
    fn a_corrected_clock_moves_the_stamps_and_not_the_motion() {
        let (right, _) = streamed(2_500_000, 0, u64::MAX, u64::MAX);
        for behind_us in [3_600_000_000, -3_600_000_000] {
            let (corrected, _) = streamed(2_500_000, behind_us, u64::MAX, u64::MAX);
            assert_eq!(right.len(), corrected.len());
            for (n, (r, c)) in right.iter().zip(&corrected).enumerate() {
                let due_us = n as i64 * 1000;
                let off = if due_us > 1_250_000 { 0 } else { behind_us };
                assert_eq!(c.0, 1_700_000_000_000_000 + due_us - off);
                assert_eq!(c.1, r.1);
            }
        }
    }

    #[test]
    fn the_last_setpoint_is_sent_again_for_a_tenth_of_a_second() {
        let (Sent { sent, again }, _) = streamed_to(2_500_000, 0, u64::MAX, u64::MAX, 0);
        let last = sent[sent.len() - 1].1;
        assert_eq!(again.len(), 10);
        assert!(again.iter().all(|(_, position)| *position == last), "it stays where it is");
        let [first, end] = [again[0].0, again[9].0];
        assert_eq!((first, end), (2_010_000, 2_100_000));
    }

    #[test]
    fn a_network_that_takes_nothing_hears_the_end_once_it_takes_something() {
        // It goes deaf for long enough to be braked, and for a second after that.
        let deaf_until_us = 1_500_000;
        let (Sent { again, .. }, report) =
            streamed_to(3_000_000, 0, u64::MAX, u64::MAX, deaf_until_us);
        assert!(report.failed > 50, "the motion was braked");
        let heard = again.iter().filter(|(at, _)| *at >= deaf_until_us).count();
        assert!(heard >= 1, "{heard}");
        // And one that stays deaf is given up.
        let (Sent { again, .. }, _) = streamed_to(9_000_000, 0, u64::MAX, u64::MAX, u64::MAX);
        assert!((190..=200).contains(&again.len()), "{}", again.len());
    }

    #[test]
    fn ticks_that_come_late_show_what_was_due_then_and_lost_ones_are_not_made_up_for() {
        let (sent, report) = streamed(2_500_000, 0, 100_000, u64::MAX);
        assert!((1900..1990).contains(&sent.len()), "{} of 2001", sent.len());
        assert!(report.lateness.missed() >= 19 && report.sent == sent.len() as u64);
        let exact = there(1.0, 0.5);
        for (stamp, position) in &sent {
            let time = (stamp - 1_700_000_000_000_000) as f64 * 1e-6;
            assert!((position - exact.at(time).position).abs() < 1e-12, "at {time} s");
        }
    }

    #[test]
    fn stamps_are_right_where_the_processor_is_lost_between_two_clocks() {
        let (sent, _) = streamed(2_500_000, 0, u64::MAX, 7);
        let exact = there(1.0, 0.5);
        for (stamp, position) in &sent {
            let time = (stamp - 1_700_000_000_000_000) as f64 * 1e-6;
            assert!((position - exact.at(time).position).abs() < 1e-12, "at {time} s");
        }
    }

    #[test]
    fn a_loop_that_is_stopped_brakes_what_moves_before_it_ends() {
        let (sent, _) = streamed(1_000_000, 0, u64::MAX, u64::MAX);
        assert!(sent.len() > 1001, "it ends where it is");
        let at_rest = sent[sent.len() - 1].1;
        let speed = (at_rest - sent[sent.len() - 2].1) / 1e-3;
        assert!(speed.abs() < 1e-3, "{speed} rad/s");
    }
}
