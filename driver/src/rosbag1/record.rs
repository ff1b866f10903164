//! Records of ROS 1 bags (format 2.0): a header of named fields, then data.
//!
//! Lengths are checked before memory is taken: a header is small, and data is only read when it is
//! asked for.

use crate::bag::reader::MAX_MESSAGE_BYTES;
use std::io::{self, Read};

/// Largest header of a record, bytes.
const MAX_HEADER_BYTES: u32 = 1 << 16;

/// A record that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file ends inside it.
    #[error("the file ends inside a record")]
    Cut,
    /// It breaks the rules of the format.
    #[error("damaged bag: {0}")]
    Damaged(String),
    /// The file cannot be read.
    #[error("{0}")]
    Io(io::Error),
}

impl From<io::Error> for RecordError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Cut,
            _ => Self::Io(error),
        }
    }
}

/// The kinds of records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordKind {
    /// The first record: where the index is.
    BagHeader,
    /// Records, most often compressed.
    Chunk,
    /// A topic of a publisher.
    Connection,
    /// A message.
    Message,
    /// An index, or what later versions may add.
    Other,
}

/// What stands before a record's data.
#[derive(Debug)]
pub struct RecordHeader {
    fields: Vec<u8>,
    /// Bytes of data that follow.
    pub data_bytes: u32,
}

impl RecordHeader {
    /// Reads a header; `None` at the end of the file.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn read(from: &mut impl Read) -> Result<Option<Self>, RecordError> {
        let mut length = [0; 4];
        if from.read(&mut length[..1])? == 0 {
            return Ok(None);
        }
        from.read_exact(&mut length[1..])?;
        let header_bytes = u32::from_le_bytes(length);
        if header_bytes > MAX_HEADER_BYTES {
            return Err(RecordError::Damaged(format!(
                "a header of {header_bytes} bytes, more than {MAX_HEADER_BYTES}"
            )));
        }
        let mut fields = vec![0; header_bytes as usize];
        from.read_exact(&mut fields)?;
        from.read_exact(&mut length)?;
        Ok(Some(Self { fields, data_bytes: u32::from_le_bytes(length) }))
    }

    /// The kind of the record.
    ///
    /// # Errors
    /// [`RecordError::Damaged`] without the field that says it.
    pub fn kind(&self) -> Result<RecordKind, RecordError> {
        Ok(match self.needed("op")? {
            [0x02] => RecordKind::Message,
            [0x03] => RecordKind::BagHeader,
            [0x05] => RecordKind::Chunk,
            [0x07] => RecordKind::Connection,
            _ => RecordKind::Other,
        })
    }

    /// A number of 32 bits.
    ///
    /// # Errors
    /// [`RecordError::Damaged`] where it is missing or of another length.
    pub fn u32(&self, name: &str) -> Result<u32, RecordError> {
        let bytes = self.needed(name)?.try_into();
        bytes.map(u32::from_le_bytes).map_err(|_| wrong_length(name))
    }

    /// A number of 64 bits.
    ///
    /// # Errors
    /// [`RecordError::Damaged`] where it is missing or of another length.
    pub fn u64(&self, name: &str) -> Result<u64, RecordError> {
        let bytes = self.needed(name)?.try_into();
        bytes.map(u64::from_le_bytes).map_err(|_| wrong_length(name))
    }

    /// A time, in microseconds.
    ///
    /// # Errors
    /// [`RecordError::Damaged`] where it is missing or of another length.
    pub fn utime(&self, name: &str) -> Result<i64, RecordError> {
        // Seconds, then nanoseconds, of 32 bits each.
        let both = self.u64(name)?;
        let (seconds, nanoseconds) = (both & 0xffff_ffff, both >> 32);
        Ok(seconds.cast_signed() * 1_000_000 + nanoseconds.cast_signed() / 1000)
    }

    /// A text.
    ///
    /// # Errors
    /// [`RecordError::Damaged`] where it is missing or no UTF-8.
    pub fn text(&self, name: &str) -> Result<&str, RecordError> {
        text_field(&self.fields, name)
    }

    fn needed(&self, name: &str) -> Result<&[u8], RecordError> {
        field(&self.fields, name)?
            .ok_or_else(|| RecordError::Damaged(format!("a record without its field {name}")))
    }
}

/// A text among the fields of a header, or of a connection's data.
///
/// # Errors
/// [`RecordError::Damaged`] where it is missing or no UTF-8.
pub fn text_field<'b>(fields: &'b [u8], name: &str) -> Result<&'b str, RecordError> {
    let bytes = field(fields, name)?
        .ok_or_else(|| RecordError::Damaged(format!("a record without its field {name}")))?;
    std::str::from_utf8(bytes).map_err(|_| RecordError::Damaged(format!("{name} is no UTF-8")))
}

/// The value of a field, each of which is `name=value` behind its length.
fn field<'b>(mut fields: &'b [u8], name: &str) -> Result<Option<&'b [u8]>, RecordError> {
    let cut = || RecordError::Damaged("a field that is longer than its record".to_owned());
    while !fields.is_empty() {
        let (length, rest) = fields.split_first_chunk::<4>().ok_or_else(cut)?;
        let (field, rest) =
            rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or_else(cut)?;
        if let Some(value) = field.strip_prefix(name.as_bytes()).and_then(|f| f.strip_prefix(b"="))
        {
            return Ok(Some(value));
        }
        fields = rest;
    }
    Ok(None)
}

fn wrong_length(name: &str) -> RecordError {
    RecordError::Damaged(format!("the field {name} has another length than it must"))
}

/// Reads a record's data. Memory is taken as bytes come, and for no more than a message may have.
///
/// # Errors
/// [`RecordError`].
pub fn read_data(from: &mut impl Read, bytes: u32, most: usize) -> Result<Vec<u8>, RecordError> {
    if bytes as usize > most {
        return Err(RecordError::Damaged(format!("{bytes} bytes in a record, more than {most}")));
    }
    let mut data = Vec::with_capacity((bytes as usize).min(1 << 20));
    from.take(u64::from(bytes)).read_to_end(&mut data)?;
    if data.len() < bytes as usize {
        return Err(RecordError::Cut);
    }
    Ok(data)
}

/// Reads a message's data.
///
/// # Errors
/// [`RecordError`].
pub fn read_message(from: &mut impl Read, bytes: u32) -> Result<Vec<u8>, RecordError> {
    read_data(from, bytes, MAX_MESSAGE_BYTES)
}

/// Passes over a record's data.
///
/// # Errors
/// [`RecordError`].
pub fn skip_data(from: &mut impl Read, bytes: u32) -> Result<(), RecordError> {
    let skipped = io::copy(&mut from.take(u64::from(bytes)), &mut io::sink())?;
    if skipped < u64::from(bytes) {
        return Err(RecordError::Cut);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fields as they stand in a header.
    fn fields(all: &[(&str, &[u8])]) -> Vec<u8> {
        let field = |(name, value): &(&str, &[u8])| {
            let text = [name.as_bytes(), b"=", value].concat();
            [&(text.len() as u32).to_le_bytes()[..], &text].concat()
        };
        all.iter().flat_map(field).collect()
    }

    /// A record of some fields and data.
    fn record(all: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
        let fields = fields(all);
        let length = |bytes: &[u8]| (bytes.len() as u32).to_le_bytes();
        [&length(&fields)[..], &fields, &length(data), data].concat()
    }

    fn header(all: &[(&str, &[u8])]) -> RecordHeader {
        RecordHeader::read(&mut &record(all, b"")[..]).unwrap().expect("a record")
    }

    fn is_damaged<T>(result: Result<T, RecordError>) -> bool {
        matches!(result, Err(RecordError::Damaged(_)))
    }

    #[test]
    fn records_are_read_one_after_the_other_to_the_end_of_the_file() {
        let both = [record(&[("op", &[0x02])], b"abc"), record(&[("op", &[0x05])], b"")].concat();
        let mut file = &both[..];
        let message = RecordHeader::read(&mut file).unwrap().expect("the first");
        assert_eq!((message.kind().unwrap(), message.data_bytes), (RecordKind::Message, 3));
        assert_eq!(read_message(&mut file, 3).unwrap(), b"abc");
        let chunk = RecordHeader::read(&mut file).unwrap().expect("the second");
        assert_eq!(chunk.kind().unwrap(), RecordKind::Chunk);
        assert!(RecordHeader::read(&mut file).unwrap().is_none());
    }

    #[test]
    fn fields_have_their_numbers_texts_and_times() {
        let time = [3_u32.to_le_bytes(), 250_000_000_u32.to_le_bytes()].concat();
        let header = header(&[
            ("conn", &7_u32.to_le_bytes()),
            ("topic", b"/camera=left"),
            ("time", &time),
            ("index_pos", &u64::MAX.to_le_bytes()),
        ]);
        assert_eq!(header.u32("conn").unwrap(), 7);
        assert_eq!(header.text("topic").unwrap(), "/camera=left");
        assert_eq!(header.utime("time").unwrap(), 3_250_000);
        assert_eq!(header.u64("index_pos").unwrap(), u64::MAX);
    }

    #[test]
    fn a_name_that_begins_another_is_not_that_field() {
        let header = header(&[("topics", b"many"), ("topic", b"one")]);
        assert_eq!(header.text("topic").unwrap(), "one");
    }

    #[test]
    fn missing_fields_and_those_of_another_length_or_no_text_are_told() {
        let header = header(&[("conn", b"abc"), ("topic", &[0xff, 0xfe])]);
        assert!(is_damaged(header.kind()) && is_damaged(header.u32("conn")));
        assert!(is_damaged(header.u64("conn")) && is_damaged(header.utime("time")));
        assert!(is_damaged(header.text("topic")) && is_damaged(header.text("type")));
    }

    #[test]
    fn a_field_that_is_longer_than_its_record_is_damage() {
        for fields in [vec![1, 0, 0], vec![200, 0, 0, 0, b'a'], vec![0xff; 4]] {
            assert!(is_damaged(text_field(&fields, "topic")), "{fields:?}");
        }
    }

    #[test]
    fn a_file_that_ends_inside_a_record_is_cut_wherever_it_ends() {
        let whole = record(&[("op", &[0x02]), ("conn", &[1, 0, 0, 0])], b"some data");
        for length in 1..whole.len() {
            let mut file = &whole[..length];
            let read = RecordHeader::read(&mut file).and_then(|header| {
                let header = header.expect("it is not the end");
                read_message(&mut file, header.data_bytes)
            });
            assert!(matches!(read, Err(RecordError::Cut)), "{length} bytes");
            let mut file = &whole[..length];
            let skipped = RecordHeader::read(&mut file).and_then(|header| {
                skip_data(&mut file, header.expect("it is not the end").data_bytes)
            });
            assert!(matches!(skipped, Err(RecordError::Cut)), "{length} bytes");
        }
    }

    #[test]
    fn lengths_that_no_record_has_take_no_memory() {
        let large = u32::MAX.to_le_bytes();
        assert!(is_damaged(RecordHeader::read(&mut &large[..])));
        assert!(is_damaged(read_message(&mut &b"few"[..], u32::MAX)));
        assert!(is_damaged(read_data(&mut &b"few"[..], 3, 2)));
    }
}
