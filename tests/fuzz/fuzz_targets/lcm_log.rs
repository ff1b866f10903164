//! An event log of any bytes: read to its end, and every byte belongs to one event or to none.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_lcm::LogReader;

/// Bytes of an event before its channel.
const HEADER: usize = 28;

fuzz_target!(|bytes: &[u8]| {
    let mut reader = LogReader::new(bytes);
    let mut used = 0;
    while let Some(event) = reader.next_event().expect("memory can be read") {
        used += HEADER + event.channel.len() + event.bytes.len();
    }
    assert_eq!(used as u64 + reader.skipped_bytes(), bytes.len() as u64);
});
