//! A database of rosbag2 with any bytes in it: a whole one is changed where the input says. It is refused, or read to
//! its end.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::bag::reader::{BagReader, MAX_MESSAGE_BYTES, MAX_TOPICS};
use linkage_driver::rosbag2::SqliteReader;
use rusqlite::Connection;
use std::sync::LazyLock;
use tempfile::TempDir;

const TABLES: &str = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
    INSERT INTO topics VALUES(1, '/color', 'sensor_msgs/msg/Image', 'cdr');
    INSERT INTO messages VALUES(1, 1, 5000, x'01'), (2, 1, 6000, zeroblob(3000)), (3, 1, 7000, x'03');";

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder"));
static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let path = FOLDER.path().join("whole.db3");
    let database = Connection::open(&path).expect("a database");
    database.execute_batch(TABLES).expect("tables");
    drop(database);
    std::fs::read(&path).expect("it can be read")
});

fuzz_target!(|changes: Vec<(u16, u8)>| {
    let mut database = WHOLE.clone();
    for (at, byte) in changes {
        let at = usize::from(at) % database.len();
        database[at] = byte;
    }
    let path = FOLDER.path().join("fuzz.db3");
    std::fs::write(&path, database).expect("a file can be written");
    let Ok(mut reader) = SqliteReader::open(&path) else { return };
    let topics = reader.topics().len();
    assert!(topics <= MAX_TOPICS);
    // Every message has a larger number than the one before, so a damaged database has an end too.
    let mut messages = 0;
    while let Ok(Some(message)) = reader.next_message() {
        assert!(message.topic < topics);
        assert!(message.bytes.len() <= MAX_MESSAGE_BYTES);
        messages += 1;
        assert!(messages <= 100_000, "the database has no end");
    }
});
