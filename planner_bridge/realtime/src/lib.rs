//! The half of the planner bridge that meets deadlines: motions are sampled, setpoints are
//! encoded into a fixed buffer as LCM datagrams, orders come through a lock-free queue.
//!
//! Nothing here allocates, locks, panics or loops without a bound, and there is no `std`: it runs
//! on a microcontroller as it runs on a host. `tools/check-realtime` proves it by linking without
//! an allocator, an operating system or anything to panic with.
#![no_std]
#![forbid(unsafe_code)]

mod datagram;
mod lateness;
mod motion;
mod stream;

pub use datagram::{DATAGRAM_CAPACITY, SETPOINT_FINGERPRINT, TooLong};
pub use lateness::Lateness;
pub use motion::{JointMotion, MAX_JOINTS, MAX_SEGMENTS, Motion, Name, Sample, Segment, TooMuch};
pub use stream::{OrderQueue, Orders, Stream, Tick};
