//! The two kinds of LCM datagrams: a short one holds a whole message, a fragment a part of one.
//!
//! All numbers are big-endian. A short one is: magic, sequence number, channel, NUL, message. A
//! fragment is: magic, sequence number, size of the message, offset of this part in it, number
//! of this part, count of parts, and then the bytes; in part 0 the channel and a NUL stand before
//! them.

/// First word of a datagram with a whole message: "LC02".
const MAGIC_SHORT: u32 = 0x4c43_3032;
/// First word of a fragment: "LC03".
const MAGIC_FRAGMENT: u32 = 0x4c43_3033;
/// Bytes before the channel of a short message.
const SHORT_HEADER: usize = 4 + 4;
/// Bytes before the channel or the bytes of a fragment.
const FRAGMENT_HEADER: usize = 4 + 4 + 4 + 4 + 2 + 2;
/// Longest channel name that LCM knows, bytes.
pub const MAX_CHANNEL: usize = 63;
/// Most bytes that a UDP datagram holds over IPv4.
pub const MAX_DATAGRAM: usize = 65_507;
/// Most bytes of channel, NUL and message that go without fragments.
pub(super) const MAX_SHORT: usize = MAX_DATAGRAM - SHORT_HEADER;
/// Most bytes of a fragment, with channel and NUL in the first one.
pub(super) const MAX_FRAGMENT: usize = MAX_DATAGRAM - FRAGMENT_HEADER;

/// Why a datagram is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DatagramError {
    /// It ends within its header.
    #[error("the datagram ends within its header")]
    Header,
    /// It is none of LCM.
    #[error("the datagram does not begin as one of LCM")]
    Magic,
    /// The channel's name is empty, longer than 63 bytes, no UTF-8, or does not end in NUL.
    #[error("the datagram names no channel")]
    Channel,
    /// A fragment that cannot be a part of the message that it claims.
    #[error("the fragment cannot be a part of its message")]
    Fragment,
}

/// What a datagram says of itself, compared with what it holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Datagram<'b> {
    /// A whole message.
    Short {
        /// The sender's number of the message.
        sequence: u32,
        /// Its channel.
        channel: &'b str,
        /// Its bytes.
        bytes: &'b [u8],
    },
    /// A part of a message.
    Part {
        /// The sender's number of the message.
        sequence: u32,
        /// The message's channel, which the first part names.
        channel: Option<&'b str>,
        /// Where it lies.
        part: Part<'b>,
    },
}

/// A part of a message, and where it lies in it. `offset + bytes.len() <= size`, and
/// `number < count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part<'b> {
    /// Bytes of the whole message.
    pub size: u32,
    /// Where its bytes begin in the message.
    pub offset: u32,
    /// Its number.
    pub number: u16,
    /// How many parts the message has.
    pub count: u16,
    /// Its bytes.
    pub bytes: &'b [u8],
}

impl<'b> Datagram<'b> {
    /// Reads a datagram of any bytes.
    ///
    /// # Errors
    /// [`DatagramError`] for one that no LCM sends.
    pub fn read(datagram: &'b [u8]) -> Result<Self, DatagramError> {
        let (magic, rest) = word(datagram)?;
        let (sequence, rest) = word(rest)?;
        match magic {
            MAGIC_SHORT => {
                let (channel, bytes) = channel_of(rest)?;
                Ok(Self::Short { sequence, channel, bytes })
            }
            MAGIC_FRAGMENT => {
                let (size, rest) = word(rest)?;
                let (offset, rest) = word(rest)?;
                let (numbers, rest) = word(rest)?;
                let (number, count) = ((numbers >> 16) as u16, numbers as u16);
                let (channel, bytes) = if number == 0 {
                    channel_of(rest).map(|(channel, bytes)| (Some(channel), bytes))?
                } else {
                    (None, rest)
                };
                let part = Part { size, offset, number, count, bytes };
                if !part.can_be() {
                    return Err(DatagramError::Fragment);
                }
                Ok(Self::Part { sequence, channel, part })
            }
            _ => Err(DatagramError::Magic),
        }
    }

    /// The sender's number of the message.
    pub fn sequence(&self) -> u32 {
        match self {
            Self::Short { sequence, .. } | Self::Part { sequence, .. } => *sequence,
        }
    }
}

impl Part<'_> {
    /// Where its bytes end in the message.
    pub fn end(&self) -> u64 {
        u64::from(self.offset) + self.bytes.len() as u64
    }

    /// The first part begins and the last one ends the message, and no other does; only the
    /// first may be without bytes.
    fn can_be(&self) -> bool {
        let is_last = u32::from(self.number) + 1 == u32::from(self.count);
        self.number < self.count
            && (self.number != 0 || self.offset == 0)
            && (self.number == 0 || !self.bytes.is_empty())
            && is_last == (self.end() == u64::from(self.size))
            && self.end() <= u64::from(self.size)
    }
}

fn word(bytes: &[u8]) -> Result<(u32, &[u8]), DatagramError> {
    let (word, rest) = bytes.split_first_chunk::<4>().ok_or(DatagramError::Header)?;
    Ok((u32::from_be_bytes(*word), rest))
}

/// A channel's name up to its NUL, and what follows.
fn channel_of(bytes: &[u8]) -> Result<(&str, &[u8]), DatagramError> {
    let end = bytes.iter().take(MAX_CHANNEL + 1).position(|b| *b == 0);
    let (name, rest) =
        end.filter(|e| *e > 0).map(|e| bytes.split_at(e)).ok_or(DatagramError::Channel)?;
    let name = std::str::from_utf8(name).map_err(|_| DatagramError::Channel)?;
    Ok((name, rest.get(1..).unwrap_or_default()))
}

/// The bytes before the channel of a short message.
pub(super) fn short_header(sequence: u32) -> [u8; SHORT_HEADER] {
    let mut header = [0; SHORT_HEADER];
    header[..4].copy_from_slice(&MAGIC_SHORT.to_be_bytes());
    header[4..].copy_from_slice(&sequence.to_be_bytes());
    header
}

/// The bytes before those of a part.
pub(super) fn part_header(sequence: u32, part: &Part) -> [u8; FRAGMENT_HEADER] {
    let mut header = [0; FRAGMENT_HEADER];
    header[..4].copy_from_slice(&MAGIC_FRAGMENT.to_be_bytes());
    header[4..8].copy_from_slice(&sequence.to_be_bytes());
    header[8..12].copy_from_slice(&part.size.to_be_bytes());
    header[12..16].copy_from_slice(&part.offset.to_be_bytes());
    header[16..18].copy_from_slice(&part.number.to_be_bytes());
    header[18..].copy_from_slice(&part.count.to_be_bytes());
    header
}

/// The parts of a message that does not go without fragments, in order; `None` for one of more
/// parts than can be counted.
pub(super) fn parts<'b>(
    channel: &str,
    message: &'b [u8],
) -> Option<impl Iterator<Item = Part<'b>> + use<'b>> {
    let size = u32::try_from(message.len()).ok()?;
    let named = channel.len() + 1;
    let count = u16::try_from((named + message.len()).div_ceil(MAX_FRAGMENT)).ok()?;
    let mut offset = 0;
    Some((0..count).map(move |number| {
        let room = if number == 0 { MAX_FRAGMENT - named } else { MAX_FRAGMENT };
        let end = message.len().min(offset + room);
        let part =
            Part { size, offset: offset as u32, number, count, bytes: &message[offset..end] };
        offset = end;
        part
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PART: Part<'static> = Part { size: 9, offset: 4, number: 1, count: 3, bytes: b"abc" };

    fn datagram(part: &Part, name: &[u8]) -> Vec<u8> {
        [&part_header(7, part), name, part.bytes].concat()
    }

    #[test]
    fn a_short_message_is_read() {
        let bytes = [&short_header(5)[..], b"LINKAGE_STATUS\0abc"].concat();
        let told = Datagram::Short { sequence: 5, channel: "LINKAGE_STATUS", bytes: b"abc" };
        assert_eq!(Datagram::read(&bytes), Ok(told));
    }

    #[test]
    fn a_part_is_read() {
        let told = Datagram::Part { sequence: 7, channel: None, part: PART };
        assert_eq!(Datagram::read(&datagram(&PART, b"")), Ok(told));
        let first = Part { offset: 0, number: 0, ..PART };
        let told = Datagram::Part { sequence: 7, channel: Some("C"), part: first };
        assert_eq!(Datagram::read(&datagram(&first, b"C\0")), Ok(told));
    }

    #[test]
    fn a_datagram_that_ends_within_its_header_is_refused() {
        let whole = datagram(&PART, b"");
        for end in 0..FRAGMENT_HEADER {
            assert_eq!(Datagram::read(&whole[..end]), Err(DatagramError::Header), "{end} bytes");
        }
        let whole = [&short_header(5)[..], b"CHANNEL\0"].concat();
        for end in SHORT_HEADER..whole.len() {
            assert_eq!(Datagram::read(&whole[..end]), Err(DatagramError::Channel), "{end} bytes");
        }
    }

    #[test]
    fn a_channel_that_none_can_have_is_refused() {
        let named = |name: &[u8]| [&short_header(5)[..], name].concat();
        let longest = [vec![b'c'; MAX_CHANNEL], vec![0]].concat();
        assert!(Datagram::read(&named(&longest)).is_ok());
        let too_long = [vec![b'c'; MAX_CHANNEL + 1], vec![0]].concat();
        for name in [&too_long[..], b"\0abc", b"no end", b"\xff\xfe\0abc"] {
            assert_eq!(Datagram::read(&named(name)), Err(DatagramError::Channel), "{name:?}");
        }
    }

    #[test]
    fn a_part_that_cannot_be_one_of_its_message_is_refused() {
        let first = Part { offset: 0, number: 0, ..PART };
        for wrong in [
            Part { number: 3, ..PART },
            Part { count: 0, ..PART },
            Part { count: 1, ..PART },
            Part { count: 2, ..PART },
            Part { offset: 6, ..PART },
            Part { offset: 7, ..PART },
            Part { offset: u32::MAX - 1, ..PART },
            Part { size: 3, ..PART },
            Part { bytes: b"", ..PART },
            Part { offset: 1, ..first },
        ] {
            let name: &[u8] = if wrong.number == 0 { b"C\0" } else { b"" };
            let bytes = datagram(&wrong, name);
            assert_eq!(Datagram::read(&bytes), Err(DatagramError::Fragment), "{wrong:?}");
        }
    }

    #[test]
    fn the_parts_of_a_message_are_such_that_can_be() {
        for length in [MAX_SHORT, 2 * MAX_FRAGMENT - 2, 2 * MAX_FRAGMENT - 1, 1_000_000] {
            let message = vec![1; length];
            let parts: Vec<Part> = parts("C", &message).unwrap().collect();
            assert!(parts.iter().all(Part::can_be), "{length}");
            assert_eq!(parts.iter().map(|p| p.bytes.len()).sum::<usize>(), length);
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic_and_each_part_lies_in_its_message(
            mut bytes in proptest::collection::vec(any::<u8>(), 0..80),
            fragment in any::<bool>(),
        ) {
            if bytes.len() >= 4 {
                bytes[..4].copy_from_slice(
                    &if fragment { MAGIC_FRAGMENT } else { MAGIC_SHORT }.to_be_bytes(),
                );
            }
            if let Ok(Datagram::Part { part, .. }) = Datagram::read(&bytes) {
                prop_assert!(part.end() <= u64::from(part.size) && part.number < part.count);
            }
        }
    }
}
