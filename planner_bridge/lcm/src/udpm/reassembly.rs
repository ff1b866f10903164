//! Whole messages out of the datagrams of many senders, whatever they hold.
//!
//! Memory is taken for what has arrived, never for what a datagram claims. Messages that are not
//! whole yet are bounded in number, bytes and age.

use super::datagram::{Datagram, Part};
use super::senders::Senders;
use crate::subscriptions::Subscriptions;
use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;
use std::time::{Duration, Instant};

/// Messages that may be unfinished at once.
const MAX_UNFINISHED: usize = 64;
/// Messages of one sender that may be unfinished at once: a sender sends one after the other,
/// and the last parts of one may come late.
const MAX_UNFINISHED_OF_SENDER: usize = 2;
/// An unfinished message is given up when no part of it has come for this long.
const MAX_SILENCE: Duration = Duration::from_millis(500);
/// An unfinished message is given up when its first part came this long ago, however its parts keep coming: the
/// largest pictures take less than a second.
const MAX_AGE: Duration = Duration::from_secs(5);
/// Time between two looks for unfinished messages that are given up.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// What a part costs besides its bytes.
const PART_OVERHEAD: usize = 128;
/// Bytes that unfinished messages may take, however small the messages are that are wanted.
const LEAST_BUDGET: usize = 4 << 20;

/// A whole message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Whole {
    /// Its channel.
    pub channel: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// What was counted since the beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Whole messages.
    pub whole: u64,
    /// Messages of which nothing arrived: gaps in the numbers of senders that have sent something
    /// that is wanted. Such a sender's messages on other channels count too.
    pub lost: u64,
    /// Messages of which a part did not arrive.
    pub incomplete: u64,
    /// Datagrams that no LCM sends, and parts that do not fit the rest of their message.
    pub refused: u64,
    /// Messages larger than their channel's limit.
    pub oversized: u64,
}

/// Puts messages together.
#[derive(Debug, Default)]
pub struct Reassembly {
    unfinished: HashMap<(SocketAddr, u32), Unfinished>,
    senders: Senders,
    /// Bytes that the unfinished messages take.
    held: usize,
    looked: Option<Instant>,
    datagrams: u64,
    counts: Counts,
}

/// A message that is not whole yet.
#[derive(Debug)]
struct Unfinished {
    /// Absent until the first part has come.
    channel: Option<String>,
    size: u32,
    count: u16,
    /// The parts by their number. No two overlap, and neighbours touch each other.
    parts: BTreeMap<u16, Piece>,
    /// Bytes that it takes.
    held: usize,
    first_part: Instant,
    last_part: Instant,
    /// Datagrams that had come when its last part came: what tells the order of parts that come
    /// at one time.
    order: u64,
}

#[derive(Debug)]
struct Piece {
    offset: u32,
    bytes: Vec<u8>,
}

impl Reassembly {
    /// Takes a datagram of any bytes; a message when this was the last datagram that it needed.
    pub fn take(
        &mut self,
        from: SocketAddr,
        datagram: &[u8],
        wanted: &Subscriptions,
        now: Instant,
    ) -> Option<Whole> {
        self.give_up_old(now);
        self.datagrams += 1;
        let Ok(datagram) = Datagram::read(datagram) else {
            self.counts.refused += 1;
            return None;
        };
        let lost = self.senders.note(from, datagram.sequence(), now);
        self.counts.lost += u64::from(lost);
        let whole = match datagram {
            Datagram::Short { channel, bytes, .. } => self.take_short(from, channel, bytes, wanted),
            Datagram::Part { sequence, channel, part } => {
                self.take_part((from, sequence), channel, &part, wanted, now)
            }
        };
        self.counts.whole += u64::from(whole.is_some());
        whole
    }

    /// Gives up the messages of which nothing came for long, and those that are not whole after long.
    pub fn give_up_old(&mut self, now: Instant) {
        let since = |then: Instant| now.saturating_duration_since(then);
        if self.looked.is_some_and(|looked| since(looked) < LOOK_EVERY) {
            return;
        }
        self.looked = Some(now);
        let is_old =
            |u: &Unfinished| since(u.last_part) >= MAX_SILENCE || since(u.first_part) >= MAX_AGE;
        let old = self.unfinished.iter().filter(|(_, u)| is_old(u));
        for key in old.map(|(key, _)| *key).collect::<Vec<_>>() {
            self.give_up(key);
        }
    }

    /// What was counted.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Bytes that unfinished messages take.
    pub fn held_bytes(&self) -> usize {
        self.held
    }

    fn take_short(
        &mut self,
        from: SocketAddr,
        channel: &str,
        bytes: &[u8],
        wanted: &Subscriptions,
    ) -> Option<Whole> {
        let limit = wanted.limit_of(channel)?;
        self.want(&from);
        if bytes.len() > limit {
            self.counts.oversized += 1;
            return None;
        }
        Some(Whole { channel: channel.to_owned(), bytes: bytes.to_vec() })
    }

    fn take_part(
        &mut self,
        key: (SocketAddr, u32),
        channel: Option<&str>,
        part: &Part,
        wanted: &Subscriptions,
        now: Instant,
    ) -> Option<Whole> {
        if self.senders.get_mut(&key.0)?.is_done(key.1) {
            return None;
        }
        if !self.may_be_wanted(key, channel, part, wanted) {
            self.forget(key);
            return None;
        }
        if self.unfinished.get(&key).is_some_and(|message| !message.fits(channel, part)) {
            self.counts.refused += 1;
            return None;
        }
        let cost = part.bytes.len() + PART_OVERHEAD;
        self.make_room(key, cost, LEAST_BUDGET.max(2 * wanted.largest_limit()));
        if self.senders.get_mut(&key.0)?.is_done(key.1) {
            return None;
        }
        let message = self.unfinished.entry(key).or_insert_with(|| Unfinished::new(part, now));
        message.put(channel, part);
        (message.last_part, message.order) = (now, self.datagrams);
        message.held += cost;
        self.held += cost;
        if usize::from(message.count) > message.parts.len() {
            return None;
        }
        self.forget(key).and_then(Unfinished::whole)
    }

    /// Looks at channel and size before anything is kept. A part that names no channel is wanted
    /// if any message of its size is.
    fn may_be_wanted(
        &mut self,
        key: (SocketAddr, u32),
        channel: Option<&str>,
        part: &Part,
        wanted: &Subscriptions,
    ) -> bool {
        let Some(channel) = channel else {
            return part.size as usize <= wanted.largest_limit();
        };
        let Some(limit) = wanted.limit_of(channel) else { return false };
        self.want(&key.0);
        let fits = part.size as usize <= limit;
        self.counts.oversized += u64::from(!fits);
        fits
    }

    fn want(&mut self, from: &SocketAddr) {
        if let Some(sender) = self.senders.get_mut(from) {
            sender.is_wanted = true;
        }
    }

    /// Takes no more of a message; what was there of it.
    fn forget(&mut self, key: (SocketAddr, u32)) -> Option<Unfinished> {
        if let Some(sender) = self.senders.get_mut(&key.0) {
            sender.set_done(key.1);
        }
        let message = self.unfinished.remove(&key)?;
        self.held -= message.held;
        Some(message)
    }

    /// Forgets a message that will not be whole, and counts it if it was wanted.
    fn give_up(&mut self, key: (SocketAddr, u32)) {
        let is_wanted = self.senders.get_mut(&key.0).is_some_and(|sender| sender.is_wanted);
        if self.forget(key).is_some_and(|message| message.channel.is_some() || is_wanted) {
            self.counts.incomplete += 1;
        }
    }

    /// Gives up the messages of which nothing came for longest, so that some more bytes may be
    /// held of a message, which may be a new one.
    fn make_room(&mut self, key: (SocketAddr, u32), bytes: usize, budget: usize) {
        if !self.unfinished.contains_key(&key) {
            let of_sender = self.unfinished.keys().filter(|(from, _)| *from == key.0).count();
            if of_sender >= MAX_UNFINISHED_OF_SENDER {
                self.give_up_oldest(|(from, _)| *from == key.0);
            }
            if self.unfinished.len() >= MAX_UNFINISHED {
                self.give_up_oldest(|_| true);
            }
        }
        while self.held + bytes > budget && self.give_up_oldest(|_| true) {}
    }

    fn give_up_oldest(&mut self, of: impl Fn(&(SocketAddr, u32)) -> bool) -> bool {
        let candidates = self.unfinished.iter().filter(|(key, _)| of(key));
        let oldest = candidates.min_by_key(|(_, message)| message.order).map(|(key, _)| *key);
        oldest.map(|key| self.give_up(key)).is_some()
    }
}

impl Unfinished {
    fn new(part: &Part, now: Instant) -> Self {
        Self {
            channel: None,
            size: part.size,
            count: part.count,
            parts: BTreeMap::new(),
            held: 0,
            first_part: now,
            last_part: now,
            order: 0,
        }
    }

    /// Whether a part agrees with those that are there, and is not there yet.
    fn fits(&self, channel: Option<&str>, part: &Part) -> bool {
        let before = self.parts.range(..part.number).next_back();
        let after = self.parts.range(part.number..).next();
        self.size == part.size
            && self.count == part.count
            && (channel.is_none() || self.channel.is_none())
            && before.is_none_or(|(number, piece)| {
                let end = u64::from(piece.offset) + piece.bytes.len() as u64;
                let (touches, start) = (number + 1 == part.number, u64::from(part.offset));
                if touches { end == start } else { end < start }
            })
            && after.is_none_or(|(number, piece)| {
                let start = u64::from(piece.offset);
                let touches = part.number.checked_add(1) == Some(*number);
                *number != part.number
                    && if touches { part.end() == start } else { part.end() < start }
            })
    }

    fn put(&mut self, channel: Option<&str>, part: &Part) {
        if let Some(channel) = channel {
            self.channel = Some(channel.to_owned());
        }
        let piece = Piece { offset: part.offset, bytes: part.bytes.to_vec() };
        self.parts.insert(part.number, piece);
    }

    /// The message, all of whose parts are there.
    fn whole(self) -> Option<Whole> {
        let mut bytes = Vec::with_capacity(self.parts.values().map(|p| p.bytes.len()).sum());
        for piece in self.parts.into_values() {
            bytes.extend(piece.bytes);
        }
        Some(Whole { channel: self.channel?, bytes })
    }
}

#[cfg(test)]
mod tests {
    use super::super::datagram::{MAX_FRAGMENT, part_header, parts, short_header};
    use super::*;
    use proptest::prelude::*;
    use std::net::Ipv4Addr;

    const LIMIT: usize = 1 << 20;

    fn wanted() -> Subscriptions {
        let mut wanted = Subscriptions::default();
        wanted.add("IMAGES", LIMIT).unwrap();
        wanted
    }

    fn from(port: u16) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, port).into()
    }

    fn short(sequence: u32, channel: &str, bytes: &[u8]) -> Vec<u8> {
        [&short_header(sequence)[..], channel.as_bytes(), &[0], bytes].concat()
    }

    /// A part of a message on a channel as it is sent.
    fn datagram(sequence: u32, channel: &str, part: &Part) -> Vec<u8> {
        let name = if part.number == 0 { [channel.as_bytes(), &[0]].concat() } else { vec![] };
        [&part_header(sequence, part), &name[..], part.bytes].concat()
    }

    fn datagrams(sequence: u32, channel: &str, message: &[u8]) -> Vec<Vec<u8>> {
        parts(channel, message).unwrap().map(|part| datagram(sequence, channel, &part)).collect()
    }

    /// A message cut into parts of any lengths, the first of which may be empty.
    fn cut(message: &[u8], lengths: &[usize]) -> Vec<Vec<u8>> {
        let mut pieces = Vec::new();
        let mut offset = 0;
        for length in lengths.iter().copied().chain([message.len()]) {
            let end = message.len().min(offset + length);
            if offset < end || pieces.is_empty() {
                pieces.push((offset, &message[offset..end]));
            }
            offset = end;
        }
        let count = pieces.len() as u16;
        let size = message.len() as u32;
        let part = |(number, (offset, bytes)): (usize, &(usize, &[u8]))| {
            let (offset, number) = (*offset as u32, number as u16);
            datagram(5, "IMAGES", &Part { size, offset, number, count, bytes })
        };
        pieces.iter().enumerate().map(part).collect()
    }

    struct Network {
        reassembly: Reassembly,
        now: Instant,
    }

    impl Network {
        fn new() -> Self {
            Self { reassembly: Reassembly::default(), now: Instant::now() }
        }

        fn take(&mut self, port: u16, datagram: &[u8]) -> Option<Whole> {
            self.reassembly.take(from(port), datagram, &wanted(), self.now)
        }

        fn pass(&mut self, time: Duration) {
            self.now += time;
            self.reassembly.give_up_old(self.now);
        }
    }

    fn image(length: usize) -> Vec<u8> {
        (0..length).map(|i| (i * 31 % 251) as u8).collect()
    }

    #[test]
    fn a_message_is_whole_with_its_last_part() {
        let mut network = Network::new();
        let message = image(3 * MAX_FRAGMENT);
        let all = datagrams(0, "IMAGES", &message);
        let (last, first) = all.split_last().unwrap();
        assert!(first.iter().all(|d| network.take(1, d).is_none()));
        let whole = network.take(1, last).unwrap();
        assert!(whole.channel == "IMAGES" && whole.bytes == message);
        assert_eq!(network.reassembly.held_bytes(), 0);
        assert_eq!(network.reassembly.counts(), Counts { whole: 1, ..Counts::default() });
    }

    #[test]
    fn what_a_fragment_claims_takes_no_memory() {
        let mut network = Network::new();
        let bytes = [7; 1000];
        for port in 0..40 {
            let claim =
                Part { size: 268_000_000, offset: 0, number: 0, count: 4100, bytes: &bytes };
            assert_eq!(network.take(port, &datagram(0, "IMAGES", &claim)), None);
            let within = Part { size: LIMIT as u32, ..claim };
            assert_eq!(network.take(port, &datagram(1, "IMAGES", &within)), None);
        }
        assert_eq!(network.reassembly.counts().oversized, 40);
        assert!(network.reassembly.held_bytes() <= 40 * (1000 + PART_OVERHEAD));
    }

    #[test]
    fn messages_that_are_not_subscribed_to_take_no_memory() {
        let mut network = Network::new();
        for datagram in datagrams(0, "OTHER_IMAGES", &image(300_000)) {
            assert_eq!(network.take(1, &datagram), None);
            assert_eq!(network.reassembly.held_bytes(), 0);
        }
        network.pass(Duration::from_secs(1));
        assert_eq!(network.reassembly.counts(), Counts::default());
    }

    #[test]
    fn a_message_whose_part_was_lost_is_counted_and_forgotten() {
        let mut network = Network::new();
        for (sequence, lost) in [(0, 0), (1, 2), (2, 4)] {
            for (number, datagram) in
                datagrams(sequence, "IMAGES", &image(300_000)).iter().enumerate()
            {
                if number != lost {
                    assert_eq!(network.take(1, datagram), None);
                }
            }
        }
        network.pass(Duration::from_secs(1));
        assert_eq!(network.reassembly.counts(), Counts { incomplete: 3, ..Counts::default() });
        assert_eq!(network.reassembly.held_bytes(), 0);
    }

    #[test]
    fn messages_that_were_lost_altogether_are_counted() {
        let mut network = Network::new();
        for sequence in [0, 1, 4, 5] {
            network.take(1, &short(sequence, "IMAGES", b"abc"));
        }
        // Of this one nothing is wanted, so nothing is missed.
        network.take(2, &short(0, "OTHER", b"abc"));
        network.take(2, &short(9, "OTHER", b"abc"));
        assert_eq!(network.reassembly.counts(), Counts { whole: 4, lost: 2, ..Counts::default() });
    }

    #[test]
    fn parts_that_do_not_fit_their_message_are_refused_and_the_rest_is_whole() {
        let mut network = Network::new();
        let message = image(30);
        let all = cut(&message, &[10, 10]);
        assert_eq!(network.take(1, &all[0]), None);
        assert_eq!(network.take(1, &all[2]), None);
        let second = Part { size: 30, offset: 10, number: 1, count: 3, bytes: &message[10..20] };
        for wrong in [
            Part { size: 31, ..second },
            Part { count: 4, ..second },
            Part { offset: 9, ..second },
            Part { offset: 11, ..second },
            Part { bytes: &message[10..19], ..second },
            Part { bytes: &message[10..21], ..second },
        ] {
            assert_eq!(network.take(1, &datagram(5, "IMAGES", &wrong)), None);
        }
        assert_eq!(network.take(1, &all[0]), None, "a part that comes again");
        assert_eq!(network.take(1, &all[1]).map(|w| w.bytes), Some(message));
        assert_eq!(network.reassembly.counts().refused, 7);
    }

    #[test]
    fn a_flood_of_unfinished_messages_stays_within_its_budget() {
        let mut network = Network::new();
        let bytes = vec![1; 60_000];
        let budget = LEAST_BUDGET.max(2 * LIMIT);
        for round in 0..2000_u32 {
            let port = (round % 500) as u16;
            let part = Part { size: LIMIT as u32, offset: 0, number: 0, count: 17, bytes: &bytes };
            network.take(port, &datagram(round, "IMAGES", &part));
            assert!(network.reassembly.held_bytes() <= budget);
            assert!(network.reassembly.unfinished.len() <= MAX_UNFINISHED);
        }
        let mut whole = None;
        for datagram in datagrams(0, "IMAGES", &image(500_000)) {
            whole = network.take(60_000, &datagram);
        }
        assert!(whole.is_some_and(|w| w.bytes == image(500_000)));
        network.pass(Duration::from_secs(1));
        assert_eq!(network.reassembly.held_bytes(), 0);
    }

    #[test]
    fn a_message_whose_parts_drip_in_for_ever_is_given_up() {
        let mut network = Network::new();
        let all = cut(&image(1000), &vec![1; 1000]);
        for (i, datagram) in all[..all.len() - 1].iter().enumerate() {
            assert_eq!(network.take(1, datagram), None);
            network.pass(Duration::from_millis(450));
            let is_over = 0.45 * (i + 1) as f64 >= MAX_AGE.as_secs_f64();
            assert_eq!(network.reassembly.held_bytes() == 0, is_over, "after {} parts", i + 1);
        }
        assert_eq!(network.reassembly.counts().incomplete, 1);
    }

    #[test]
    fn many_small_parts_are_within_the_budget_too() {
        let mut network = Network::new();
        let message = image(60_000);
        let all = cut(&message, &vec![1; 60_000]);
        for datagram in &all[..all.len() - 1] {
            assert_eq!(network.take(1, datagram), None);
            assert!(network.reassembly.held_bytes() <= LEAST_BUDGET);
        }
    }

    proptest! {
        #[test]
        fn parts_of_any_lengths_in_any_order_give_the_message(
            message in proptest::collection::vec(any::<u8>(), 0..400),
            lengths in proptest::collection::vec(0_usize..60, 0..20),
            order in any::<u64>(),
        ) {
            let mut all = cut(&message, &lengths);
            // A permutation told by a number.
            let mut seed = order;
            for i in (1..all.len()).rev() {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                all.swap(i, (seed >> 33) as usize % (i + 1));
            }
            let mut network = Network::new();
            let wholes: Vec<Whole> = all.iter().filter_map(|d| network.take(1, d)).collect();
            prop_assert_eq!(wholes, [Whole { channel: "IMAGES".into(), bytes: message }]);
            prop_assert_eq!(network.reassembly.held_bytes(), 0);
        }

        #[test]
        fn no_parts_whatever_they_claim_break_it(
            parts in proptest::collection::vec(
                (0_u16..4, 0_u32..6, 0_u32..40, 0_u32..40, 0_u16..6, 0_u16..6, 0_usize..20),
                0..60,
            ),
        ) {
            let mut network = Network::new();
            for (port, sequence, size, offset, number, count, length) in parts {
                let bytes = image(length);
                let part = Part { size, offset, number, count, bytes: &bytes };
                if let Some(whole) = network.take(port, &datagram(sequence, "IMAGES", &part)) {
                    prop_assert_eq!(whole.bytes.len(), size as usize);
                }
                let held: usize = network.reassembly.unfinished.values().map(|m| m.held).sum();
                prop_assert_eq!(network.reassembly.held_bytes(), held);
            }
            network.pass(Duration::from_secs(1));
            prop_assert_eq!(network.reassembly.held_bytes(), 0);
        }
    }
}
