//! The bytes of ROS messages, field by field.
//!
//! ROS 2 writes CDR: a header of four bytes tells the byte order, numbers are aligned to their
//! size, strings end in a zero byte. ROS 1 writes the same fields in little endian without header,
//! alignment and zero bytes. Nothing is copied, and no memory is taken for a length before it is
//! compared with the bytes that are left: a larger length is an error.

/// How a message is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WireFormat {
    /// ROS 2.
    Cdr,
    /// ROS 1.
    Ros1,
}

/// A message that breaks the rules of its format.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WireError {
    /// It ends before a field does.
    #[error("the message ends inside its {field}: {needed} bytes are needed, {left} are left")]
    Short {
        /// The field.
        field: &'static str,
        /// Bytes that the field needs.
        needed: usize,
        /// Bytes that are left.
        left: usize,
    },
    /// The header of CDR names a representation that is not read.
    #[error(
        "CDR representation {0:#06x} is not read; plain CDR (0x0000, 0x0001) and XCDR2 (0x0006, 0x0007) are"
    )]
    Representation(u16),
    /// A value that the field cannot have.
    #[error("{field} is {value}, which cannot be")]
    Value {
        /// The field.
        field: &'static str,
        /// What was read.
        value: String,
    },
}

/// Reads a message from its beginning.
#[derive(Debug, Clone)]
pub struct WireReader<'b> {
    /// What alignment counts from: the message without CDR's header.
    body: &'b [u8],
    at: usize,
    is_big_endian: bool,
    /// Largest alignment of a number; 1 where numbers are not aligned.
    max_alignment: usize,
    has_zero_bytes: bool,
}

impl<'b> WireReader<'b> {
    /// Begins with a message.
    ///
    /// # Errors
    /// [`WireError`] for a header of CDR that is cut or of another representation.
    pub fn new(bytes: &'b [u8], format: WireFormat) -> Result<Self, WireError> {
        let plain = |body, is_big_endian, max_alignment, has_zero_bytes| Self {
            body,
            at: 0,
            is_big_endian,
            max_alignment,
            has_zero_bytes,
        };
        if format == WireFormat::Ros1 {
            return Ok(plain(bytes, false, 1, false));
        }
        let Some((&[high, low, _, _], body)) = bytes.split_first_chunk::<4>() else {
            return Err(WireError::Short { field: "CDR header", needed: 4, left: bytes.len() });
        };
        match u16::from_be_bytes([high, low]) {
            representation @ (0 | 1) => Ok(plain(body, representation == 0, 8, true)),
            representation @ (6 | 7) => Ok(plain(body, representation == 6, 4, true)),
            representation => Err(WireError::Representation(representation)),
        }
    }

    /// Bytes that are left.
    pub fn left(&self) -> usize {
        self.body.len() - self.at
    }

    /// The next byte.
    ///
    /// # Errors
    /// [`WireError::Short`], as for all that follow.
    pub fn u8(&mut self, field: &'static str) -> Result<u8, WireError> {
        Ok(self.take(field, 1)?[0])
    }

    /// The next 32-bit number.
    ///
    /// # Errors
    /// [`WireError::Short`].
    pub fn u32(&mut self, field: &'static str) -> Result<u32, WireError> {
        let bytes: [u8; 4] = self.number(field)?;
        Ok(if self.is_big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    /// The next signed 32-bit number.
    ///
    /// # Errors
    /// [`WireError::Short`].
    pub fn i32(&mut self, field: &'static str) -> Result<i32, WireError> {
        Ok(self.u32(field)?.cast_signed())
    }

    /// The next number of single precision.
    ///
    /// # Errors
    /// [`WireError::Short`].
    pub fn f32(&mut self, field: &'static str) -> Result<f32, WireError> {
        Ok(f32::from_bits(self.u32(field)?))
    }

    /// The next number of double precision.
    ///
    /// # Errors
    /// [`WireError::Short`].
    pub fn f64(&mut self, field: &'static str) -> Result<f64, WireError> {
        let bytes: [u8; 8] = self.number(field)?;
        Ok(if self.is_big_endian { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) })
    }

    /// The next `N` numbers of double precision.
    ///
    /// # Errors
    /// [`WireError::Short`].
    pub fn f64s<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N], WireError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64(field)?;
        }
        Ok(values)
    }

    /// A sequence of numbers of double precision, at most `most` of them.
    ///
    /// # Errors
    /// [`WireError::Short`], and [`WireError::Value`] for more than `most`.
    pub fn f64_sequence(
        &mut self,
        field: &'static str,
        most: usize,
    ) -> Result<Vec<f64>, WireError> {
        let count = self.u32(field)? as usize;
        if count > most {
            return Err(WireError::Value { field, value: format!("{count} numbers") });
        }
        (0..count).map(|_| self.f64(field)).collect()
    }

    /// A sequence of bytes.
    ///
    /// # Errors
    /// [`WireError::Short`].
    pub fn bytes(&mut self, field: &'static str) -> Result<&'b [u8], WireError> {
        let count = self.u32(field)? as usize;
        self.take(field, count)
    }

    /// A text.
    ///
    /// # Errors
    /// [`WireError::Short`], and [`WireError::Value`] for what is no UTF-8.
    pub fn text(&mut self, field: &'static str) -> Result<&'b str, WireError> {
        let bytes = self.bytes(field)?;
        let bytes = match bytes {
            [text @ .., 0] if self.has_zero_bytes => text,
            all => all,
        };
        std::str::from_utf8(bytes)
            .map_err(|_| WireError::Value { field, value: "no UTF-8".to_owned() })
    }

    /// The next number's bytes, behind what aligns it.
    fn number<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], WireError> {
        let alignment = N.min(self.max_alignment);
        let padding = (alignment - self.at % alignment) % alignment;
        self.take(field, padding)?;
        let bytes = self.take(field, N)?;
        let mut number = [0; N];
        number.copy_from_slice(bytes);
        Ok(number)
    }

    fn take(&mut self, field: &'static str, count: usize) -> Result<&'b [u8], WireError> {
        let rest = &self.body[self.at..];
        let taken =
            rest.get(..count).ok_or(WireError::Short { field, needed: count, left: rest.len() })?;
        self.at += count;
        Ok(taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A byte, a text and a number of double precision, as each format writes them; of CDR what
    /// comes before the padding of the number.
    const LITTLE: &[u8] = b"\0\x01\0\0\x07\0\0\0\x03\0\0\0ab\0";
    const BIG: &[u8] = b"\0\0\0\0\x07\0\0\0\0\0\0\x03ab\0";
    const XCDR2: &[u8] = b"\0\x07\0\0\x07\0\0\0\x03\0\0\0ab\0";
    const ROS1: &[u8] = b"\x07\x02\0\0\0ab\0\0\0\0\0\0\xf8\x3f";

    fn read(bytes: &[u8], format: WireFormat) -> Result<(u8, &str, f64, usize), WireError> {
        let mut reader = WireReader::new(bytes, format)?;
        let values = (reader.u8("byte")?, reader.text("text")?, reader.f64("number")?);
        Ok((values.0, values.1, values.2, reader.left()))
    }

    #[test]
    fn numbers_are_aligned_and_ordered_as_the_header_says() {
        let expected = Ok((7, "ab", 1.5, 0));
        // The text ends at byte 11 behind the header: the number begins at byte 16, or at byte 12.
        let cdr = |head: &[u8], padding: usize, number: [u8; 8]| {
            [head, &vec![0; padding], &number].concat()
        };
        let little = cdr(LITTLE, 5, 1.5_f64.to_le_bytes());
        assert_eq!(read(&little, WireFormat::Cdr), expected);
        assert_eq!(read(&cdr(BIG, 5, 1.5_f64.to_be_bytes()), WireFormat::Cdr), expected);
        assert_eq!(read(&cdr(XCDR2, 1, 1.5_f64.to_le_bytes()), WireFormat::Cdr), expected);
        assert_eq!(read(ROS1, WireFormat::Ros1), expected);
    }

    #[test]
    fn a_message_that_is_cut_anywhere_is_an_error() {
        for length in 0..ROS1.len() {
            assert!(read(&ROS1[..length], WireFormat::Ros1).is_err(), "{length}");
        }
        for length in 0..=LITTLE.len() {
            assert!(read(&LITTLE[..length], WireFormat::Cdr).is_err(), "{length}");
        }
    }

    #[test]
    fn a_length_beyond_the_message_takes_no_memory() {
        let bytes = b"\xff\xff\xff\xffab";
        let error = WireReader::new(bytes, WireFormat::Ros1).unwrap().bytes("data").unwrap_err();
        assert_eq!(error, WireError::Short { field: "data", needed: 0xffff_ffff, left: 2 });
        let mut reader = WireReader::new(bytes, WireFormat::Ros1).unwrap();
        let error = reader.f64_sequence("d", 14).unwrap_err().to_string();
        assert!(error.contains("d is 4294967295 numbers"), "{error}");
    }

    #[test]
    fn another_representation_is_refused_by_its_number() {
        let error = WireReader::new(b"\0\x03\0\0", WireFormat::Cdr).unwrap_err().to_string();
        assert!(error.contains("0x0003"), "{error}");
    }
}
