//! An event log of any bytes: read to its end, and no event larger than what is there.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_lcm::LogReader;

fuzz_target!(|bytes: &[u8]| {
    let mut reader = LogReader::new(bytes);
    let mut total = 0;
    while let Some(event) = reader.next_event().expect("memory can be read") {
        total += event.bytes.len() + event.channel.len();
    }
    assert!(total <= bytes.len());
});
