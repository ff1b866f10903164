//! LCM's encoding: big-endian, lengths before arrays, strings with their length and a NUL,
//! and an eight-byte fingerprint of the type in front.

/// A message that cannot be decoded.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeError {
    /// It is of another type.
    #[error("fingerprint {found:016x} is not that of {name} ({expected:016x})")]
    Fingerprint {
        /// The type that was expected.
        name: &'static str,
        /// Its fingerprint.
        expected: u64,
        /// The packet's.
        found: u64,
    },
    /// It ends too early.
    #[error("the message ends {missing} bytes too early")]
    Truncated {
        /// Bytes that are missing at least.
        missing: usize,
    },
    /// It goes on after its end.
    #[error("{left} bytes follow the message")]
    Trailing {
        /// How many.
        left: usize,
    },
    /// A length below zero, or more than the packet can hold.
    #[error("length {length} of {member} cannot be")]
    Length {
        /// The member.
        member: &'static str,
        /// Its claim.
        length: i64,
    },
    /// A string that is no UTF-8, or whose only NUL is not at its end.
    #[error("a string is damaged")]
    String,
}

/// A message that cannot be encoded.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum EncodeError {
    /// Arrays that share a length member differ.
    #[error("{first} holds {first_length} values, {second} {second_length}: they share one length")]
    Lengths {
        /// One array.
        first: &'static str,
        /// Its length.
        first_length: usize,
        /// The other.
        second: &'static str,
        /// Its length.
        second_length: usize,
    },
    /// An array longer than its length member can say.
    #[error("{member} holds {length} values, more than its length member can say")]
    TooLong {
        /// The array.
        member: &'static str,
        /// Its length.
        length: usize,
    },
    /// A string with a NUL inside.
    #[error("a string holds a NUL")]
    String,
}

/// A type that LCM can carry. Implemented by generated code.
pub trait Message: Sized {
    /// `package.struct`.
    const NAME: &'static str;
    /// Fewest bytes that its members take.
    const LEAST_BYTES: usize;
    /// Hash of its own members.
    fn base_fingerprint() -> Fingerprint;
    /// Sum of its children's fingerprints.
    fn children_fingerprint() -> u64;
    /// Hash of the whole type.
    fn fingerprint() -> u64 {
        Self::base_fingerprint().0.wrapping_add(Self::children_fingerprint()).rotate_left(1)
    }
    /// Appends the members.
    ///
    /// # Errors
    /// [`EncodeError`] when lengths do not fit each other or their type.
    fn encode_body(&self, out: &mut Encoder) -> Result<(), EncodeError>;
    /// Reads the members.
    ///
    /// # Errors
    /// [`DecodeError`] when the packet does not hold them.
    fn decode_body(input: &mut Decoder) -> Result<Self, DecodeError>;
}

/// The bytes of a message, its fingerprint first.
///
/// # Errors
/// As [`Message::encode_body`].
pub fn encode<M: Message>(message: &M) -> Result<Vec<u8>, EncodeError> {
    let mut out = Encoder { bytes: M::fingerprint().to_be_bytes().to_vec() };
    message.encode_body(&mut out)?;
    Ok(out.bytes)
}

/// The message of a packet.
///
/// # Errors
/// [`DecodeError`] for a packet of another type or a damaged one.
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, DecodeError> {
    let mut input = Decoder { left: bytes };
    let found = u64::from_be_bytes(input.take_bytes()?);
    if found != M::fingerprint() {
        return Err(DecodeError::Fingerprint { name: M::NAME, expected: M::fingerprint(), found });
    }
    let message = M::decode_body(&mut input)?;
    match input.left.len() {
        0 => Ok(message),
        left => Err(DecodeError::Trailing { left }),
    }
}

/// LCM's rolling hash of a type.
#[derive(Debug, Clone, Copy)]
pub struct Fingerprint(u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Self::new()
    }
}

impl Fingerprint {
    /// The seed.
    pub fn new() -> Self {
        Self(0x1234_5678)
    }

    /// Hashes a member: its name, its type if primitive, its dimensions as (0 fixed or 1
    /// variable, size).
    pub fn member(self, name: &str, primitive: Option<&str>, dimensions: &[(u8, &str)]) -> Self {
        let mut hash = self.text(name);
        if let Some(kind) = primitive {
            hash = hash.text(kind);
        }
        hash = hash.byte(dimensions.len() as u8);
        for (mode, size) in dimensions {
            hash = hash.byte(*mode).text(size);
        }
        hash
    }

    fn byte(self, c: u8) -> Self {
        let v = self.0 as i64;
        Self(((v << 8) ^ (v >> 55)).wrapping_add(i64::from(c as i8)) as u64)
    }

    fn text(self, text: &str) -> Self {
        text.bytes().fold(self.byte(text.len() as u8), Self::byte)
    }
}

/// Collects a message's bytes.
#[derive(Debug, Default)]
pub struct Encoder {
    bytes: Vec<u8>,
}

impl Encoder {
    /// Appends a value.
    ///
    /// # Errors
    /// As the value's own.
    pub fn put<T: Field>(&mut self, value: &T) -> Result<(), EncodeError> {
        value.put_into(self)
    }

    /// Appends values one after the other.
    ///
    /// # Errors
    /// As the values' own.
    pub fn put_all<T: Field>(&mut self, values: &[T]) -> Result<(), EncodeError> {
        values.iter().try_for_each(|v| v.put_into(self))
    }

    /// Refuses arrays of different lengths that share a length member.
    ///
    /// # Errors
    /// [`EncodeError::Lengths`].
    pub fn same_length(
        &self,
        first: &'static str,
        first_length: usize,
        second: &'static str,
        second_length: usize,
    ) -> Result<(), EncodeError> {
        if first_length == second_length {
            Ok(())
        } else {
            Err(EncodeError::Lengths { first, first_length, second, second_length })
        }
    }

    /// The error for an array longer than its length member can say.
    pub fn too_long(&self, member: &'static str, length: usize) -> EncodeError {
        EncodeError::TooLong { member, length }
    }
}

/// Reads a message's bytes.
#[derive(Debug)]
pub struct Decoder<'b> {
    left: &'b [u8],
}

impl Decoder<'_> {
    /// Reads a value.
    ///
    /// # Errors
    /// As the value's own.
    pub fn take<T: Field>(&mut self) -> Result<T, DecodeError> {
        T::take_from(self)
    }

    /// Reads an array of fixed length.
    ///
    /// # Errors
    /// As the values' own.
    pub fn take_array<T: Field + Default + Copy, const N: usize>(
        &mut self,
    ) -> Result<[T; N], DecodeError> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = self.take()?;
        }
        Ok(values)
    }

    /// Reads `count` values; a count that the packet cannot hold reserves no memory.
    ///
    /// # Errors
    /// As the values' own.
    pub fn take_many<T: Field>(&mut self, count: usize) -> Result<Vec<T>, DecodeError> {
        let least = count.saturating_mul(T::LEAST_BYTES.max(1));
        if least > self.left.len() {
            return Err(DecodeError::Truncated { missing: least - self.left.len() });
        }
        // There are at most this many values, even if each is as short as possible: no more memory
        // is taken.
        let mut values = Vec::with_capacity(count);
        for _ in 0..count {
            values.push(self.take()?);
        }
        Ok(values)
    }

    /// Reads a length member.
    ///
    /// # Errors
    /// [`DecodeError::Length`] below zero.
    pub fn length<T: Field + Into<i64>>(
        &mut self,
        member: &'static str,
    ) -> Result<usize, DecodeError> {
        let length: i64 = self.take::<T>()?.into();
        usize::try_from(length).map_err(|_| DecodeError::Length { member, length })
    }

    fn take_bytes<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let missing = N.saturating_sub(self.left.len());
        let (bytes, left) =
            self.left.split_first_chunk::<N>().ok_or(DecodeError::Truncated { missing })?;
        self.left = left;
        Ok(*bytes)
    }
}

/// A value inside a message.
pub trait Field: Sized {
    /// Fewest bytes that one takes.
    const LEAST_BYTES: usize;
    /// Appends it.
    ///
    /// # Errors
    /// [`EncodeError`] for a value that has no encoding.
    fn put_into(&self, out: &mut Encoder) -> Result<(), EncodeError>;
    /// Reads one.
    ///
    /// # Errors
    /// [`DecodeError`] when there is none.
    fn take_from(input: &mut Decoder) -> Result<Self, DecodeError>;
}

macro_rules! numbers {
    ($($kind:ty),*) => {$(
        impl Field for $kind {
            const LEAST_BYTES: usize = size_of::<$kind>();
            fn put_into(&self, out: &mut Encoder) -> Result<(), EncodeError> {
                out.bytes.extend(self.to_be_bytes());
                Ok(())
            }
            fn take_from(input: &mut Decoder) -> Result<Self, DecodeError> {
                Ok(<$kind>::from_be_bytes(input.take_bytes()?))
            }
        }
    )*};
}
numbers!(i8, u8, i16, i32, i64, f32, f64);

impl Field for bool {
    const LEAST_BYTES: usize = 1;
    fn put_into(&self, out: &mut Encoder) -> Result<(), EncodeError> {
        u8::from(*self).put_into(out)
    }
    fn take_from(input: &mut Decoder) -> Result<Self, DecodeError> {
        Ok(u8::take_from(input)? != 0)
    }
}

impl Field for String {
    const LEAST_BYTES: usize = 5;
    fn put_into(&self, out: &mut Encoder) -> Result<(), EncodeError> {
        if self.contains('\0') {
            return Err(EncodeError::String);
        }
        let length = i32::try_from(self.len() + 1)
            .map_err(|_| EncodeError::TooLong { member: "string", length: self.len() })?;
        out.put(&length)?;
        out.bytes.extend(self.as_bytes());
        out.put(&0_u8)
    }
    fn take_from(input: &mut Decoder) -> Result<Self, DecodeError> {
        let length = input.length::<i32>("string")?;
        if length > input.left.len() {
            return Err(DecodeError::Truncated { missing: length - input.left.len() });
        }
        let (text, left) = input.left.split_at(length);
        input.left = left;
        let text = text.strip_suffix(&[0]).ok_or(DecodeError::String)?;
        // With one inside it could be decoded and never be encoded again.
        if text.contains(&0) {
            return Err(DecodeError::String);
        }
        String::from_utf8(text.to_vec()).map_err(|_| DecodeError::String)
    }
}

impl<M: Message> Field for M {
    const LEAST_BYTES: usize = <M as Message>::LEAST_BYTES;
    fn put_into(&self, out: &mut Encoder) -> Result<(), EncodeError> {
        self.encode_body(out)
    }
    fn take_from(input: &mut Decoder) -> Result<Self, DecodeError> {
        Self::decode_body(input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::drake::{LcmtRobotPlan, LcmtRobotState};

    fn plan() -> LcmtRobotPlan {
        let state = |utime| LcmtRobotState {
            utime,
            joint_name: vec!["fridge/joint1".into()],
            joint_position: vec![0.25],
        };
        LcmtRobotPlan { utime: 7, plan: vec![state(0), state(500_000)] }
    }

    #[test]
    fn a_message_survives_the_wire() {
        assert_eq!(decode::<LcmtRobotPlan>(&encode(&plan()).unwrap()).unwrap(), plan());
    }

    #[test]
    fn every_truncation_is_an_error() {
        let bytes = encode(&plan()).unwrap();
        for end in 0..bytes.len() {
            assert!(decode::<LcmtRobotPlan>(&bytes[..end]).is_err(), "cut at {end}");
        }
    }

    #[test]
    fn a_packet_that_claims_two_billion_states_reserves_no_memory() {
        let mut bytes = encode(&LcmtRobotPlan { utime: 0, plan: Vec::new() }).unwrap();
        let length = bytes.len();
        bytes[length - 4..].copy_from_slice(&i32::MAX.to_be_bytes());
        assert!(matches!(decode::<LcmtRobotPlan>(&bytes), Err(DecodeError::Truncated { .. })));
    }

    #[test]
    fn arrays_that_share_a_length_must_have_it() {
        let state =
            LcmtRobotState { utime: 0, joint_name: vec!["a".into()], joint_position: vec![] };
        assert!(matches!(encode(&state), Err(EncodeError::Lengths { .. })));
    }

    #[test]
    fn a_string_with_a_nul_inside_is_refused() {
        let mut bytes = encode(&plan()).unwrap();
        let inside = bytes.windows(6).position(|w| w == b"fridge").unwrap() + 2;
        bytes[inside] = 0;
        assert_eq!(decode::<LcmtRobotPlan>(&bytes), Err(DecodeError::String));
    }

    #[test]
    fn another_type_is_refused_by_its_fingerprint() {
        let bytes = encode(&plan()).unwrap();
        let error = decode::<LcmtRobotState>(&bytes).unwrap_err();
        assert!(matches!(error, DecodeError::Fingerprint { name: "drake.lcmt_robot_state", .. }));
    }
}
