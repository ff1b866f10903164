//! What the two ends of a stream, and whatever keeps it alive, tell each other without waiting.
//!
//! Only 32-bit atomics are used, which microcontrollers have too.

use crate::reason::{Reason, Refusal};
use core::sync::atomic::{AtomicU32, Ordering, fence};

/// When something was last there, in milliseconds of the monotonic clock; 0: not lately.
///
/// The milliseconds wrap after 49 days. A signal that is too old is forgotten by the stream's next
/// tick, so an old one is never taken for a new one.
#[derive(Debug, Default)]
struct Signal(AtomicU32);

impl Signal {
    /// It was there at that time.
    fn note(&self, at_us: u64) {
        self.0.store(milliseconds(at_us).max(1), Ordering::Relaxed);
    }

    /// It is as if it had never been there.
    fn forget(&self) {
        self.0.store(0, Ordering::Relaxed);
    }

    /// True where it was there within this many microseconds before now; forgets it where not.
    fn is_fresh(&self, now_us: u64, greatest_age_us: u64) -> bool {
        let noted = self.0.load(Ordering::Relaxed);
        if noted == 0 {
            return false;
        }
        // It may be noted after the instant that a late tick stands for.
        let age = i64::from(milliseconds(now_us).wrapping_sub(noted) as i32).max(0) as u64;
        let fresh = age.saturating_mul(1000) <= greatest_age_us;
        if !fresh {
            // Where it is noted again in between, that stays.
            let _ = self.0.compare_exchange(noted, 0, Ordering::Relaxed, Ordering::Relaxed);
        }
        fresh
    }
}

fn milliseconds(us: u64) -> u32 {
    (us / 1000) as u32
}

/// What a stream is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Phase {
    /// Nothing moves.
    #[default]
    Rest,
    /// A motion runs to its target.
    Running,
    /// A motion is brought to rest.
    Braking,
}

/// The status of a stream, which it writes after each tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Status {
    /// What it is doing.
    pub phase: Phase,
    /// Number of the order that it follows, or followed last.
    pub order: u32,
    /// When that motion began, microseconds of the monotonic clock.
    pub start_us: u64,
    /// Number of the newest order that it has followed or refused.
    pub decided: u32,
    /// Why that order was refused, if it was.
    pub refusal: Option<Refusal>,
    /// Number of motions that have come to rest, modulo 2^32.
    pub ends: u32,
    /// Why the last of them ended before its target, if it did.
    pub reason: Option<Reason>,
    /// Orders up to this one are cancelled, and the stream knows.
    pub cancelled: u32,
}

const WORDS: usize = 9;

impl Status {
    fn words(&self) -> [u32; WORDS] {
        let phase = match self.phase {
            Phase::Rest => 0,
            Phase::Running => 1,
            Phase::Braking => 2,
        };
        [
            phase,
            self.order,
            self.start_us as u32,
            (self.start_us >> 32) as u32,
            self.decided,
            self.refusal.map_or(0, Refusal::code),
            self.ends,
            self.reason.map_or(0, Reason::code),
            self.cancelled,
        ]
    }

    fn of(words: [u32; WORDS]) -> Self {
        let [phase, order, low, high, decided, refusal, ends, reason, cancelled] = words;
        let phase = match phase {
            1 => Phase::Running,
            2 => Phase::Braking,
            _ => Phase::Rest,
        };
        let (refusal, reason) = (Refusal::of(refusal), Reason::of(reason));
        let start_us = u64::from(high) << 32 | u64::from(low);
        Self { phase, order, start_us, decided, refusal, ends, reason, cancelled }
    }
}

/// A status that one thread writes and others read: a sequence lock. The writer never waits; a
/// reader that is interrupted by it reads again.
#[derive(Debug, Default)]
struct SeqLock {
    /// Odd while it is being written.
    version: AtomicU32,
    words: [AtomicU32; WORDS],
}

/// So often a status is read again while it is being written.
const READS: usize = 64;

impl SeqLock {
    fn write(&self, status: &Status) {
        let version = self.version.load(Ordering::Relaxed);
        self.version.store(version.wrapping_add(1), Ordering::Relaxed);
        fence(Ordering::Release);
        for (word, value) in self.words.iter().zip(status.words()) {
            word.store(value, Ordering::Relaxed);
        }
        self.version.store(version.wrapping_add(2), Ordering::Release);
    }

    fn read(&self) -> Option<Status> {
        for _ in 0..READS {
            let before = self.version.load(Ordering::Acquire);
            let mut words = [0; WORDS];
            for (value, word) in words.iter_mut().zip(&self.words) {
                *value = word.load(Ordering::Relaxed);
            }
            fence(Ordering::Acquire);
            if before.is_multiple_of(2) && self.version.load(Ordering::Relaxed) == before {
                return Some(Status::of(words));
            }
            core::hint::spin_loop();
        }
        None
    }
}

/// What both ends of a stream share, and who feeds its dead man's switch.
#[derive(Debug, Default)]
pub struct Shared {
    frames: Signal,
    heartbeat: Signal,
    /// Why the newest frame does not show all moving joints, as a number; 0 where it does.
    rejection: AtomicU32,
    /// Orders up to this one are cancelled, and why.
    cancelled: AtomicU32,
    cancelled_reason: AtomicU32,
    status: SeqLock,
}

impl Shared {
    /// A frame was captured at that time, microseconds of the monotonic clock, which tells the
    /// configuration of all joints that move.
    pub fn frame_seen(&self, captured_us: u64) {
        self.rejection.store(0, Ordering::Relaxed);
        self.frames.note(captured_us);
    }

    /// A frame came that does not show all moving joints, and why. Where no frame that does comes in
    /// time, this is the reason for which the motion is braked.
    pub fn frame_rejected(&self, why: Reason) {
        self.rejection.store(why.code(), Ordering::Relaxed);
    }

    /// Brakes what moves at the next tick, and lets nothing start before a frame tells anew where the
    /// joints are. Any thread may say so: it waits for no other.
    pub fn halt(&self, why: Reason) {
        self.rejection.store(why.code(), Ordering::Relaxed);
        self.frames.forget();
    }

    /// The consumer of the setpoints was alive at that time, microseconds of the monotonic clock.
    pub fn heartbeat(&self, at_us: u64) {
        self.heartbeat.note(at_us);
    }

    /// What the stream is doing; none where it is written so often that it cannot be read.
    pub fn status(&self) -> Option<Status> {
        self.status.read()
    }

    /// Cancels all orders up to one.
    pub(crate) fn cancel(&self, order: u32, why: Reason) {
        self.cancelled_reason.store(why.code(), Ordering::Relaxed);
        self.cancelled.store(order, Ordering::Release);
    }

    /// Orders up to this one are cancelled, and why.
    pub(crate) fn cancelled(&self) -> (u32, Reason) {
        let order = self.cancelled.load(Ordering::Acquire);
        let why = Reason::of(self.cancelled_reason.load(Ordering::Relaxed));
        (order, why.unwrap_or(Reason::Cancelled))
    }

    /// True where frames tell where the joints are; else why not.
    pub(crate) fn frames(&self, now_us: u64, greatest_age_us: u64) -> Result<(), Reason> {
        if self.frames.is_fresh(now_us, greatest_age_us) {
            return Ok(());
        }
        Err(Reason::of(self.rejection.load(Ordering::Relaxed)).unwrap_or(Reason::NoFrame))
    }

    pub(crate) fn has_heartbeat(&self, now_us: u64, greatest_age_us: u64) -> bool {
        self.heartbeat.is_fresh(now_us, greatest_age_us)
    }

    pub(crate) fn set_status(&self, status: &Status) {
        self.status.write(status);
    }
}

/// True where the number of an order is that of another or comes before it; numbers wrap.
pub(crate) fn is_up_to(order: u32, other: u32) -> bool {
    order.wrapping_sub(other) as i32 <= 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const AGE: u64 = 500_000;

    #[test]
    fn a_signal_is_fresh_until_it_is_too_old() {
        let signal = Signal::default();
        assert!(!signal.is_fresh(0, AGE), "it was never there");
        signal.note(10_000_000);
        assert!(signal.is_fresh(9_990_000, AGE), "noted after a late tick was due");
        assert!(signal.is_fresh(10_500_000, AGE));
        assert!(!signal.is_fresh(10_502_000, AGE));
    }

    #[test]
    fn a_signal_that_was_too_old_once_is_not_fresh_when_the_milliseconds_wrap() {
        let signal = Signal::default();
        let wrap = (u64::from(u32::MAX) + 1) * 1000;
        for start in [7_000, wrap - 3_000, wrap] {
            signal.note(start);
            assert!(signal.is_fresh(start + 100_000, AGE));
            assert!(!signal.is_fresh(start + 600_000, AGE));
            assert!(!signal.is_fresh(start + wrap, AGE));
        }
    }

    #[test]
    fn the_reason_of_a_rejection_holds_until_a_frame_is_seen() {
        let shared = Shared::default();
        assert_eq!(shared.frames(1_000_000, AGE), Err(Reason::NoFrame));
        shared.frame_rejected(Reason::JointLost);
        assert_eq!(shared.frames(1_000_000, AGE), Err(Reason::JointLost));
        shared.frame_seen(1_000_000);
        assert_eq!(shared.frames(1_000_000, AGE), Ok(()));
        assert_eq!(shared.frames(9_000_000, AGE), Err(Reason::NoFrame));
    }

    #[test]
    fn numbers_of_orders_wrap() {
        assert!(is_up_to(3, 3) && is_up_to(2, 3) && !is_up_to(4, 3));
        assert!(is_up_to(u32::MAX, 1) && !is_up_to(1, u32::MAX));
    }

    proptest! {
        #[test]
        fn a_status_is_read_as_it_was_told(
            phase in 0..3_usize, start_us: u64, n in any::<[u32; 4]>(), why in 0..10_u32,
        ) {
            let status = Status {
                phase: [Phase::Rest, Phase::Running, Phase::Braking][phase],
                order: n[0],
                start_us,
                decided: n[1],
                refusal: Refusal::of(why),
                ends: n[2],
                reason: Reason::of(why),
                cancelled: n[3],
            };
            let shared = Shared::default();
            shared.set_status(&status);
            prop_assert_eq!(shared.status(), Some(status));
        }
    }

    #[test]
    fn a_status_is_never_read_half_written() {
        extern crate std;
        let shared = Shared::default();
        let rounds = if cfg!(miri) { 100 } else { 200_000 };
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for n in 0..rounds {
                    let start_us = u64::from(n) << 32 | u64::from(n);
                    let all =
                        Status { order: n, decided: n, ends: n, start_us, ..Status::default() };
                    shared.set_status(&all);
                }
            });
            for _ in 0..rounds {
                let Some(s) = shared.status() else { continue };
                assert_eq!((s.decided, s.ends), (s.order, s.order));
                assert_eq!(s.start_us, u64::from(s.order) << 32 | u64::from(s.order));
            }
        });
    }
}
