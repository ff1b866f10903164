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
use std::collections::{BTreeMap, VecDeque};
use std::io::Read;
use std::path::{Path, PathBuf};

/// An opened folder.
pub struct Rosbag2Reader {
    metadata: Metadata,
    topics: Vec<Topic>,
    /// Places of topics by their names.
    places: BTreeMap<String, usize>,
    selected: Option<Vec<usize>>,
    /// Files that are not opened yet.
    waiting: VecDeque<PathBuf>,
    current: Option<Part>,
}

/// A file, and the places of its topics among all; topics above the limit have none.
struct Part {
    reader: Box<dyn BagReader>,
    places: Vec<Option<usize>>,
}

impl Rosbag2Reader {
    /// Opens a folder.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when its description or one of its files cannot be read.
    pub fn open(dir: &Path) -> Result<Self, SourceError> {
        let metadata = metadata::read(dir)?;
        let mut topics: Vec<Topic> = Vec::new();
        let mut places = BTreeMap::new();
        for file in &metadata.files {
            for topic in open_file(file, metadata.storage)?.topics() {
                if topics.len() < MAX_TOPICS && !places.contains_key(&topic.name) {
                    places.insert(topic.name.clone(), topics.len());
                    topics.push(topic.clone());
                }
            }
        }
        let waiting = metadata.files.iter().cloned().collect();
        Ok(Self { metadata, topics, places, selected: None, waiting, current: None })
    }

    fn open_next(&mut self) -> Result<bool, SourceError> {
        let Some(file) = self.waiting.pop_front() else { return Ok(false) };
        let mut reader = open_file(&file, self.metadata.storage)?;
        let places: Vec<Option<usize>> =
            reader.topics().iter().map(|topic| self.places.get(&topic.name).copied()).collect();
        let is_asked =
            |place: usize| self.selected.as_ref().is_none_or(|asked| asked.contains(&place));
        let here: Vec<usize> =
            (0..places.len()).filter(|topic| places[*topic].is_some_and(is_asked)).collect();
        reader.select(&here)?;
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
                let Some(place) = part.places[message.topic] else { continue };
                message.topic = place;
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

#[cfg(test)]
mod tests {
    use super::*;
    use rusqlite::Connection;
    use tempfile::TempDir;

    /// A file of messages: number and name of topics, then topic, time in microseconds and bytes.
    fn write_file(path: &Path, topics: &[(u32, &str)], messages: &[(u32, i64, &[u8])]) {
        let mut connection = Connection::open(path).unwrap();
        let file = connection.transaction().unwrap();
        let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, \
            serialization_format TEXT, offered_qos_profiles TEXT);
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);";
        file.execute_batch(tables).unwrap();
        for (id, name) in topics {
            let sql = "INSERT INTO topics VALUES(?1, ?2, 'sensor_msgs/msg/Image', 'cdr', '')";
            file.execute(sql, (id, name)).unwrap();
        }
        for (topic, utime, bytes) in messages {
            let sql = "INSERT INTO messages(topic_id, timestamp, data) VALUES(?1, ?2, ?3)";
            file.execute(sql, (topic, 1000 * utime, bytes)).unwrap();
        }
        file.commit().unwrap();
    }

    /// A bag of two files that number their topics otherwise.
    fn bag(compression: &str) -> TempDir {
        let dir = tempfile::tempdir().unwrap();
        let text = format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n  \
             relative_file_paths:\n    - a.db3\n    - b.db3\n{compression}  topics_with_message_count: []\n"
        );
        std::fs::write(dir.path().join(METADATA_FILE), text).unwrap();
        let first: [(u32, i64, &[u8]); 2] = [(1, 10, b"left 1"), (2, 20, b"right 1")];
        write_file(&dir.path().join("a.db3"), &[(1, "/left"), (2, "/right")], &first);
        let second: [(u32, i64, &[u8]); 3] =
            [(1, 30, b"right 2"), (5, 40, b"top"), (7, 50, b"left 2")];
        let topics = [(1, "/right"), (5, "/top"), (7, "/left")];
        write_file(&dir.path().join("b.db3"), &topics, &second);
        dir
    }

    /// Topics by name with the messages.
    fn read(mut reader: Rosbag2Reader) -> Vec<(String, Vec<u8>)> {
        let mut all = Vec::new();
        while let Some(message) = reader.next_message().unwrap() {
            all.push((reader.topics()[message.topic].name.clone(), message.bytes));
        }
        all
    }

    #[test]
    fn files_follow_each_other_and_a_topic_is_one_whatever_its_number_in_each() {
        let dir = bag("");
        let reader = Rosbag2Reader::open(dir.path()).unwrap();
        let names: Vec<&str> = reader.topics().iter().map(|t| t.name.as_str()).collect();
        assert_eq!(names, ["/left", "/right", "/top"]);
        let expected = [
            ("/left", "left 1"),
            ("/right", "right 1"),
            ("/right", "right 2"),
            ("/top", "top"),
            ("/left", "left 2"),
        ];
        let expected = expected.map(|(name, bytes)| (name.to_owned(), bytes.as_bytes().to_vec()));
        assert_eq!(read(reader), expected);
    }

    #[test]
    fn topics_that_are_chosen_are_read_from_every_file() {
        let dir = bag("");
        let mut reader = Rosbag2Reader::open(dir.path()).unwrap();
        reader.select(&[1]).unwrap();
        let bytes: Vec<Vec<u8>> = read(reader).into_iter().map(|(_, bytes)| bytes).collect();
        assert_eq!(bytes, [b"right 1".to_vec(), b"right 2".to_vec()]);
    }

    #[test]
    fn messages_of_topics_above_the_limit_are_left_out() {
        let dir = bag("");
        let names: Vec<String> = (0..MAX_TOPICS).map(|i| format!("/topic{i}")).collect();
        let topics: Vec<(u32, &str)> = (1..).zip(names.iter().map(String::as_str)).collect();
        std::fs::remove_file(dir.path().join("a.db3")).unwrap();
        let messages: [(u32, i64, &[u8]); 2] = [(1, 10, b"first"), (10_000, 20, b"last")];
        write_file(&dir.path().join("a.db3"), &topics, &messages);
        let reader = Rosbag2Reader::open(dir.path()).unwrap();
        assert_eq!(reader.topics().len(), MAX_TOPICS);
        let bytes: Vec<Vec<u8>> = read(reader).into_iter().map(|(_, bytes)| bytes).collect();
        assert_eq!(
            bytes,
            [b"first".to_vec(), b"last".to_vec()],
            "those of the second file have no place"
        );
    }

    #[test]
    fn a_file_that_is_missing_is_told_by_its_name() {
        let dir = bag("");
        std::fs::remove_file(dir.path().join("b.db3")).unwrap();
        let error = Rosbag2Reader::open(dir.path()).err().expect("it is refused").to_string();
        assert!(error.contains("b.db3"), "{error}");
        assert!(Rosbag2Reader::open(&dir.path().join("a.db3")).is_err(), "a file is no bag");
    }

    #[test]
    fn messages_that_were_compressed_are_unpacked_and_damaged_ones_come_short() {
        let packed = zstd::encode_all(&b"a message"[..], 1).unwrap();
        assert_eq!(unpacked(&packed), b"a message");
        assert!(unpacked(b"no zstd at all").is_empty() && unpacked(b"").is_empty());
        assert!(unpacked(&packed[..packed.len() - 3]).len() <= b"a message".len());
        let dir = bag("  compression_format: zstd\n  compression_mode: MESSAGE\n");
        let all = read(Rosbag2Reader::open(dir.path()).unwrap());
        assert!(all.len() == 5 && all.iter().all(|(_, bytes)| bytes.is_empty()));
    }
}
