//! ROS 1 bags (format 2.0), also those of RealSense's viewer: chunks plain, bz2 or lz4.
//!
//! Chunks are read one after the other. The compressed chunk is in memory and is decompressed
//! message by message, so that at most one decompressed message is in memory.

mod record;

use crate::bag::message_format::MessageFormat;
use crate::bag::reader::{BagMessage, BagReader, MAX_TOPICS, Topic};
use crate::bag::wire::WireFormat;
use crate::error::SourceError;
use linkage_frames::text_table;
use record::{
    RecordError, RecordHeader, RecordKind, read_data, read_message, skip_data, text_field,
};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// The first bytes of a bag.
const MAGIC: &[u8; 13] = b"#ROSBAG V2.0\n";
/// Largest chunk as it lies in the file, bytes; usual are 768 kB.
const MAX_CHUNK_BYTES: usize = 256 << 20;
/// Largest description of a connection, bytes: it holds the definition of its messages.
const MAX_CONNECTION_BYTES: usize = 4 << 20;

/// A chunk whose records are read.
type Chunk = Box<dyn Read + Send>;

/// An opened bag.
pub struct Rosbag1Reader<R> {
    name: String,
    file: R,
    topics: Vec<Topic>,
    /// Places of topics by the numbers of connections.
    places: BTreeMap<u32, usize>,
    selected: Vec<bool>,
    chunk: Option<Chunk>,
    has_ended: bool,
}

impl Rosbag1Reader<BufReader<File>> {
    /// Opens a file.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when it cannot be read or is no bag.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        match text_table::regular_file(path) {
            Ok(file) => Self::new(&name, BufReader::with_capacity(1 << 16, file)),
            Err(e) => Err(SourceError::Recording { path: name, reason: e.to_string() }),
        }
    }
}

impl<R: Read + Seek + Send> Rosbag1Reader<R> {
    /// Begins to read; the name is for messages.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when it is no bag.
    pub fn new(name: &str, file: R) -> Result<Self, SourceError> {
        let mut reader = Self {
            name: name.to_owned(),
            file,
            topics: Vec::new(),
            places: BTreeMap::new(),
            selected: Vec::new(),
            chunk: None,
            has_ended: false,
        };
        reader.list_topics().map_err(|e| reader.broken(&e))?;
        reader.selected = vec![true; reader.topics.len()];
        Ok(reader)
    }

    fn broken(&self, error: &RecordError) -> SourceError {
        let reason = match error {
            RecordError::Cut => format!("{error}: run rosbag reindex on it"),
            _ => error.to_string(),
        };
        SourceError::Recording { path: self.name.clone(), reason }
    }

    /// Finds all connections: in the index, or without one in all chunks.
    fn list_topics(&mut self) -> Result<(), RecordError> {
        let index = self.rewind()?;
        let end = self.file.seek(SeekFrom::End(0))?;
        // A recording that was not finished has no index.
        if index > 0 && index < end {
            self.file.seek(SeekFrom::Start(index))?;
            while let Some(header) = RecordHeader::read(&mut self.file)? {
                match header.kind()? {
                    RecordKind::Connection => {
                        let data =
                            read_data(&mut self.file, header.data_bytes, MAX_CONNECTION_BYTES)?;
                        self.add_connection(&header, &data)?;
                    }
                    _ => skip_data(&mut self.file, header.data_bytes)?,
                }
            }
        }
        if self.topics.is_empty() {
            self.rewind()?;
            // No message is asked for yet: all are passed over.
            match self.advance() {
                Ok(_) => {}
                Err(RecordError::Cut) if !self.topics.is_empty() => {}
                Err(e) => return Err(e),
            }
        }
        self.chunk = None;
        self.rewind()?;
        Ok(())
    }

    /// Goes behind the first record, which tells where the index is.
    fn rewind(&mut self) -> Result<u64, RecordError> {
        self.file.seek(SeekFrom::Start(0))?;
        let mut magic = [0; MAGIC.len()];
        let not_one = || RecordError::Damaged("is no ROS 1 bag of format 2.0".to_owned());
        self.file.read_exact(&mut magic).map_err(|_| not_one())?;
        if &magic != MAGIC {
            return Err(not_one());
        }
        let header = RecordHeader::read(&mut self.file)?.ok_or(RecordError::Cut)?;
        if header.kind()? != RecordKind::BagHeader {
            return Err(RecordError::Damaged("its first record is no bag header".to_owned()));
        }
        skip_data(&mut self.file, header.data_bytes)?;
        header.u64("index_pos")
    }

    fn add_connection(&mut self, header: &RecordHeader, data: &[u8]) -> Result<(), RecordError> {
        let topic = header.text("topic")?;
        let message_type = text_field(data, "type")?;
        let place = self.topics.iter().position(|t| t.name == topic);
        if place.is_none() && self.topics.len() >= MAX_TOPICS || self.places.len() >= MAX_TOPICS {
            return Err(RecordError::Damaged(format!("more than {MAX_TOPICS} topics")));
        }
        let place = place.unwrap_or_else(|| {
            self.topics.push(Topic::new(
                topic,
                message_type,
                Some(MessageFormat::Ros(WireFormat::Ros1)),
            ));
            self.topics.len() - 1
        });
        self.places.insert(header.u32("conn")?, place);
        Ok(())
    }

    /// The next message that is asked for; `None` at the end.
    fn advance(&mut self) -> Result<Option<BagMessage>, RecordError> {
        loop {
            if let Some(mut chunk) = self.chunk.take() {
                while let Some(header) = RecordHeader::read(&mut chunk)? {
                    if let Some(message) = self.take_record(&mut chunk, &header)? {
                        self.chunk = Some(chunk);
                        return Ok(Some(message));
                    }
                }
            }
            let Some(header) = RecordHeader::read(&mut self.file)? else { return Ok(None) };
            if header.kind()? == RecordKind::Chunk {
                let bytes = read_data(&mut self.file, header.data_bytes, MAX_CHUNK_BYTES)?;
                self.chunk = Some(opened(header.text("compression")?, bytes)?);
            } else {
                skip_data(&mut self.file, header.data_bytes)?;
            }
        }
    }

    /// Takes a record within a chunk.
    fn take_record(
        &mut self,
        chunk: &mut Chunk,
        header: &RecordHeader,
    ) -> Result<Option<BagMessage>, RecordError> {
        match header.kind()? {
            RecordKind::Connection => {
                let data = read_data(chunk, header.data_bytes, MAX_CONNECTION_BYTES)?;
                self.add_connection(header, &data)?;
                Ok(None)
            }
            RecordKind::Message => {
                let place = self.places.get(&header.u32("conn")?).copied();
                let asked = place.filter(|t| self.selected.get(*t).is_some_and(|s| *s));
                let Some(topic) = asked else {
                    skip_data(chunk, header.data_bytes)?;
                    return Ok(None);
                };
                let log_utime = header.utime("time")?;
                let bytes = read_message(chunk, header.data_bytes)?;
                Ok(Some(BagMessage { topic, log_utime, bytes }))
            }
            _ => skip_data(chunk, header.data_bytes).map(|()| None),
        }
    }
}

impl<R: Read + Seek + Send> BagReader for Rosbag1Reader<R> {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn select(&mut self, topics: &[usize]) -> Result<(), SourceError> {
        self.selected = (0..self.topics.len()).map(|t| topics.contains(&t)).collect();
        Ok(())
    }

    fn next_message(&mut self) -> Result<Option<BagMessage>, SourceError> {
        if self.has_ended {
            return Ok(None);
        }
        match self.advance() {
            Ok(Some(message)) => return Ok(Some(message)),
            Ok(None) => {}
            Err(RecordError::Cut) => {
                let file = &self.name;
                tracing::warn!(file, "the bag ends too early; what came before is read");
            }
            Err(e) => return Err(self.broken(&e)),
        }
        self.has_ended = true;
        Ok(None)
    }
}

/// Reads what a chunk holds.
fn opened(compression: &str, bytes: Vec<u8>) -> Result<Chunk, RecordError> {
    let bytes = Cursor::new(bytes);
    match compression {
        "none" => Ok(Box::new(bytes)),
        "bz2" => Ok(Box::new(BufReader::new(bzip2::read::BzDecoder::new(bytes)))),
        "lz4" => Ok(Box::new(BufReader::new(lz4::Decoder::new(bytes)?))),
        other => Err(RecordError::Damaged(format!(
            "chunks of compression \"{other}\" are not read; none, bz2 and lz4 are"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(fields: &[(&str, &[u8])]) -> Vec<u8> {
        let field = |(name, value): &(&str, &[u8])| {
            let field = [name.as_bytes(), b"=", value].concat();
            [&(field.len() as u32).to_le_bytes()[..], &field].concat()
        };
        fields.iter().flat_map(field).collect()
    }

    fn record(header: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
        let header = fields(header);
        let length = |bytes: &[u8]| (bytes.len() as u32).to_le_bytes();
        [&length(&header)[..], &header, &length(data), data].concat()
    }

    fn connection() -> Vec<u8> {
        let data = fields(&[("type", b"sensor_msgs/Image"), ("md5sum", b"*")]);
        record(&[("op", &[7]), ("conn", &3_u32.to_le_bytes()), ("topic", b"/depth")], &data)
    }

    fn message(seconds: u32, data: &[u8]) -> Vec<u8> {
        let time = [seconds.to_le_bytes(), 500_000_000_u32.to_le_bytes()].concat();
        record(&[("op", &[2]), ("conn", &3_u32.to_le_bytes()), ("time", &time)], data)
    }

    /// A bag of one chunk, with or without its index.
    fn bag(compression: &str, chunk: &[u8], has_index: bool) -> Vec<u8> {
        let head = |index: u64| {
            let header = [("op", &[3][..]), ("index_pos", &index.to_le_bytes())];
            [MAGIC.to_vec(), record(&header, &[b' '; 40])].concat()
        };
        let size = 99_u32.to_le_bytes();
        let header = [("op", &[5][..]), ("compression", compression.as_bytes()), ("size", &size)];
        let chunk = record(&header, chunk);
        let index = (head(0).len() + chunk.len()) as u64;
        if has_index {
            return [head(index), chunk, connection()].concat();
        }
        [head(0), chunk].concat()
    }

    fn chunk() -> Vec<u8> {
        [connection(), message(1, b"one"), message(2, b"two")].concat()
    }

    fn compressed(compression: &str) -> Vec<u8> {
        use std::io::Write;
        match compression {
            "bz2" => {
                let mut out = bzip2::write::BzEncoder::new(Vec::new(), Default::default());
                out.write_all(&chunk()).unwrap();
                out.finish().unwrap()
            }
            "lz4" => {
                let mut out = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
                out.write_all(&chunk()).unwrap();
                out.finish().0
            }
            _ => chunk(),
        }
    }

    fn read(bytes: &[u8]) -> Result<Vec<(i64, Vec<u8>)>, SourceError> {
        let mut reader = Rosbag1Reader::new("test.bag", Cursor::new(bytes))?;
        let mut messages = Vec::new();
        while let Some(message) = reader.next_message()? {
            assert_eq!(reader.topics()[message.topic].name, "/depth");
            messages.push((message.log_utime, message.bytes));
        }
        Ok(messages)
    }

    #[test]
    fn chunks_of_all_compressions_hold_the_same_messages() {
        let expected = [(1_500_000, b"one".to_vec()), (2_500_000, b"two".to_vec())];
        for compression in ["none", "bz2", "lz4"] {
            for has_index in [true, false] {
                let bag = bag(compression, &compressed(compression), has_index);
                assert_eq!(read(&bag).unwrap(), expected, "{compression}, index {has_index}");
            }
        }
        let error = read(&bag("zip", &chunk(), true)).unwrap_err().to_string();
        assert!(error.contains("test.bag") && error.contains("\"zip\""), "{error}");
    }

    #[test]
    fn messages_of_other_topics_are_passed_over() {
        let bytes = bag("none", &chunk(), true);
        let mut reader = Rosbag1Reader::new("test.bag", Cursor::new(bytes)).unwrap();
        reader.select(&[]).unwrap();
        assert_eq!(reader.next_message().unwrap(), None);
    }

    #[test]
    fn a_bag_that_is_cut_is_read_up_to_there() {
        let whole = bag("none", &chunk(), false);
        let cut = &whole[..whole.len() - 2];
        // The chunk is cut: its messages are lost, nothing else.
        assert!(read(cut).is_err_and(|e| e.to_string().contains("reindex")));
        for length in 0..whole.len() {
            let _ = read(&whole[..length]);
        }
    }

    #[test]
    fn hostile_lengths_are_errors_and_take_no_memory() {
        for compression in ["none", "bz2", "lz4"] {
            let whole = bag(compression, &compressed(compression), true);
            for at in 0..whole.len() {
                let mut damaged = whole.clone();
                for byte in &mut damaged[at..(at + 4).min(whole.len())] {
                    *byte = 0xff;
                }
                let _ = read(&damaged);
            }
        }
        let error = read(b"#ROSBAG V1.2\nabc").unwrap_err().to_string();
        assert!(error.contains("no ROS 1 bag"), "{error}");
    }
}
