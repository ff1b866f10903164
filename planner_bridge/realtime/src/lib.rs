//! The half of the planner bridge that meets deadlines: motions are sampled, braked when they must
//! not run on, encoded into a fixed buffer as LCM datagrams, and sent when they are due.
//!
//! ```text
//!  planner ── Orders ──► queue ──► Stream ◄── Cycle ── Port: clock and network
//!     ▲                              │ ▲
//!     └────────── Shared ◄───────────┘ └── Shared: frames seen, heartbeat, cancellation
//! ```
//!
//! Nothing here allocates, locks, panics or loops without a bound, and there is no `std`: it runs
//! on a microcontroller as it runs on a host. `tools/check-realtime` proves it by linking without
//! an allocator, an operating system or anything to panic with.
#![no_std]
#![forbid(unsafe_code)]

mod brake;
mod cycle;
mod datagram;
mod host_clock;
mod lateness;
mod motion;
mod orders;
mod reason;
mod segment;
mod shared;
#[cfg(test)]
mod stop_tests;
mod stream;
#[cfg(test)]
mod stream_tests;

pub use brake::{Stop, stop};
pub use cycle::{Cycle, Port, StreamReport};
pub use datagram::{DATAGRAM_CAPACITY, SETPOINT_FINGERPRINT, SETPOINT_SCHEMA, TooLong};
pub use lateness::Lateness;
pub use motion::{JointMotion, MAX_JOINTS, MAX_SEGMENTS, Motion, Name};
pub use orders::{Moving, NotNow, Notice, Orders};
pub use reason::{Reason, Refusal};
pub use segment::{Bounds, Limits, MotionError, Sample, Segment};
pub use shared::{Phase, Shared, Status};
pub use stream::{Order, OrderQueue, Stream, Tick, Watch};
