//! RVL, a compression of depth without loss that is faster than PNG: A. D. Wilson, Fast lossless depth
//! image compression, ISS 2017.
//!
//! Pixels in rows are runs: a count of zeros, a count of others, then each of these as its difference
//! to the one before (the first one's to 0, none is set back between runs), which is folded so that
//! small differences of either sign are small numbers. Numbers are nibbles of three bits, the least
//! ones first; the nibble's highest bit says that another one follows. Eight nibbles, the highest
//! first, are a word of 32 bits, which lies in memory with its least byte first.

use crate::error::PictureFault;

/// Most nibbles of a number: 32 bits, three in a nibble.
const MAX_NIBBLES: u32 = 11;

/// Decodes this many pixels; what follows them is left alone.
///
/// # Errors
/// [`PictureFault::Damaged`] where the bytes end before, or hold what no encoder writes.
pub fn decode(bytes: &[u8], pixels: usize) -> Result<Vec<u16>, PictureFault> {
    let mut numbers = Numbers::new(bytes);
    let mut raw = Vec::with_capacity(pixels);
    let mut previous = 0_i64;
    while raw.len() < pixels {
        let zeros = numbers.count(pixels - raw.len())?;
        raw.resize(raw.len() + zeros, 0);
        if raw.len() == pixels {
            break;
        }
        let others = numbers.count(pixels - raw.len())?;
        if zeros + others == 0 {
            return Err(damaged("a run of no pixels"));
        }
        for _ in 0..others {
            previous += unfolded(numbers.next()?);
            let value = u16::try_from(previous).map_err(|_| damaged("depth beyond 16 bits"))?;
            raw.push(value);
        }
    }
    Ok(raw)
}

/// 0, -1, 1, -2, 2, … of 0, 1, 2, 3, 4, …
fn unfolded(number: u32) -> i64 {
    let half = i64::from(number >> 1);
    if number & 1 == 0 { half } else { -half - 1 }
}

fn damaged(reason: &str) -> PictureFault {
    PictureFault::Damaged(format!("damaged RVL: {reason}"))
}

/// Reads numbers one after the other.
struct Numbers<'b> {
    words: std::slice::Iter<'b, [u8; 4]>,
    word: u32,
    /// Nibbles of the word that are left, in its highest bits.
    left: u32,
}

impl<'b> Numbers<'b> {
    fn new(bytes: &'b [u8]) -> Self {
        Self { words: bytes.as_chunks().0.iter(), word: 0, left: 0 }
    }

    fn next(&mut self) -> Result<u32, PictureFault> {
        let mut number = 0_u64;
        for place in 0..MAX_NIBBLES {
            let nibble = self.nibble()?;
            number |= u64::from(nibble & 7) << (3 * place);
            if nibble & 8 == 0 {
                return u32::try_from(number).map_err(|_| damaged("a number beyond 32 bits"));
            }
        }
        Err(damaged("a number beyond 32 bits"))
    }

    /// A count of pixels of which no more than `most` are left.
    fn count(&mut self, most: usize) -> Result<usize, PictureFault> {
        let count = usize::try_from(self.next()?).unwrap_or(usize::MAX);
        if count > most { Err(damaged("more pixels than the picture has")) } else { Ok(count) }
    }

    fn nibble(&mut self) -> Result<u32, PictureFault> {
        if self.left == 0 {
            let word = self.words.next().ok_or_else(|| damaged("it ends too early"))?;
            (self.word, self.left) = (u32::from_le_bytes(*word), 8);
        }
        let nibble = self.word >> 28;
        self.word <<= 4;
        self.left -= 1;
        Ok(nibble)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Encodes as the paper tells it: nibbles first, then words.
    pub(crate) fn encode(raw: &[u16]) -> Vec<u8> {
        let mut numbers = Vec::new();
        let (mut rest, mut previous) = (raw, 0_i64);
        while !rest.is_empty() {
            let zeros = rest.iter().take_while(|v| **v == 0).count();
            let others = rest[zeros..].iter().take_while(|v| **v != 0).count();
            numbers.extend([zeros as u64, others as u64]);
            for value in rest[zeros..zeros + others].iter().map(|v| i64::from(*v)) {
                let step = value - previous;
                numbers.push(if step < 0 { (-2 * step - 1) as u64 } else { 2 * step as u64 });
                previous = value;
            }
            rest = &rest[zeros + others..];
        }
        words(&numbers)
    }

    fn words(numbers: &[u64]) -> Vec<u8> {
        let mut nibbles = Vec::new();
        for number in numbers {
            let mut left = *number;
            while left >= 8 {
                nibbles.push(left as u32 & 7 | 8);
                left >>= 3;
            }
            nibbles.push(left as u32);
        }
        let word = |eight: &[u32]| {
            let places = eight.iter().enumerate();
            places.fold(0, |word, (i, nibble)| word | nibble << (28 - 4 * i)).to_le_bytes()
        };
        nibbles.chunks(8).flat_map(word).collect()
    }

    #[test]
    fn a_row_that_was_encoded_by_hand_is_read() {
        // No zeros, two others: 1000 is 2 · 1000 = 0o3720, 997 is 2 · 3 - 1 = 5; three zeros, none other.
        let nibbles: u64 = 0x_0_2_8_a_f_3_5_3;
        let bytes = [(nibbles as u32).to_le_bytes(), [0; 4]].concat();
        assert_eq!(decode(&bytes, 5).unwrap(), [1000, 997, 0, 0, 0]);
    }

    #[test]
    fn what_is_cut_or_tells_of_more_pixels_than_there_are_is_refused() {
        let raw: Vec<u16> = (0..100).map(|i| if i % 7 == 0 { 0 } else { 900 + 31 * i }).collect();
        let bytes = encode(&raw);
        for length in 0..bytes.len() {
            let error = decode(&bytes[..length], raw.len()).unwrap_err().to_string();
            assert!(error.contains("ends too early"), "{length}: {error}");
        }
        for (numbers, reason) in [
            (&[101][..], "more pixels"),
            (&[0, 101], "more pixels"),
            (&[0, 0, 0, 0], "no pixels"),
            (&[0, 1, 2 * 65_536], "16 bits"),
            (&[0, 1, 1], "16 bits"),
            (&[1 << 32], "32 bits"),
            (&[1 << 40], "32 bits"),
        ] {
            let error = decode(&words(numbers), 100).unwrap_err().to_string();
            assert!(error.contains(reason), "{numbers:?}: {error}");
        }
    }

    fn depth() -> impl Strategy<Value = Vec<u16>> {
        let value = prop_oneof![Just(0_u16), any::<u16>(), 990_u16..1010];
        prop::collection::vec(value, 0..300)
    }

    proptest! {
        #[test]
        fn what_is_encoded_comes_back(raw in depth()) {
            prop_assert_eq!(decode(&encode(&raw), raw.len()).unwrap(), raw);
        }

        #[test]
        fn any_bytes_are_pixels_or_an_error(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            pixels in 0_usize..5000,
        ) {
            if let Ok(raw) = decode(&bytes, pixels) {
                prop_assert_eq!(raw.len(), pixels);
            }
        }
    }
}
