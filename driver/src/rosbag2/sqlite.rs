//! A rosbag2 file of messages in an SQLite database (`.db3`).

use crate::bag::message_format::MessageFormat;
use crate::bag::reader::{BagMessage, BagReader, MAX_MESSAGE_BYTES, MAX_TOPICS, Topic};
use crate::bag::wire::WireFormat;
use crate::error::SourceError;
use linkage_frames::text_table;
use rusqlite::{Connection, OpenFlags, OptionalExtension};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Number, topic, time in nanoseconds, and the bytes of a message that is not above the limit.
type Row = (i64, i64, i64, Option<Vec<u8>>);

/// An opened database.
pub struct SqliteReader {
    path: PathBuf,
    database: Connection,
    topics: Vec<Topic>,
    /// Places of topics by their numbers in the database.
    places: BTreeMap<i64, usize>,
    /// Text of the query for the next message.
    query: String,
    last_id: i64,
}

impl SqliteReader {
    /// Opens a database, which is not written to.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when it is none, or holds no tables of rosbag2.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let broken =
            |reason: String| SourceError::Recording { path: path.display().to_string(), reason };
        text_table::regular_file(path).map_err(|e| broken(e.to_string()))?;
        let (database, topics, places) = tables(path)
            .map_err(|e| broken(format!("is no rosbag2 database that can be read: {e}")))?;
        let (path, query) = (path.to_owned(), query(&places, None));
        Ok(Self { path, database, topics, places, query, last_id: i64::MIN })
    }

    fn damaged(&self, reason: &str) -> SourceError {
        let reason = format!("damaged database: {reason}");
        SourceError::Recording { path: self.path.display().to_string(), reason }
    }

    fn row(&mut self) -> rusqlite::Result<Option<Row>> {
        let mut statement = self.database.prepare_cached(&self.query)?;
        let most = MAX_MESSAGE_BYTES as i64;
        let row = statement.query_row([self.last_id, most], |row| {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
        });
        row.optional()
    }
}

impl BagReader for SqliteReader {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn select(&mut self, topics: &[usize]) -> Result<(), SourceError> {
        self.query = query(&self.places, Some(topics));
        Ok(())
    }

    fn next_message(&mut self) -> Result<Option<BagMessage>, SourceError> {
        loop {
            let row = self.row().map_err(|e| self.damaged(&e.to_string()))?;
            let Some((id, topic, timestamp_ns, bytes)) = row else { return Ok(None) };
            // Damaged pages give the same messages again and again.
            if id <= self.last_id {
                return Err(self.damaged(&format!("message {id} follows message {}", self.last_id)));
            }
            self.last_id = id;
            // A message above the limit comes without its bytes.
            if let (Some(&topic), Some(bytes)) = (self.places.get(&topic), bytes) {
                return Ok(Some(BagMessage { topic, log_utime: timestamp_ns / 1000, bytes }));
            }
        }
    }
}

/// The next message behind a number, in the order in which they were recorded.
fn query(places: &BTreeMap<i64, usize>, selected: Option<&[usize]>) -> String {
    let is_asked = |place: &usize| selected.is_none_or(|s| s.contains(place));
    let asked = places.iter().filter(|(_, place)| is_asked(place));
    let asked: Vec<String> = asked.map(|(id, _)| id.to_string()).collect();
    format!(
        "SELECT id, topic_id, timestamp, CASE WHEN length(data) <= ?2 THEN data END \
         FROM messages WHERE id > ?1 AND topic_id IN ({}) ORDER BY id LIMIT 1",
        asked.join(",")
    )
}

type Tables = (Connection, Vec<Topic>, BTreeMap<i64, usize>);

fn tables(path: &Path) -> rusqlite::Result<Tables> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let database = Connection::open_with_flags(path, flags)?;
    // What a foreign schema computes is not run.
    database.pragma_update(None, "trusted_schema", false)?;
    for table in ["topics", "messages"] {
        let sql = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?1";
        database.query_row(sql, [table], |_| Ok(()))?;
    }
    let mut topics = Vec::new();
    let mut places = BTreeMap::new();
    {
        let sql = "SELECT id, name, type, serialization_format FROM topics ORDER BY id LIMIT ?1";
        let mut statement = database.prepare(sql)?;
        let mut rows = statement.query([MAX_TOPICS as i64])?;
        while let Some(row) = rows.next()? {
            let (id, name): (i64, String) = (row.get(0)?, row.get(1)?);
            let (message_type, encoding): (String, String) = (row.get(2)?, row.get(3)?);
            let format = (encoding == "cdr").then_some(MessageFormat::Ros(WireFormat::Cdr));
            places.insert(id, topics.len());
            topics.push(Topic::new(&name, &message_type, format));
        }
    }
    Ok((database, topics, places))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCHEMA: &str = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
        INSERT INTO topics VALUES(1, '/a', 'sensor_msgs/msg/Image', 'cdr', '');
        INSERT INTO topics VALUES(7, '/b', 'sensor_msgs/msg/Image', 'cdr', '');
        INSERT INTO messages VALUES(1, 1, 5000, x'01');
        INSERT INTO messages VALUES(2, 7, 6000, x'02');
        INSERT INTO messages VALUES(3, 1, 7000, x'03');
        INSERT INTO messages VALUES(4, 1, 8000, zeroblob(68000000));";

    #[test]
    fn messages_come_as_they_were_recorded_without_those_above_the_limit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.db3");
        Connection::open(&path).unwrap().execute_batch(SCHEMA).unwrap();
        let mut reader = SqliteReader::open(&path).unwrap();
        assert_eq!(reader.topics()[1].name, "/b");
        let mut bytes = Vec::new();
        while let Some(message) = reader.next_message().unwrap() {
            bytes.push((message.log_utime, message.topic, message.bytes));
        }
        assert_eq!(bytes, [(5, 0, vec![1]), (6, 1, vec![2]), (7, 0, vec![3])]);
        let mut reader = SqliteReader::open(&path).unwrap();
        reader.select(&[1]).unwrap();
        assert_eq!(reader.next_message().unwrap().unwrap().bytes, [2]);
        assert_eq!(reader.next_message().unwrap(), None);
    }

    #[test]
    fn a_database_whose_pages_are_damaged_has_an_end() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.db3");
        Connection::open(&path)
            .unwrap()
            .execute_batch(&SCHEMA.replace("68000000", "4000"))
            .unwrap();
        let whole = std::fs::read(&path).unwrap();
        let mut ended = 0;
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 2;
            std::fs::write(&path, damaged).unwrap();
            let Ok(mut reader) = SqliteReader::open(&path) else { continue };
            let messages = (0..100).take_while(|_| matches!(reader.next_message(), Ok(Some(_))));
            assert!(messages.count() < 100, "byte {at}: it has no end");
            ended += 1;
        }
        assert!(ended > 1000, "{ended}");
    }

    #[test]
    fn a_view_in_the_place_of_a_table_and_other_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.db3");
        let hostile = "CREATE TABLE topics(id, name, type, serialization_format);
            CREATE VIEW messages AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x AS id FROM n;";
        Connection::open(&path).unwrap().execute_batch(hostile).unwrap();
        let error = SqliteReader::open(&path).err().unwrap().to_string();
        assert!(error.contains("a.db3") && error.contains("rosbag2"), "{error}");
        std::fs::write(&path, vec![7; 4096]).unwrap();
        assert!(SqliteReader::open(&path).is_err());
    }
}
