//! RootSIFT descriptors in bytes, as models keep them.

use super::DESCRIPTOR_LENGTH;

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
pub fn product(a: &[u8], b: &[u8]) -> u32 {
    a.iter().zip(b).map(|(x, y)| u32::from(u16::from(*x) * u16::from(*y))).sum()
}

/// Cosine between two quantised descriptors from their product.
pub fn similarity(product: u32) -> f64 {
    f64::from(product) / f64::from(QUANTUM * QUANTUM)
}
