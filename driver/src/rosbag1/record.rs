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
