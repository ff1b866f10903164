//! The fields of a protobuf message, one after the other, in the order in which they were written.
//!
//! In: the bytes of a message. Out: each field's number and value, which borrows from the bytes:
//! nothing is copied, so that a picture is not, though its message is read twice: for its time stamp when
//! it comes, and for its pixels. `prost`, which the feature `view` brings along, owns what it reads and
//! would copy each picture twice. Numbers that a reader does not know are for it to pass over; groups,
//! which no writer uses any more, are errors.

use super::wire::WireError;

/// Most bytes of a number of variable length: 64 bits, seven in a byte.
const MAX_VARINT_BYTES: usize = 10;

/// A field's value as it lies in the message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Value<'b> {
    /// A number of variable length.
    Varint(u64),
    /// Eight bytes, the least first.
    Fixed64([u8; 8]),
    /// Four bytes, the least first.
    Fixed32([u8; 4]),
    /// A text, bytes, a message inside, or numbers in a row.
    Bytes(&'b [u8]),
}

/// Goes through a message's fields; ends behind the first error.
#[derive(Debug, Clone)]
pub struct Fields<'b> {
    rest: &'b [u8],
}

impl<'b> Fields<'b> {
    /// Begins with a message.
    pub fn new(message: &'b [u8]) -> Self {
        Self { rest: message }
    }

    fn field(&mut self) -> Result<(u64, Value<'b>), WireError> {
        let key = self.varint()?;
        let value = match key & 7 {
            0 => Value::Varint(self.varint()?),
            1 => Value::Fixed64(self.array()?),
            2 => {
                let length = usize::try_from(self.varint()?).unwrap_or(usize::MAX);
                Value::Bytes(self.take(length)?)
            }
            5 => Value::Fixed32(self.array()?),
            kind => {
                let value = format!("protobuf's wire type {kind}");
                return Err(WireError::Value { field: "a field", value });
            }
        };
        Ok((key >> 3, value))
    }

    fn varint(&mut self) -> Result<u64, WireError> {
        let mut number = 0;
        for place in 0..MAX_VARINT_BYTES {
            let [byte] = self.array()?;
            number |= u64::from(byte & 0x7f) << (7 * place);
            if byte & 0x80 == 0 {
                return Ok(number);
            }
        }
        let value = format!("a number of more than {MAX_VARINT_BYTES} bytes");
        Err(WireError::Value { field: "a field", value })
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    fn take(&mut self, count: usize) -> Result<&'b [u8], WireError> {
        let left = self.rest.len();
        let short = WireError::Short { field: "fields", needed: count, left };
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(short)?;
        self.rest = rest;
        Ok(taken)
    }
}

impl<'b> Iterator for Fields<'b> {
    type Item = Result<(u64, Value<'b>), WireError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let field = self.field();
        if field.is_err() {
            self.rest = &[];
        }
        Some(field)
    }
}

impl<'b> Value<'b> {
    /// A number of variable length.
    ///
    /// # Errors
    /// [`WireError::Value`] where the field is none, as for all that follow.
    pub fn varint(self, field: &'static str) -> Result<u64, WireError> {
        if let Self::Varint(number) = self { Ok(number) } else { Err(self.wrong(field)) }
    }

    /// A number of 32 bits, `fixed32`.
    ///
    /// # Errors
    /// [`WireError::Value`].
    pub fn fixed32(self, field: &'static str) -> Result<u32, WireError> {
        if let Self::Fixed32(bytes) = self {
            Ok(u32::from_le_bytes(bytes))
        } else {
            Err(self.wrong(field))
        }
    }

    /// A number of double precision.
    ///
    /// # Errors
    /// [`WireError::Value`].
    pub fn double(self, field: &'static str) -> Result<f64, WireError> {
        if let Self::Fixed64(bytes) = self {
            Ok(f64::from_le_bytes(bytes))
        } else {
            Err(self.wrong(field))
        }
    }

    /// Puts numbers of double precision behind others, one of them or several in a row; no more than
    /// `most` in all.
    ///
    /// # Errors
    /// [`WireError::Value`], for more than `most` too.
    pub fn doubles(
        self,
        field: &'static str,
        numbers: &mut Vec<f64>,
        most: usize,
    ) -> Result<(), WireError> {
        let bytes = match &self {
            Self::Fixed64(bytes) => bytes.as_slice(),
            Self::Bytes(bytes) if bytes.len() % 8 == 0 => bytes,
            _ => return Err(self.wrong(field)),
        };
        let (rows, _) = bytes.as_chunks::<8>();
        if numbers.len() + rows.len() > most {
            let value = format!("more than {most} numbers");
            return Err(WireError::Value { field, value });
        }
        numbers.extend(rows.iter().map(|row| f64::from_le_bytes(*row)));
        Ok(())
    }

    /// Bytes, or a message inside.
    ///
    /// # Errors
    /// [`WireError::Value`].
    pub fn bytes(self, field: &'static str) -> Result<&'b [u8], WireError> {
        if let Self::Bytes(bytes) = self { Ok(bytes) } else { Err(self.wrong(field)) }
    }

    /// A text.
    ///
    /// # Errors
    /// [`WireError::Value`], for what is no UTF-8 too.
    pub fn text(self, field: &'static str) -> Result<&'b str, WireError> {
        std::str::from_utf8(self.bytes(field)?)
            .map_err(|_| WireError::Value { field, value: "no UTF-8".to_owned() })
    }

    fn wrong(self, field: &'static str) -> WireError {
        let kind = match self {
            Self::Varint(_) => "a number of variable length",
            Self::Fixed64(_) => "8 bytes",
            Self::Fixed32(_) => "4 bytes",
            Self::Bytes(_) => "a row of bytes",
        };
        WireError::Value { field, value: kind.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(message: &[u8]) -> Result<Vec<(u64, Value<'_>)>, WireError> {
        Fields::new(message).collect()
    }

    #[test]
    fn fields_of_all_kinds_are_read_with_their_numbers() {
        // 1: 300, 2: 1.5, 3: "ab", 4: 7 in four bytes.
        let message = b"\x08\xac\x02\x11\0\0\0\0\0\0\xf8\x3f\x1a\x02ab\x25\x07\0\0\0";
        let fields = read(message).unwrap();
        let [(1, a), (2, b), (3, c), (4, d)] = fields[..] else { panic!("{fields:?}") };
        assert_eq!(a.varint("a"), Ok(300));
        assert_eq!(b.double("b"), Ok(1.5));
        assert_eq!(c.text("c"), Ok("ab"));
        assert_eq!(d.fixed32("d"), Ok(7));
        let error = d.text("encoding").unwrap_err().to_string();
        assert!(error.contains("encoding is 4 bytes"), "{error}");
    }

    #[test]
    fn numbers_in_a_row_and_one_by_one_are_the_same() {
        let (mut row, mut singles) = (Vec::new(), Vec::new());
        let both = [1.5_f64.to_le_bytes(), 2.5_f64.to_le_bytes()];
        Value::Bytes(&both.concat()).doubles("D", &mut row, 2).unwrap();
        for one in both {
            Value::Fixed64(one).doubles("D", &mut singles, 2).unwrap();
        }
        assert_eq!((&row, &singles), (&vec![1.5, 2.5], &vec![1.5, 2.5]));
        let error = Value::Fixed64(both[0]).doubles("D", &mut row, 2).unwrap_err().to_string();
        assert!(error.contains("D is more than 2 numbers"), "{error}");
        assert!(Value::Bytes(&[0; 7]).doubles("D", &mut Vec::new(), 2).is_err());
    }

    #[test]
    fn a_length_beyond_the_message_a_group_and_an_endless_number_are_errors() {
        let cut = read(b"\x1a\xff\xff\xff\xff\x0fab").unwrap_err();
        assert_eq!(cut, WireError::Short { field: "fields", needed: 0xffff_ffff, left: 2 });
        assert!(read(b"\x0b").unwrap_err().to_string().contains("wire type 3"));
        assert!(read(&[0xff; 11]).unwrap_err().to_string().contains("more than 10 bytes"));
    }

    proptest! {
        #[test]
        fn any_bytes_end_as_fields_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(Fields::new(&bytes).count() <= bytes.len());
        }
    }
}
