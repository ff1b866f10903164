//! LCM's multicast over UDP, in safe Rust: what a network sends is accepted only where it agrees
//! with what has arrived.
//!
//! liblcm 1.3 writes beyond its memory for a fragment whose offset wraps, hands out a length near
//! 2^32 for a datagram that is shorter than its header, and takes at once as much memory as any
//! fragment claims. Therefore nothing that comes from `udpm://` reaches it.

mod datagram;
mod network;
mod own;
mod reassembly;
mod receiver;
mod sender;
mod senders;

pub use datagram::{Datagram, DatagramError, MAX_CHANNEL, MAX_DATAGRAM, Part};
pub use network::{Network, NetworkError};
pub use reassembly::{Counts, Reassembly, Whole};
pub(crate) use receiver::Receiver;
pub use sender::DatagramSender;
pub(crate) use sender::Publisher;

use crate::error::LcmError;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// How long a self-test waits for one datagram before it sends the next.
const SELF_TEST_POLL: Duration = Duration::from_millis(50);

impl Network {
    /// Sends datagrams by a socket until one comes back: proof that the network carries what it
    /// sends.
    ///
    /// # Errors
    /// [`LcmError::Join`], [`LcmError::NoLoopback`] with what to do.
    pub fn self_test(&self, sender: &DatagramSender, wait: Duration) -> Result<(), LcmError> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let url = self.to_string();
        let join = |e: std::io::Error| LcmError::join(&url, e.to_string());
        let channel = format!(
            "LINKAGE_SELF_TEST_{}_{}",
            std::process::id(),
            NUMBER.fetch_add(1, Ordering::Relaxed)
        );
        let listener = Receiver::start(self).map_err(join)?;
        listener.subscribe(&channel, 0).map_err(|e| LcmError::join(&url, e.to_string()))?;
        let datagram = [&datagram::short_header(0)[..], channel.as_bytes(), &[0]].concat();
        let start = Instant::now();
        while start.elapsed() < wait {
            match sender.send(&datagram) {
                // One that does not wait; it is tried again.
                Err(e) if e.kind() == std::io::ErrorKind::WouldBlock => {}
                sent => sent.map_err(join)?,
            }
            if listener.receive(SELF_TEST_POLL).is_ok_and(|packet| packet.is_some()) {
                return Ok(());
            }
        }
        Err(LcmError::NoLoopback { url, waited: wait })
    }
}
