//! An MCAP file of any bytes, behind the first ones that every such file has: refused, or read to its end.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::bag::reader::{BagReader, MAX_MESSAGE_BYTES, MAX_TOPICS};
use linkage_driver::mcap_file::McapReader;
use std::sync::LazyLock;
use tempfile::TempDir;

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder"));

fuzz_target!(|bytes: &[u8]| {
    let path = FOLDER.path().join("fuzz.mcap");
    std::fs::write(&path, [b"\x89MCAP0\r\n", bytes].concat()).expect("a file can be written");
    let Ok(mut reader) = McapReader::open(&path) else { return };
    let topics = reader.topics().len();
    assert!(topics <= MAX_TOPICS);
    while let Ok(Some(message)) = reader.next_message() {
        assert!(message.topic < topics);
        assert!(message.bytes.len() <= MAX_MESSAGE_BYTES);
    }
});
