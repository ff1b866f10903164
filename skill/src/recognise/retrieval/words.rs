//! Words of an object, as the index needs them: for each feature its list (word, kind and metric size), and a code
//! that distinguishes it from others of that word.

use super::vocabulary::{Coded, Vocabulary, WORDS};
use crate::features::FeatureKind;
use crate::features::quantised::bytes_of;
use crate::object::appearance::{Appearance, ModelFeature};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Number of size steps per octave.
const SIZE_STEPS: f32 = 4.0;

/// Features of an object as the index needs them: number of the list and code of each, as stored.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Words(Vec<u8>);

/// Size of a list's number and a code, bytes.
const WORD_BYTES: usize = size_of::<u32>() + size_of::<u64>();

impl Words {
    /// Words of an object: of each part the features that most keyframes confirm, which come first. If an object has
    /// few, features of its room are added.
    pub fn of(appearance: &Appearance) -> Self {
        let vocabulary = Vocabulary::standard();
        let parts: HashSet<u16> = appearance.features.iter().map(|f| f.part).collect();
        let mut taken: HashMap<(u16, FeatureKind), usize> = HashMap::new();
        let mut chosen: Vec<&ModelFeature> = appearance
            .features
            .iter()
            .filter(|f| {
                let count = taken.entry((f.part, f.kind)).or_default();
                *count += 1;
                *count <= most_of(f.kind) / parts.len()
            })
            .collect();
        for kind in [FeatureKind::Rectified, FeatureKind::Picture] {
            let own = chosen.iter().filter(|f| f.kind == kind).count();
            let of_room = appearance.room.iter().filter(|f| f.kind == kind);
            chosen.extend(of_room.take(most_of(kind).saturating_sub(own)));
        }
        let word_of = |f: &&ModelFeature| {
            let Coded { word, code } = vocabulary.words(&bytes_of(&f.descriptor))[0];
            let list = list_of(word, f.kind, size_step(f.size_m));
            let mut bytes = [0; WORD_BYTES];
            bytes[..4].copy_from_slice(&(list as u32).to_le_bytes());
            bytes[4..].copy_from_slice(&code.to_le_bytes());
            bytes
        };
        Self(chosen.par_iter().map(word_of).collect::<Vec<_>>().concat())
    }

    /// Stored form of the words.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Reads [`Self::as_bytes`]; `None` if the last word is incomplete.
    pub fn from_bytes(bytes: Vec<u8>) -> Option<Self> {
        bytes.len().is_multiple_of(WORD_BYTES).then_some(Self(bytes))
    }

    /// Lists and codes. A damaged word is assigned to another list.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, u64)> {
        let (words, _) = self.0.as_chunks::<WORD_BYTES>();
        words.iter().map(|&[a, b, c, d, ref code @ ..]| {
            (u32::from_le_bytes([a, b, c, d]) as usize % LISTS, u64::from_le_bytes(*code))
        })
    }
}

/// Largest number of an object's features of a kind that are indexed; rectified ones are more distinctive.
fn most_of(kind: FeatureKind) -> usize {
    match kind {
        FeatureKind::Rectified => 320,
        FeatureKind::Picture => 160,
        FeatureKind::Upright => 0,
    }
}

/// Number of size steps that are distinguished.
pub const SIZES: i8 = 32;
/// Smallest size step: 1 mm.
pub const SMALLEST: i8 = -8;
/// Number of kinds of features that are compared.
const KINDS: usize = 2;
/// Number of lists: one for each word, kind and size.
pub const LISTS: usize = WORDS * KINDS * SIZES as usize;

/// Number of the list of a word, kind and size.
pub fn list_of(word: u16, kind: FeatureKind, size: i8) -> usize {
    let kind = usize::from(kind == FeatureKind::Rectified);
    let size = size.saturating_sub(SMALLEST).clamp(0, SIZES - 1) as usize;
    (usize::from(word) * KINDS + kind) * SIZES as usize + size
}

/// Size step of a feature, by its size in metres.
pub fn size_step(size_m: f32) -> i8 {
    (SIZE_STEPS * (size_m.max(1e-6) / 0.004).log2()).round().clamp(-100.0, 100.0) as i8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::DESCRIPTOR_LENGTH;

    fn feature(kind: FeatureKind) -> ModelFeature {
        let descriptor = vec![20; DESCRIPTOR_LENGTH];
        ModelFeature { part: 0, kind, point: [0.0; 3], normal: [0.0; 3], size_m: 0.016, descriptor }
    }

    fn words(kinds: &[FeatureKind]) -> Words {
        let features = kinds.iter().map(|kind| feature(*kind)).collect();
        Words::of(&Appearance { features, ..Appearance::default() })
    }

    #[test]
    fn words_come_back_as_they_were_kept_and_not_in_part() {
        let words = words(&[FeatureKind::Picture, FeatureKind::Rectified]);
        assert_eq!(Words::from_bytes(words.as_bytes().to_vec()).unwrap(), words);
        assert!(Words::from_bytes(words.as_bytes()[1..].to_vec()).is_none());
    }

    #[test]
    fn kinds_have_lists_of_their_own_and_earlier_ones_none() {
        let both = words(&[FeatureKind::Picture, FeatureKind::Rectified, FeatureKind::Upright]);
        let lists: Vec<usize> = both.iter().map(|(list, _)| list).collect();
        assert!(lists.len() == 2 && lists[0] != lists[1] && lists.iter().all(|l| *l < LISTS));
    }

    #[test]
    fn damaged_words_are_in_some_list() {
        let damaged = Words::from_bytes(vec![0xff; 9 * WORD_BYTES]).unwrap();
        assert!(damaged.iter().all(|(list, _)| list < LISTS));
    }
}
