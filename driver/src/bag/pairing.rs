//! Pairs the colour and depth pictures of a bag: each colour picture with the depth picture nearest
//! in time, as a TUM recording does.
//!
//! A colour picture is decided on when a depth picture that is not earlier has come, so that the
//! nearest one is known. What waits is bounded in number and in bytes.

use std::collections::VecDeque;
use std::sync::Arc;

/// Pictures of one kind that wait at most.
const WAITING: usize = 90;
/// Bytes of both kinds that wait at most.
const WAITING_BYTES: usize = 512 << 20;

/// A picture with its time, as a message holds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stamped {
    /// Its time, microseconds.
    pub utime: i64,
    /// When it was recorded, microseconds.
    pub log_utime: i64,
    /// The message.
    pub bytes: Arc<Vec<u8>>,
}

/// Colour and depth of one time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pair {
    /// Colour.
    pub color: Stamped,
    /// Depth; it may belong to two pairs.
    pub depth: Stamped,
}

/// Takes pictures in any order of the two kinds.
#[derive(Debug)]
pub struct NearestPairing {
    max_gap_us: i64,
    colors: VecDeque<Stamped>,
    depths: VecDeque<Stamped>,
    waiting_bytes: usize,
    /// Colour pictures without depth.
    pub unpaired: u64,
    /// Largest difference of times within a pair, microseconds.
    pub largest_gap_us: i64,
    /// Least difference of times that was too large, microseconds.
    pub least_missed_us: Option<i64>,
}

impl NearestPairing {
    /// Pairs within a gap.
    pub fn new(max_gap_us: i64) -> Self {
        Self {
            max_gap_us,
            colors: VecDeque::new(),
            depths: VecDeque::new(),
            waiting_bytes: 0,
            unpaired: 0,
            largest_gap_us: 0,
            least_missed_us: None,
        }
    }

    /// Takes a colour picture.
    pub fn push_color(&mut self, color: Stamped) {
        self.waiting_bytes += color.bytes.len();
        self.colors.push_back(color);
    }

    /// Takes a depth picture.
    pub fn push_depth(&mut self, depth: Stamped) {
        self.waiting_bytes += depth.bytes.len();
        self.depths.push_back(depth);
        if self.depths.len() > WAITING {
            self.drop_depths(1);
        }
    }

    /// The next pair; `None` until more pictures come. At the end nothing is waited for.
    pub fn next_pair(&mut self, is_end: bool) -> Option<Pair> {
        loop {
            let color = self.colors.front()?;
            let is_known = self.depths.back().is_some_and(|d| d.utime >= color.utime);
            let is_full = self.colors.len() > WAITING || self.waiting_bytes > WAITING_BYTES;
            if !(is_known || is_end || is_full) {
                return None;
            }
            let color = self.colors.pop_front()?;
            self.waiting_bytes -= color.bytes.len();
            let gap = |d: &Stamped| gap_us(d.utime, color.utime);
            let nearest = self.depths.iter().enumerate().min_by_key(|(_, d)| gap(d));
            let Some((place, depth)) = nearest.map(|(place, d)| (place, d.clone())) else {
                self.unpaired += 1;
                continue;
            };
            let gap = gap(&depth);
            // Colour comes in the order of time: what is older than its depth is passed over.
            self.drop_depths(place);
            if gap <= self.max_gap_us {
                self.largest_gap_us = self.largest_gap_us.max(gap);
                return Some(Pair { color, depth });
            }
            self.unpaired += 1;
            self.least_missed_us = Some(self.least_missed_us.map_or(gap, |g| g.min(gap)));
        }
    }

    fn drop_depths(&mut self, count: usize) {
        let dropped: usize = self.depths.drain(..count).map(|d| d.bytes.len()).sum();
        self.waiting_bytes -= dropped;
    }
}

fn gap_us(a: i64, b: i64) -> i64 {
    i64::try_from(a.abs_diff(b)).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(utime: i64) -> Stamped {
        Stamped { utime, log_utime: utime, bytes: Arc::new(vec![0; 8]) }
    }

    /// The times of the pairs, in milliseconds; `c` and `d` before a time say what comes then.
    fn pairs(events: &[(char, i64)]) -> (Vec<(i64, i64)>, NearestPairing) {
        let mut pairing = NearestPairing::new(20_000);
        let mut pairs = Vec::new();
        for (kind, ms) in events {
            match kind {
                'c' => pairing.push_color(at(ms * 1000)),
                _ => pairing.push_depth(at(ms * 1000)),
            }
            pairs.extend(std::iter::from_fn(|| pairing.next_pair(false)));
        }
        pairs.extend(std::iter::from_fn(|| pairing.next_pair(true)));
        let times = pairs.iter().map(|p| (p.color.utime / 1000, p.depth.utime / 1000));
        (times.collect(), pairing)
    }

    #[test]
    fn the_nearest_depth_is_taken_not_the_first() {
        let events = [('d', 1000), ('c', 1016), ('d', 1017), ('c', 1049), ('d', 1050)];
        let (found, pairing) = pairs(&events);
        assert_eq!(found, [(1016, 1017), (1049, 1050)]);
        assert_eq!((pairing.unpaired, pairing.largest_gap_us), (0, 1000));
    }

    #[test]
    fn one_kind_may_be_recorded_long_after_the_other() {
        let mut events: Vec<(char, i64)> = (0..30).map(|i| ('d', 33 * i)).collect();
        events.extend((0..30).map(|i| ('c', 33 * i + 5)));
        assert_eq!(pairs(&events).0.len(), 30);
    }

    #[test]
    fn colour_beyond_the_gap_is_counted_and_the_gap_is_told() {
        let (found, pairing) = pairs(&[('c', 0), ('d', 50), ('c', 100), ('d', 130)]);
        assert!(found.is_empty());
        assert_eq!((pairing.unpaired, pairing.least_missed_us), (2, Some(30_000)));
    }

    #[test]
    fn what_waits_is_bounded() {
        let mut pairing = NearestPairing::new(20_000);
        for i in 0..1000 {
            pairing.push_depth(at(i * 33_000));
        }
        assert_eq!((pairing.depths.len(), pairing.waiting_bytes), (WAITING, WAITING * 8));
        let mut pairing = NearestPairing::new(20_000);
        for i in 0..1000 {
            pairing.push_color(at(i * 33_000));
            assert_eq!(pairing.next_pair(false), None);
        }
        assert_eq!((pairing.colors.len(), pairing.unpaired), (WAITING, 1000 - WAITING as u64));
    }
}
