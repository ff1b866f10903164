//! Sending to a multicast group.

use super::datagram::{MAX_SHORT, part_header, parts, short_header};
use socket2::{SockAddr, Socket};
use std::io::{self, IoSlice};
use std::net::SocketAddrV4;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Most bytes of a message that LCM's receivers take.
const MAX_MESSAGE: usize = 1 << 28;

/// Parts that are sent at once: as many as the buffer of a receiver holds that asks for no larger
/// one (208 KiB on Linux, of which the system's bookkeeping takes half).
const PARTS_AT_ONCE: u16 = 2;
/// Pause before each further part. Without it 5 of 141 images of 300 kB reached such a receiver on
/// a busy computer, with it 140.
const PAUSE: Duration = Duration::from_micros(300);

/// A socket that sends whole datagrams to a group, without allocating.
#[derive(Debug)]
pub struct DatagramSender {
    socket: Socket,
    group: SockAddr,
}

impl DatagramSender {
    pub(super) fn new(socket: Socket, group: SocketAddrV4) -> Self {
        Self { socket, group: group.into() }
    }

    /// Whether to fail at once, with [`io::ErrorKind::WouldBlock`], where the system would wait.
    ///
    /// # Errors
    /// Those of the system.
    pub fn set_nonblocking(&self, nonblocking: bool) -> io::Result<()> {
        self.socket.set_nonblocking(nonblocking)
    }

    /// Sends a datagram.
    ///
    /// # Errors
    /// Those of the system.
    pub fn send(&self, datagram: &[u8]) -> io::Result<()> {
        self.socket.send_to(datagram, &self.group).map(|_| ())
    }

    /// Sends a datagram whose bytes lie in several places.
    fn send_pieces(&self, pieces: &[IoSlice]) -> io::Result<()> {
        self.socket.send_to_vectored(pieces, &self.group).map(|_| ())
    }
}

/// Sends messages, numbered one after the other.
#[derive(Debug)]
pub(crate) struct Publisher {
    socket: DatagramSender,
    /// Number of the next message. It is locked while one is sent, for its parts must follow
    /// each other.
    sequence: Mutex<u32>,
}

impl Publisher {
    pub fn new(socket: DatagramSender) -> Self {
        Self { socket, sequence: Mutex::new(0) }
    }

    /// The socket.
    pub fn socket(&self) -> &DatagramSender {
        &self.socket
    }

    /// Sends a message on a channel that can be one. A long one takes 5 ms a megabyte.
    pub fn publish(&self, channel: &str, message: &[u8]) -> io::Result<()> {
        let too_large = || {
            let most = format!("LCM carries at most {MAX_MESSAGE} bytes");
            io::Error::new(io::ErrorKind::InvalidInput, most)
        };
        if message.len() > MAX_MESSAGE {
            return Err(too_large());
        }
        let mut next = self.sequence.lock().unwrap_or_else(PoisonError::into_inner);
        let sequence = *next;
        *next = sequence.wrapping_add(1);
        let name = [IoSlice::new(channel.as_bytes()), IoSlice::new(&[0])];
        if channel.len() + 1 + message.len() <= MAX_SHORT {
            let header = short_header(sequence);
            let pieces = [IoSlice::new(&header), name[0], name[1], IoSlice::new(message)];
            return self.socket.send_pieces(&pieces);
        }
        for part in parts(channel, message).ok_or_else(too_large)? {
            if part.number >= PARTS_AT_ONCE {
                std::thread::sleep(PAUSE);
            }
            let header = part_header(sequence, &part);
            let (header, bytes) = (IoSlice::new(&header), IoSlice::new(part.bytes));
            if part.number == 0 {
                self.socket.send_pieces(&[header, name[0], name[1], bytes])?;
            } else {
                self.socket.send_pieces(&[header, bytes])?;
            }
        }
        Ok(())
    }
}
