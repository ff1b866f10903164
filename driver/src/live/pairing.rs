//! Colour and depth that arrive apart are paired by their times.

use std::collections::VecDeque;

/// Pictures of one kind that wait for a partner at most.
const WAITING: usize = 4;

/// A pair.
#[derive(Debug, PartialEq, Eq)]
pub struct Paired<C, D> {
    /// Time of the colour picture, microseconds.
    pub utime: i64,
    /// Colour.
    pub color: C,
    /// Depth.
    pub depth: D,
}

/// Pairs each colour picture with the depth picture nearest in time.
#[derive(Debug)]
pub struct Pairing<C, D> {
    max_gap_us: i64,
    colors: VecDeque<(i64, C)>,
    depths: VecDeque<(i64, D)>,
    unpaired: u64,
    largest_gap_us: i64,
}

impl<C, D> Pairing<C, D> {
    /// Pairs within a gap.
    pub fn new(max_gap_us: i64) -> Self {
        Self {
            max_gap_us,
            colors: VecDeque::new(),
            depths: VecDeque::new(),
            unpaired: 0,
            largest_gap_us: 0,
        }
    }

    /// Takes a colour picture.
    pub fn color(&mut self, utime: i64, color: C) -> Option<Paired<C, D>> {
        self.colors.push_back((utime, color));
        self.pair()
    }

    /// Takes a depth picture.
    pub fn depth(&mut self, utime: i64, depth: D) -> Option<Paired<C, D>> {
        self.depths.push_back((utime, depth));
        self.pair()
    }

    /// Pictures that found no partner, and the largest gap within a pair, microseconds.
    pub fn losses(&self) -> (u64, i64) {
        (self.unpaired, self.largest_gap_us)
    }

    fn pair(&mut self) -> Option<Paired<C, D>> {
        let nearest = self
            .colors
            .iter()
            .enumerate()
            .flat_map(|(i, c)| {
                self.depths.iter().enumerate().map(move |(j, d)| (gap_us(c.0, d.0), i, j))
            })
            .filter(|(gap, ..)| *gap <= self.max_gap_us)
            .min();
        if let Some((gap, i, j)) = nearest {
            // What is older than the pair has been passed over.
            self.unpaired += (i + j) as u64;
            self.largest_gap_us = self.largest_gap_us.max(gap);
            let (utime, color) = self.colors.drain(..=i).next_back()?;
            let (_, depth) = self.depths.drain(..=j).next_back()?;
            return Some(Paired { utime, color, depth });
        }
        if self.colors.len() > WAITING {
            self.colors.pop_front();
            self.unpaired += 1;
        }
        if self.depths.len() > WAITING {
            self.depths.pop_front();
            self.unpaired += 1;
        }
        None
    }
}

fn gap_us(a: i64, b: i64) -> i64 {
    i64::try_from(a.abs_diff(b)).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_paired_whichever_comes_first() {
        let mut pairing = Pairing::new(20_000);
        assert_eq!(pairing.depth(1_000, "d1"), None);
        let pair = pairing.color(9_000, "c1").unwrap();
        assert_eq!((pair.utime, pair.color, pair.depth), (9_000, "c1", "d1"));
        assert_eq!(pairing.color(42_000, "c2"), None);
        assert!(pairing.depth(34_000, "d2").is_some());
        assert_eq!(pairing.losses(), (0, 8_000));
    }

    #[test]
    fn what_was_missing_is_counted_once() {
        let mut pairing = Pairing::new(10_000);
        let mut pairs = 0;
        for k in 0..30 {
            pairs += usize::from(pairing.color(k * 33_000, ()).is_some());
            if k % 3 != 0 {
                pairs += usize::from(pairing.depth(k * 33_000 + 2_000, ()).is_some());
            }
        }
        assert_eq!(pairs, 20);
        assert_eq!(pairing.losses().0, 10);
    }

    #[test]
    fn drift_beyond_the_gap_leaves_all_unpaired_and_little_waiting() {
        let mut pairing = Pairing::new(5_000);
        for k in 0..100 {
            assert_eq!(pairing.color(k * 33_000, ()), None);
            assert_eq!(pairing.depth(k * 33_000 + 16_000, ()), None);
        }
        assert_eq!(pairing.losses().0, 200 - 2 * WAITING as u64);
    }
}
