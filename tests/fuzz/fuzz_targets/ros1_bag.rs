//! A ROS 1 bag of any bytes, behind the first ones that every bag has: refused, or read to its end.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::bag::reader::{BagReader, MAX_MESSAGE_BYTES};
use linkage_driver::rosbag1::Rosbag1Reader;
use std::io::Cursor;

fuzz_target!(|bytes: &[u8]| {
    let bag = [b"#ROSBAG V2.0\n", bytes].concat();
    let Ok(mut reader) = Rosbag1Reader::new("fuzz.bag", Cursor::new(bag)) else { return };
    let topics = reader.topics().len();
    while let Ok(Some(message)) = reader.next_message() {
        assert!(message.topic < topics.max(reader.topics().len()));
        assert!(message.bytes.len() <= MAX_MESSAGE_BYTES);
    }
});
