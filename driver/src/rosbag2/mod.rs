//! Bags of ROS 2: a folder with `metadata.yaml` and files of messages, SQLite databases or MCAP
//! files, which are read one after the other.

mod metadata;
mod sqlite;

pub use metadata::{FILE as METADATA_FILE, parse as parse_metadata};
pub use sqlite::SqliteReader;

use crate::bag::reader::{BagMessage, BagReader, MAX_MESSAGE_BYTES, MAX_TOPICS, Topic};
use crate::error::SourceError;
use crate::mcap_file::McapReader;
use metadata::{Metadata, Storage};
use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};

/// An opened folder.
pub struct Rosbag2Reader {
    metadata: Metadata,
    topics: Vec<Topic>,
    selected: Option<Vec<usize>>,
    /// Files that are not opened yet.
    waiting: VecDeque<PathBuf>,
    current: Option<Part>,
}

/// A file, and the places of its topics among all.
struct Part {
    reader: Box<dyn BagReader>,
    places: Vec<usize>,
}

impl Rosbag2Reader {
    /// Opens a folder.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when its description or one of its files cannot be read.
    pub fn open(dir: &Path) -> Result<Self, SourceError> {
        let metadata = metadata::read(dir)?;
        let mut topics: Vec<Topic> = Vec::new();
        for file in &metadata.files {
            for topic in open_file(file, metadata.storage)?.topics() {
                if topics.len() < MAX_TOPICS && !topics.iter().any(|t| t.name == topic.name) {
                    topics.push(topic.clone());
                }
            }
        }
        let waiting = metadata.files.iter().cloned().collect();
        Ok(Self { metadata, topics, selected: None, waiting, current: None })
    }

    fn open_next(&mut self) -> Result<bool, SourceError> {
        let Some(file) = self.waiting.pop_front() else { return Ok(false) };
        let mut reader = open_file(&file, self.metadata.storage)?;
        let place = |topic: &Topic| self.topics.iter().position(|t| t.name == topic.name);
        let places: Vec<usize> =
            reader.topics().iter().map(|t| place(t).unwrap_or(usize::MAX)).collect();
        if let Some(selected) = &self.selected {
            let here = places.iter().enumerate().filter(|(_, place)| selected.contains(place));
            let here: Vec<usize> = here.map(|(topic, _)| topic).collect();
            reader.select(&here)?;
        }
        self.current = Some(Part { reader, places });
        Ok(true)
    }
}

impl BagReader for Rosbag2Reader {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn select(&mut self, topics: &[usize]) -> Result<(), SourceError> {
        self.selected = Some(topics.to_vec());
        Ok(())
    }

    fn next_message(&mut self) -> Result<Option<BagMessage>, SourceError> {
        loop {
            if let Some(part) = &mut self.current {
                let Some(mut message) = part.reader.next_message()? else {
                    self.current = None;
                    continue;
                };
                message.topic = part.places[message.topic];
                if self.metadata.has_compressed_messages {
                    message.bytes = unpacked(&message.bytes);
                }
                return Ok(Some(message));
            }
            if !self.open_next()? {
                return Ok(None);
            }
        }
    }
}

fn open_file(path: &Path, storage: Storage) -> Result<Box<dyn BagReader>, SourceError> {
    Ok(match storage {
        Storage::Sqlite => Box::new(SqliteReader::open(path)?),
        Storage::Mcap => Box::new(McapReader::open(path)?),
    })
}

/// A message that zstd compressed. What cannot be unpacked is left as short as it is: it is
/// damaged, which its parser tells.
fn unpacked(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    if let Ok(decoder) = zstd::Decoder::new(bytes) {
        let _ = decoder.take(MAX_MESSAGE_BYTES as u64).read_to_end(&mut out);
    }
    out
}
