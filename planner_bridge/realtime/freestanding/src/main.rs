//! Everything that the real-time half does, reached from an entry point without `std`. The panic
//! handler calls a function that does not exist: if any panic can be reached, this does not link.
#![no_std]
#![no_main]

#[cfg(feature = "allocates")]
extern crate alloc;
#[cfg(feature = "uses-std")]
extern crate std;

use core::hint::black_box;
use linkage_realtime::{
    DATAGRAM_CAPACITY, JointMotion, Lateness, Motion, OrderQueue, Segment, Stream, Tick,
};

unsafe extern "C" {
    fn the_realtime_half_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    // SAFETY: never executed: a program that holds this call does not link.
    unsafe { the_realtime_half_can_panic() }
}

/// The motion of one joint, from values that the compiler cannot know.
fn ordered() -> Option<Motion> {
    let mut motion = Motion::new(black_box("door")).ok()?;
    let segments = black_box([Segment::default(); 3]);
    let segments = segments.get(..black_box(2))?;
    let joint = JointMotion::new(black_box("joint1"), segments, black_box(1.5), black_box(0.3));
    motion.push(joint.ok()?).ok()?;
    Some(motion)
}

/// Where a program without an operating system begins.
// SAFETY: nothing else is called _start, for the C runtime's is left out.
#[unsafe(no_mangle)]
pub extern "C" fn _start() -> ! {
    let mut queue = OrderQueue::new();
    let (mut orders, taken) = queue.split();
    let mut stream = Stream::new(taken, black_box("LINKAGE_SETPOINT"));
    let mut lateness = Lateness::default();
    let mut out = [0; DATAGRAM_CAPACITY];
    loop {
        let _ = orders.enqueue(ordered());
        if let Ok(Tick::Send(length)) = stream.tick(black_box(5000), &mut out) {
            black_box(out.get(..black_box(length)));
        }
        lateness.note(black_box(7), black_box(5000));
        black_box((lateness.quantile_us(black_box(0.99)), lateness.longest_us()));
        #[cfg(feature = "allocates")]
        black_box(alloc::vec::Vec::<u8>::with_capacity(black_box(9)));
        #[cfg(feature = "panics")]
        black_box(out[black_box(7)]);
    }
}
