//! Who sends, and which of their messages were never seen.

use std::collections::{HashMap, VecDeque};
use std::net::SocketAddr;
use std::time::Instant;

/// Senders that are remembered; the one that was silent longest is forgotten for a new one.
const MAX_SENDERS: usize = 256;
/// A number this much before the last one is that of a late datagram; an earlier one means that
/// the sender began again.
const LATE: u32 = 16;
/// More numbers than this are not lost at once: the sender began again, or is none.
const MAX_GAP: u32 = 1 << 16;
/// Messages of a sender that are remembered as done.
const REMEMBERED: usize = 4;

/// All senders of a network.
#[derive(Debug, Default)]
pub(super) struct Senders {
    known: HashMap<SocketAddr, Sender>,
}

/// A sender, told by its address and port.
#[derive(Debug)]
pub(super) struct Sender {
    /// The number after the last one that was seen.
    next: u32,
    last_seen: Instant,
    /// It has sent a message that is subscribed to.
    pub is_wanted: bool,
    /// Messages of which no more is taken: whole, given up, or not subscribed to.
    done: VecDeque<u32>,
}

impl Senders {
    /// Notes a datagram's number; how many messages were lost before this one.
    pub fn note(&mut self, from: SocketAddr, sequence: u32, now: Instant) -> u32 {
        if !self.known.contains_key(&from) && self.known.len() >= MAX_SENDERS {
            let silent = self.known.iter().min_by_key(|(_, s)| s.last_seen).map(|(a, _)| *a);
            silent.map(|address| self.known.remove(&address));
        }
        let sender = self.known.entry(from).or_insert_with(|| Sender {
            next: sequence,
            last_seen: now,
            is_wanted: false,
            done: VecDeque::new(),
        });
        let lost = sender.note(sequence, now);
        if sender.is_wanted { lost } else { 0 }
    }

    /// A sender that is remembered.
    pub fn get_mut(&mut self, from: &SocketAddr) -> Option<&mut Sender> {
        self.known.get_mut(from)
    }
}

impl Sender {
    fn note(&mut self, sequence: u32, now: Instant) -> u32 {
        self.last_seen = now;
        let ahead = sequence.wrapping_sub(self.next);
        let behind = self.next.wrapping_sub(sequence);
        if (1..=LATE).contains(&behind) {
            return 0;
        }
        self.next = sequence.wrapping_add(1);
        if ahead > MAX_GAP {
            self.done.clear();
            return 0;
        }
        ahead
    }

    /// No more is taken of a message.
    pub fn is_done(&self, sequence: u32) -> bool {
        self.done.contains(&sequence)
    }

    /// Takes no more of a message.
    pub fn set_done(&mut self, sequence: u32) {
        if self.done.len() == REMEMBERED {
            self.done.pop_front();
        }
        self.done.push_back(sequence);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    fn address(port: u16) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, port).into()
    }

    fn lost(sequences: &[u32]) -> Vec<u32> {
        let mut senders = Senders::default();
        let now = Instant::now();
        senders.note(address(1), sequences[0], now);
        senders.get_mut(&address(1)).unwrap().is_wanted = true;
        sequences.iter().map(|s| senders.note(address(1), *s, now)).collect()
    }

    #[test]
    fn numbers_that_are_left_out_are_lost_messages() {
        assert_eq!(lost(&[0, 1, 2, 5, 5, 6]), [0, 0, 0, 2, 0, 0]);
        assert_eq!(lost(&[u32::MAX - 1, u32::MAX, 0, 2]), [0, 0, 0, 1]);
    }

    #[test]
    fn a_late_datagram_and_a_new_beginning_lose_nothing() {
        assert_eq!(lost(&[7, 8, 7, 9]), [0; 4]);
        assert_eq!(lost(&[500, 0, 1, 2]), [0; 4]);
        assert_eq!(lost(&[0, 3_000_000_000, 3_000_000_001]), [0; 3]);
    }

    #[test]
    fn a_sender_of_which_nothing_is_wanted_loses_nothing() {
        let mut senders = Senders::default();
        let now = Instant::now();
        senders.note(address(1), 0, now);
        assert_eq!(senders.note(address(1), 9, now), 0);
    }

    #[test]
    fn a_flood_of_senders_is_not_remembered() {
        let mut senders = Senders::default();
        let now = Instant::now();
        for port in 0..2000 {
            senders.note(address(port), 0, now);
        }
        assert_eq!(senders.known.len(), MAX_SENDERS);
    }
}
