//! What a connection receives: packets, and counts of them.

use std::net::SocketAddr;
use std::time::{SystemTime, UNIX_EPOCH};

/// A received packet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packet {
    /// Channel.
    pub channel: String,
    /// Bytes, the fingerprint first.
    pub bytes: Vec<u8>,
    /// When it was received, microseconds.
    pub received_utime: i64,
    /// Who sent it; known of `udpm://` alone.
    pub sender: Option<SocketAddr>,
}

/// What a connection has received since it first subscribed, and what it has not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reception {
    /// Messages that were received.
    pub received: u64,
    /// Messages of which nothing arrived: gaps in the numbers of senders that have sent something
    /// that is subscribed to. Such a sender's messages on other channels count too.
    pub lost: u64,
    /// Messages of which a part did not arrive.
    pub incomplete: u64,
    /// Messages that were received and pushed out, for nobody took them in time.
    pub pushed_out: u64,
    /// Messages larger than their subscription allows.
    pub oversized: u64,
    /// Datagrams that no LCM sends.
    pub refused: u64,
    /// Datagrams of other hosts on a network of this host only (`ttl=0`).
    pub foreign: u64,
    /// The receive buffer that the system was asked for, bytes.
    pub requested_buffer: usize,
    /// The receive buffer that the system granted, bytes, without what Linux adds for its own
    /// bookkeeping; 0 where there is no socket.
    pub granted_buffer: usize,
}

impl Reception {
    /// Messages that were sent and will not be received, without those that are too large to be wanted
    /// ([`Self::oversized`]).
    pub fn missing(&self) -> u64 {
        self.lost + self.incomplete + self.pushed_out
    }
}

/// The host's time in microseconds.
pub(crate) fn host_utime() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_micros() as i64)
}
