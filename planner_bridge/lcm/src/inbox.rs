//! Packets that wait to be taken, bounded in number and bytes.

use crate::packet::Packet;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Packets that wait at most; when more come, the oldest are dropped.
const MAX_PACKETS: usize = 1024;
/// Bytes of packets that wait at most; when more come, the oldest are dropped.
const MAX_BYTES: usize = 128 << 20;

/// A queue between the thread that receives and those who take.
#[derive(Debug, Default)]
pub(crate) struct Inbox {
    waiting: Mutex<Waiting>,
    news: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    packets: VecDeque<Packet>,
    bytes: usize,
    pushed_out: u64,
    /// Why nothing more can be received, until something is.
    failure: Option<String>,
}

impl Inbox {
    /// Adds a packet; the oldest ones are dropped where there is no room.
    pub fn push(&self, packet: Packet) {
        let mut waiting = self.lock();
        waiting.bytes += packet.bytes.len();
        waiting.packets.push_back(packet);
        waiting.failure = None;
        // One packet is always kept, however large.
        while waiting.packets.len() > 1
            && (waiting.packets.len() > MAX_PACKETS || waiting.bytes > MAX_BYTES)
        {
            waiting.pop();
            waiting.pushed_out += 1;
        }
        drop(waiting);
        self.news.notify_one();
    }

    /// Tells those who wait that nothing can be received.
    pub fn fail(&self, reason: String) {
        self.lock().failure = Some(reason);
        self.news.notify_one();
    }

    /// Takes the oldest packet; `None` when none comes in time.
    ///
    /// # Errors
    /// Why nothing can be received.
    pub fn pop(&self, timeout: Duration) -> Result<Option<Packet>, String> {
        let until = Instant::now().checked_add(timeout);
        let mut waiting = self.lock();
        loop {
            if let Some(packet) = waiting.pop() {
                return Ok(Some(packet));
            }
            if let Some(reason) = waiting.failure.take() {
                return Err(reason);
            }
            let left = until.map_or(timeout, |u| u.saturating_duration_since(Instant::now()));
            if left.is_zero() {
                return Ok(None);
            }
            waiting =
                self.news.wait_timeout(waiting, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Packets that were pushed out.
    pub fn pushed_out(&self) -> u64 {
        self.lock().pushed_out
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn pop(&mut self) -> Option<Packet> {
        let packet = self.packets.pop_front()?;
        self.bytes -= packet.bytes.len();
        Some(packet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(bytes: usize) -> Packet {
        Packet {
            channel: "C".into(),
            bytes: vec![0; bytes],
            received_utime: bytes as i64,
            sender: None,
        }
    }

    #[test]
    fn the_oldest_packets_give_way_to_many_and_to_large_ones() {
        let inbox = Inbox::default();
        (0..MAX_PACKETS + 3).for_each(|n| inbox.push(packet(n)));
        assert_eq!(inbox.pushed_out(), 3);
        assert_eq!(inbox.pop(Duration::ZERO).unwrap().unwrap().received_utime, 3);
        inbox.push(packet(MAX_BYTES));
        assert_eq!(inbox.pop(Duration::ZERO).unwrap().unwrap().bytes.len(), MAX_BYTES);
        assert_eq!(inbox.pop(Duration::ZERO), Ok(None));
    }

    #[test]
    fn a_failure_is_told_once_and_ends_no_reception() {
        let inbox = Inbox::default();
        inbox.fail("the network is down".into());
        assert_eq!(inbox.pop(Duration::from_secs(9)), Err("the network is down".into()));
        assert_eq!(inbox.pop(Duration::from_millis(1)), Ok(None));
        inbox.push(packet(1));
        assert_eq!(inbox.pop(Duration::MAX), Ok(Some(packet(1))));
    }
}
