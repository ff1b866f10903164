//! Everything that the real-time half does, reached from an entry point without `std`. The panic
//! handler calls a function that does not exist: if any panic can be reached, this does not link.
//!
//! The loop is the shipped one, `Cycle::run`. Every other public function is called as well, with
//! values that the compiler cannot know; `tools/check-realtime` refuses one that is not named here.
#![no_std]
#![no_main]

#[cfg(feature = "allocates")]
extern crate alloc;
#[cfg(feature = "uses-std")]
extern crate std;

use core::fmt::Write;
use core::hint::black_box;
use core::num::NonZeroU64;
use linkage_realtime::{
    Bounds, Cycle, JointMotion, Limits, Motion, MotionError, Moving, NotNow, Notice,
    OrderQueue, Orders, Phase, Port, Reason, Refusal, Sample, Segment, Shared, Stream,
    StreamReport, Watch, stop,
};

unsafe extern "C" {
    fn the_realtime_half_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    // SAFETY: never executed: a program that holds this call does not link.
    unsafe { the_realtime_half_can_panic() }
}

/// A clock and a network of which the compiler knows nothing.
struct Unknown;

impl Port for Unknown {
    fn monotonic_us(&mut self) -> u64 {
        black_box(5000)
    }

    fn utime(&mut self) -> i64 {
        black_box(7)
    }

    fn sleep(&mut self, us: u64) {
        black_box(us);
    }

    fn send(&mut self, datagram: &[u8]) -> bool {
        #[cfg(feature = "panics")]
        black_box(datagram[black_box(7)]);
        black_box(datagram);
        black_box(true)
    }

    fn is_stopped(&mut self) -> bool {
        #[cfg(feature = "allocates")]
        black_box(alloc::vec::Vec::<u8>::with_capacity(black_box(9)));
        black_box(false)
    }
}

/// Text goes nowhere.
struct Nowhere;

impl Write for Nowhere {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        black_box(text);
        Ok(())
    }
}

fn text_of(any: impl core::fmt::Display) {
    let _ = write!(Nowhere, "{any}");
}

/// The motion of one joint.
fn joint() -> Result<JointMotion, MotionError> {
    let limits = black_box(Limits { velocity: 1.0, acceleration: 2.0, jerk: 3.0 });
    let bounds = Bounds { limits, range: black_box([0.0, 1.0]) };
    let from: Sample = black_box(Sample::rest(black_box(0.3)));
    let segments = black_box([Segment::from(black_box(0.0), from, black_box(1.0)); 3]);
    let segments = segments.get(..black_box(2)).ok_or(MotionError::TooMuch)?;
    let stop = black_box(stop(from, &limits));
    let joint = JointMotion::new(black_box("j"), segments, stop.duration, stop.position, bounds)?;
    black_box((joint.name(), joint.target(), joint.bounds(), joint.segments(), joint.duration()));
    let piece = joint.at(black_box(0.2));
    black_box((piece.is_rest(), segments.first().map(|s| s.after(black_box(0.1)))));
    Ok(joint.brake(black_box(0.4)))
}

fn motion() -> Result<Motion, MotionError> {
    let mut motion = Motion::new(black_box("door"))?;
    motion.push(joint()?)?;
    let other = motion.brake(black_box(0.2));
    black_box((motion.follows(&other, black_box(0.1)), motion.starts_at_rest()));
    black_box(motion.leaves_out_what_rests(&other, black_box(0.1)));
    black_box((motion.object(), motion.joints(), motion.joint(black_box("j")), motion.duration()));
    Ok(motion)
}

/// What a planner does between ticks.
fn plan(orders: &mut Orders, shared: &Shared) -> Result<(), NotNow> {
    shared.frame_seen(black_box(4));
    shared.frame_rejected(black_box(Reason::JointLost));
    shared.halt(black_box(Reason::Cancelled));
    shared.heartbeat(black_box(4));
    let moving = orders.commanded_at(black_box(9))?;
    if let Some(moving) = &moving {
        black_box((moving.object(), moving.at_us(), moving.joint(black_box("j"))));
        moving.unsettled().for_each(|joint| _ = black_box(joint));
    }
    match motion() {
        Ok(motion) => {
            orders.run(&motion, moving.as_ref().map(Moving::at_us))?;
            black_box(Moving::new(motion, black_box(0.1), black_box(3)));
        }
        Err(why) => text_of(why),
    }
    match orders.poll() {
        Some(Notice::Ended(Some(why))) => {
            black_box(why.text());
            text_of(why);
        }
        Some(Notice::Refused(why)) => {
            black_box(Refusal::text(why));
            text_of(why);
        }
        _ => {}
    }
    orders.brake(black_box(Reason::Cancelled));
    let is_braking = orders.status().is_some_and(|s| s.phase == Phase::Braking);
    black_box((is_braking, shared.status(), orders.running(), orders.is_decided()));
    Ok(())
}

fn look_at(report: &StreamReport) {
    let late = &report.lateness;
    black_box((late.quantile_us(black_box(0.99)), late.longest_us(), late.missed(), late.ticks()));
    let mut more = late.clone();
    more.note(black_box(7), black_box(5000));
    black_box((more, report.sent, report.failed));
}

/// Where a program without an operating system begins.
// SAFETY: nothing else is called _start, for the C runtime's is left out.
#[unsafe(no_mangle)]
pub extern "C" fn _start() -> ! {
    let shared = Shared::default();
    loop {
        let mut queue = OrderQueue::new();
        let (given, taken) = queue.split();
        let mut orders = Orders::new(given, &shared);
        if let Err(why) = plan(&mut orders, &shared) {
            text_of(why);
        }
        let watch = black_box(Watch {
            frame_age_us: 500_000,
            heartbeat_age_us: Some(200_000),
            longest_gap_us: 50_000,
        });
        let stream = Stream::new(taken, &shared, black_box("LINKAGE_SETPOINT"), watch);
        let mut stream = stream.counting_from(black_box(17));
        let mut out = [0; linkage_realtime::DATAGRAM_CAPACITY];
        black_box(stream.tick(black_box(5000), black_box(7), &mut out).is_ok());
        stream.sent(black_box(5000), black_box(false));
        black_box(stream.repeat_last(black_box(6000), black_box(8), &mut out).is_ok());
        stream.end();
        black_box(stream.is_at_rest());
        let period = NonZeroU64::new(black_box(5_000_000)).unwrap_or(NonZeroU64::MAX);
        look_at(&Cycle::new(stream, period).run(&mut Unknown));
    }
}
