//! Depth and confidence of Record3D: rows of numbers, packed by Apple's LZFSE.

use lzfse_rust::LzfseRingDecoder;
use std::io::{self, Write};

/// Depth of this many columns and rows in metres. What is no reading is not finite or not above 0.
///
/// # Errors
/// What is damaged.
pub fn metres(packed: &[u8], size: (usize, usize)) -> Result<Vec<f32>, String> {
    let bytes = unpacked(packed, size.0 * size.1 * size_of::<f32>())?;
    Ok(bytes.as_chunks::<4>().0.iter().map(|z| f32::from_le_bytes(*z)).collect())
}

/// How sure depth of this many columns and rows is: 0 (low) to 2 (high).
///
/// # Errors
/// What is damaged.
pub fn confidence(packed: &[u8], size: (usize, usize)) -> Result<Vec<u8>, String> {
    unpacked(packed, size.0 * size.1)
}

/// Exactly as many bytes as are expected; some writers leave them as they are.
fn unpacked(packed: &[u8], expected: usize) -> Result<Vec<u8>, String> {
    if packed.len() == expected {
        return Ok(packed.to_vec());
    }
    let mut bytes = Limited { bytes: Vec::new(), most: expected };
    let mut decoder = LzfseRingDecoder::default();
    decoder.decode(&mut &packed[..], &mut bytes).map_err(|e| format!("damaged LZFSE: {e}"))?;
    let Limited { bytes, .. } = bytes;
    match bytes.len() == expected {
        true => Ok(bytes),
        false => Err(format!("unpacks to {} bytes, {expected} are expected", bytes.len())),
    }
}

/// Takes no more than is expected, whatever a small file unpacks to.
struct Limited {
    bytes: Vec<u8>,
    most: usize,
}

impl Write for Limited {
    fn write(&mut self, part: &[u8]) -> io::Result<usize> {
        if self.bytes.len() + part.len() > self.most {
            return Err(io::Error::other(format!("unpacks to more than {} bytes", self.most)));
        }
        self.bytes.extend_from_slice(part);
        Ok(part.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packed(bytes: &[u8]) -> Vec<u8> {
        let mut packed = Vec::new();
        lzfse_rust::encode_bytes(bytes, &mut packed).unwrap();
        packed
    }

    #[test]
    fn what_was_packed_is_unpacked() {
        let depth: Vec<f32> = (0..192 * 256).map(|i| 1.0 + (i % 700) as f32 * 1e-3).collect();
        let bytes: Vec<u8> = depth.iter().flat_map(|z| z.to_le_bytes()).collect();
        assert_eq!(metres(&packed(&bytes), (192, 256)).unwrap(), depth);
        assert_eq!(metres(&bytes, (192, 256)).unwrap(), depth, "it was not packed");
        assert_eq!(confidence(&packed(&[2, 1, 0, 2]), (2, 2)).unwrap(), [2, 1, 0, 2]);
    }

    #[test]
    fn another_size_and_damage_are_errors_and_take_no_memory() {
        let bomb = packed(&vec![0; 64 << 20]);
        assert!(bomb.len() < 1 << 20);
        let info = allocation_counter::measure(|| {
            assert!(confidence(&bomb, (2, 2)).unwrap_err().contains("more than 4 bytes"));
        });
        assert!(info.bytes_max < 2 << 20, "{} bytes", info.bytes_max);
        assert!(confidence(&packed(&[1, 2, 3]), (2, 2)).unwrap_err().contains("3 bytes"));
        for damaged in [&b""[..], b"bvx2\0", b"nothing at all", &bomb[..40]] {
            assert!(confidence(damaged, (2, 2)).is_err(), "{damaged:?}");
        }
    }
}
