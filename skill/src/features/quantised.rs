//! RootSIFT descriptors in bytes, as models keep them.

use super::sift_descriptor::DESCRIPTOR_LENGTH;

/// A unit vector in bytes.
pub type Descriptor = [u8; DESCRIPTOR_LENGTH];

/// Bytes in a unit: components of a RootSIFT hardly exceed a half.
const QUANTUM: f32 = 510.0;

/// A unit vector in bytes.
pub fn quantise(descriptor: &[f32; DESCRIPTOR_LENGTH]) -> Descriptor {
    descriptor.map(|x| (x * QUANTUM).round().min(255.0) as u8)
}

/// A kept descriptor. One of another length than ours is damaged: what is missing counts as
/// nothing.
pub fn bytes_of(kept: &[u8]) -> Descriptor {
    std::array::from_fn(|i| kept.get(i).copied().unwrap_or(0))
}

/// Inner product of quantised descriptors.
#[inline(always)]
pub fn product(a: &[u8], b: &[u8]) -> u32 {
    a.iter().zip(b).map(|(x, y)| u32::from(u16::from(*x) * u16::from(*y))).sum()
}

/// Inner products of one with many: a loop as wide as the processor allows, with the same results
/// on all.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
pub fn products(one: &Descriptor, many: &[Descriptor]) -> Vec<u32> {
    many.iter().map(|other| product(one, other)).collect()
}

/// Cosine between two quantised descriptors from their product.
pub fn similarity(product: u32) -> f64 {
    f64::from(product) / f64::from(QUANTUM * QUANTUM)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn many_are_compared_as_each_is(bytes in proptest::collection::vec(any::<u8>(), 9 * DESCRIPTOR_LENGTH)) {
            let all: Vec<Descriptor> = bytes.chunks(DESCRIPTOR_LENGTH).map(bytes_of).collect();
            let expected: Vec<u32> = all.iter().map(|other| {
                all[0].iter().zip(other).map(|(a, b)| u32::from(*a) * u32::from(*b)).sum()
            }).collect();
            prop_assert_eq!(products(&all[0], &all), expected);
        }
    }
}
