//! MCAP files: the container of ROS 2's bags and of Foxglove.
//!
//! Read from beginning to end, so that a file that was cut short is read as far as it goes; memory
//! is that of the largest message.

use crate::bag::reader::{BagMessage, BagReader, MAX_MESSAGE_BYTES, MAX_TOPICS, Topic};
use crate::bag::wire::WireFormat;
use crate::error::SourceError;
use linkage_frames::text_table;
use mcap::sans_io::{LinearReaderOptions, SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{Channel, McapError};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

/// Largest record of a file, bytes: a message with its header, or an index of chunks.
const MAX_RECORD_BYTES: usize = MAX_MESSAGE_BYTES + 1024;

/// An opened file.
pub struct McapReader {
    path: PathBuf,
    topics: Vec<Topic>,
    /// Places of topics by their names.
    places: BTreeMap<String, usize>,
    selected: Vec<bool>,
    messages: mcap::io::MessageReader<BufReader<File>>,
    has_ended: bool,
}

impl McapReader {
    /// Opens a file and lists its topics: from its summary, or where a recording was cut short
    /// from its messages.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when it cannot be read or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let broken = |reason: String| broken(path, reason);
        let mut file = text_table::regular_file(path).map_err(|e| broken(e.to_string()))?;
        let topics = match topics_of_summary(&mut file) {
            Ok(topics) if !topics.is_empty() => topics,
            _ => {
                let mut file = text_table::regular_file(path).map_err(|e| broken(e.to_string()))?;
                topics_of_messages(&mut file).map_err(|e| broken(told(&e)))?
            }
        };
        let places = topics.iter().enumerate().map(|(i, t)| (t.name.clone(), i)).collect();
        let file = text_table::regular_file(path).map_err(|e| broken(e.to_string()))?;
        let (selected, messages) = (vec![true; topics.len()], message_reader(file));
        let path = path.to_owned();
        Ok(Self { path, topics, places, selected, messages, has_ended: false })
    }
}

impl BagReader for McapReader {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn select(&mut self, topics: &[usize]) -> Result<(), SourceError> {
        self.selected = (0..self.topics.len()).map(|t| topics.contains(&t)).collect();
        Ok(())
    }

    fn next_message(&mut self) -> Result<Option<BagMessage>, SourceError> {
        while !self.has_ended {
            let message = match self.messages.next() {
                Some(Ok(message)) => message,
                Some(Err(e)) if is_cut(&e) => {
                    let file = self.path.display();
                    tracing::warn!(%file, "the file ends too early; what came before is read");
                    self.has_ended = true;
                    break;
                }
                Some(Err(e)) => return Err(broken(&self.path, told(&e))),
                None => {
                    self.has_ended = true;
                    break;
                }
            };
            let Some(&topic) = self.places.get(&message.channel.topic) else { continue };
            if self.selected[topic] {
                return Ok(Some(BagMessage {
                    topic,
                    log_utime: i64::try_from(message.log_time / 1000).unwrap_or(i64::MAX),
                    bytes: message.data.into_owned(),
                }));
            }
        }
        Ok(None)
    }
}

fn broken(path: &Path, reason: String) -> SourceError {
    SourceError::Recording { path: path.display().to_string(), reason }
}

/// An error in our own words where the library's text does not help.
fn told(error: &McapError) -> String {
    match error {
        McapError::BadMagic => "is no MCAP file".to_owned(),
        other => format!("damaged MCAP file: {other}"),
    }
}

fn is_cut(error: &McapError) -> bool {
    matches!(error, McapError::UnexpectedEof | McapError::UnexpectedEoc)
}

fn message_reader(file: File) -> mcap::io::MessageReader<BufReader<File>> {
    let options = LinearReaderOptions::default().with_record_length_limit(MAX_RECORD_BYTES);
    mcap::io::MessageReader::new_with_options(BufReader::with_capacity(1 << 16, file), options)
}

fn topics_of_summary(file: &mut File) -> Result<Vec<Topic>, McapError> {
    let size = file.metadata()?.len();
    let options = SummaryReaderOptions::default()
        .with_file_size(size)
        .with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(count) => {
                let read = file.read(reader.insert(count))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    let channels = reader.finish().map(|summary| summary.channels).unwrap_or_default();
    let mut channels: Vec<_> = channels.into_iter().collect();
    channels.sort_by_key(|(id, _)| *id);
    Ok(distinct(channels.iter().map(|(_, channel)| topic_of(channel))))
}

fn topics_of_messages(file: &mut File) -> Result<Vec<Topic>, McapError> {
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    for message in message_reader(file.try_clone()?) {
        match message {
            Ok(message) if !topics.contains_key(&message.channel.topic) => {
                topics.insert(message.channel.topic.clone(), topic_of(&message.channel));
            }
            Ok(_) => {}
            // What came before the end is read.
            Err(e) if is_cut(&e) && !topics.is_empty() => break,
            Err(e) => return Err(e),
        }
        if topics.len() >= MAX_TOPICS {
            break;
        }
    }
    Ok(topics.into_values().collect())
}

/// Topics by their names; a topic may have several channels.
fn distinct(topics: impl Iterator<Item = Topic>) -> Vec<Topic> {
    let mut seen = std::collections::BTreeSet::new();
    topics.filter(|t| seen.insert(t.name.clone())).take(MAX_TOPICS).collect()
}

fn topic_of(channel: &Channel<'_>) -> Topic {
    let format = match channel.message_encoding.as_str() {
        "cdr" => Some(WireFormat::Cdr),
        "ros1" => Some(WireFormat::Ros1),
        _ => None,
    };
    let schema = channel.schema.as_ref().map_or("", |schema| &*schema.name);
    Topic::new(&channel.topic, schema, format)
}
