//! Postings of the inverted index: for each feature of an object, its code and the number of the object, in the list
//! of its word, kind and size.

use super::words::{LISTS, Words};
use rayon::prelude::*;
use std::ops::Range;

/// Code and object of one feature.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Posting {
    /// Number of the object.
    pub object: u32,
    /// Code in two halves, the lower first: a u64 would leave gaps in memory.
    code: [u32; 2],
}

/// Size of a stored posting, bytes.
#[cfg(any(test, feature = "store"))]
const POSTING_BYTES: usize = 3 * size_of::<u32>();

impl Posting {
    fn new(object: u32, code: u64) -> Self {
        Self { code: [code as u32, (code >> 32) as u32], object }
    }

    /// Number of bits in which the code differs from another one.
    pub(super) fn bits_apart(&self, code: u64) -> u32 {
        let [low, high] = self.code.map(u64::from);
        ((low | high << 32) ^ code).count_ones()
    }

    /// Stored form of the posting.
    #[cfg(any(test, feature = "store"))]
    pub fn to_bytes(self) -> [u8; POSTING_BYTES] {
        let [low, high] = self.code;
        let mut bytes = [0; POSTING_BYTES];
        let (places, _) = bytes.as_chunks_mut();
        for (place, number) in places.iter_mut().zip([self.object, low, high]) {
            *place = number.to_le_bytes();
        }
        bytes
    }

    /// Postings whose [`Self::to_bytes`] follow each other; an incomplete last one is left out.
    #[cfg(any(test, feature = "store"))]
    pub fn all_from_bytes(bytes: &[u8]) -> impl Iterator<Item = Self> {
        let (postings, _) = bytes.as_chunks::<POSTING_BYTES>();
        postings.iter().map(|posting| {
            let (numbers, _) = posting.as_chunks();
            let [object, low, high] = [0, 1, 2].map(|i| u32::from_le_bytes(numbers[i]));
            Self { code: [low, high], object }
        })
    }
}

/// Postings of some objects in memory, by list.
pub struct Postings {
    shelves: Vec<Shelf>,
}

/// Postings of consecutive lists, one list after the other.
struct Shelf {
    lists: Range<usize>,
    /// Index of the first posting of each list, then the end of the last list.
    starts: Vec<u32>,
    postings: Vec<Posting>,
}

impl Postings {
    /// Postings of objects by their numbers; each list keeps the order of the objects.
    pub fn of(objects: &[(u32, Words)]) -> Self {
        let lists = LISTS.div_ceil(rayon::current_num_threads());
        let firsts: Vec<usize> = (0..LISTS).step_by(lists).collect();
        let shelf = |first: usize| Shelf::of(first..(first + lists).min(LISTS), objects);
        Self { shelves: firsts.into_par_iter().map(shelf).collect() }
    }

    /// Postings of one list.
    pub(super) fn list(&self, list: usize) -> &[Posting] {
        let shelf = &self.shelves[list / self.shelves[0].lists.len()];
        let own = list - shelf.lists.start;
        &shelf.postings[shelf.starts[own] as usize..shelf.starts[own + 1] as usize]
    }

    /// All lists that are not empty, in order.
    #[cfg(any(test, feature = "store"))]
    pub fn lists(&self) -> impl Iterator<Item = (usize, &[Posting])> {
        (0..LISTS).map(|list| (list, self.list(list))).filter(|(_, postings)| !postings.is_empty())
    }

    /// Size of the postings in memory, bytes.
    pub(super) fn bytes(&self) -> usize {
        self.shelves.iter().map(|shelf| size_of_val(&shelf.postings[..])).sum()
    }
}

impl Shelf {
    fn of(lists: Range<usize>, objects: &[(u32, Words)]) -> Self {
        let own = || {
            let all = objects.iter().flat_map(|(object, words)| {
                words.iter().map(|(list, code)| (list, Posting::new(*object, code)))
            });
            all.filter(|(list, _)| lists.contains(list))
        };
        let mut starts = vec![0; lists.len() + 1];
        own().for_each(|(list, _)| starts[list - lists.start + 1] += 1);
        for list in 0..lists.len() {
            starts[list + 1] += starts[list];
        }
        let mut next = starts.clone();
        let mut postings = vec![Posting::default(); starts[lists.len()] as usize];
        for (list, posting) in own() {
            let place = &mut next[list - lists.start];
            postings[*place as usize] = posting;
            *place += 1;
        }
        Self { lists, starts, postings }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn postings_come_back_as_they_were_kept_and_not_in_part() {
        let postings = [Posting::new(7, 0x0123_4567_89ab_cdef), Posting::new(u32::MAX, 1)];
        let kept = postings.map(Posting::to_bytes).concat();
        assert_eq!(Posting::all_from_bytes(&kept).collect::<Vec<_>>(), postings);
        assert_eq!(Posting::all_from_bytes(&kept[1..]).count(), 1);
    }
}
