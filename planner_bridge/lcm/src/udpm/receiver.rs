//! The thread that empties the socket, so that the system's buffer, which may be small, does not
//! overflow while the packets wait to be taken.

use super::network::Network;
use super::own::OwnAddresses;
use super::reassembly::{Counts, Reassembly};
use crate::inbox::Inbox;
use crate::packet::{Packet, Reception, host_utime};
use crate::subscriptions::Subscriptions;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Room for any datagram, bytes.
const ROOM: usize = 1 << 16;
/// Longest wait for a datagram before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(20);

/// Hears a network until it is dropped.
#[derive(Debug)]
pub(crate) struct Receiver {
    shared: Arc<Shared>,
    granted_buffer: usize,
    thread: Option<JoinHandle<()>>,
}

/// What the thread and those who take packets share.
#[derive(Debug, Default)]
struct Shared {
    inbox: Inbox,
    wanted: RwLock<Subscriptions>,
    counts: Mutex<Counts>,
    foreign: std::sync::atomic::AtomicU64,
    stop: AtomicBool,
}

impl Receiver {
    /// Joins the network's group.
    pub fn start(network: &Network) -> io::Result<Self> {
        let (socket, granted_buffer) = network.receiver()?;
        socket.set_read_timeout(Some(POLL))?;
        let shared = Arc::new(Shared::default());
        let ear = ReceiverThread {
            socket,
            shared: Arc::clone(&shared),
            own: network.own_addresses(),
            reassembly: Reassembly::default(),
        };
        let thread =
            std::thread::Builder::new().name("lcm".to_owned()).spawn(move || ear.listen())?;
        Ok(Self { shared, granted_buffer, thread: Some(thread) })
    }

    /// Receives from now on what is sent on channels that match, of at most this many bytes.
    pub fn subscribe(&self, channel: &str, max_bytes: usize) -> Result<(), regex::Error> {
        let mut wanted = self.shared.wanted.write().unwrap_or_else(PoisonError::into_inner);
        wanted.add(channel, max_bytes)
    }

    /// The next packet; `None` when none comes in time.
    pub fn receive(&self, timeout: Duration) -> Result<Option<Packet>, String> {
        self.shared.inbox.pop(timeout)
    }

    /// What was counted so far.
    pub fn reception(&self, network: &Network) -> Reception {
        let counts = *self.shared.counts.lock().unwrap_or_else(PoisonError::into_inner);
        Reception {
            received: counts.whole,
            lost: counts.lost,
            incomplete: counts.incomplete,
            pushed_out: self.shared.inbox.pushed_out(),
            oversized: counts.oversized,
            refused: counts.refused,
            foreign: self.shared.foreign.load(Ordering::Relaxed),
            requested_buffer: network.receive_buffer,
            granted_buffer: self.granted_buffer,
        }
    }
}

impl Drop for Receiver {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // The thread does not panic; if it did, a destructor could not report it.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// What the thread owns.
struct ReceiverThread {
    socket: UdpSocket,
    shared: Arc<Shared>,
    /// This host's addresses, where no other host is heard.
    own: Option<OwnAddresses>,
    reassembly: Reassembly,
}

impl ReceiverThread {
    fn listen(mut self) {
        let mut buffer = vec![0; ROOM];
        while !self.shared.stop.load(Ordering::Relaxed) {
            match self.socket.recv_from(&mut buffer) {
                Ok((length, from)) => self.take(from, buffer.get(..length).unwrap_or_default()),
                Err(e) if is_silence(&e) => self.reassembly.give_up_old(Instant::now()),
                Err(e) => {
                    self.shared.inbox.fail(e.to_string());
                    std::thread::sleep(POLL);
                }
            }
            self.tell_counts();
        }
    }

    fn tell_counts(&self) {
        let mut counts = self.shared.counts.lock().unwrap_or_else(PoisonError::into_inner);
        *counts = self.reassembly.counts();
    }

    fn take(&mut self, from: SocketAddr, datagram: &[u8]) {
        if self.own.as_mut().is_some_and(|own| !own.has(from.ip())) {
            self.shared.foreign.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let wanted = self.shared.wanted.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(whole) = self.reassembly.take(from, datagram, &wanted, Instant::now()) {
            // It is counted before it can be taken.
            self.tell_counts();
            self.shared.inbox.push(Packet {
                channel: whole.channel,
                bytes: whole.bytes,
                received_utime: host_utime(),
                sender: Some(from),
            });
        }
    }
}

fn is_silence(e: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(e.kind(), WouldBlock | TimedOut | Interrupted)
}
