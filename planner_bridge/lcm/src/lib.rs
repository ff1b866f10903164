//! LCM: message types generated from `types/*.lcm`, their codec, and transport: over multicast
//! in Rust, over other networks through liblcm.
//!
//! The codec is plain Rust and gives the bytes that lcm-gen's C gives. Decoding never
//! trusts a length: what a packet claims to hold is compared with what is left of it.

pub mod codec;
mod error;
mod inbox;
pub mod log;
pub mod messages;
mod packet;
mod subscriptions;
pub mod transport;
pub mod udpm;

pub use codec::{DecodeError, EncodeError, Message, decode, encode};
pub use error::LcmError;
pub use log::{Event, LogReader, LogWriter};
pub use packet::{Packet, Reception};
pub use subscriptions::Subscriptions;
pub use transport::{DEFAULT_MAX_BYTES, Lcm, Subscription};

/// The default network: this host only.
pub const DEFAULT_URL: &str = "udpm://239.255.76.67:7667?ttl=0";
