//! Lists of a recording of any text: refused, or pairs in the order of time.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::tum::{DEFAULT_MAX_PAIR_GAP_US, RecordingIndex};
use std::fs;

fuzz_target!(|lists: (&str, &str)| {
    let dir = tempfile::tempdir().expect("a scratch folder can be made");
    fs::write(dir.path().join("a"), []).expect("can be written");
    fs::write(dir.path().join("rgb.txt"), lists.0).expect("can be written");
    fs::write(dir.path().join("depth.txt"), lists.1).expect("can be written");
    if let Ok(index) = RecordingIndex::read(dir.path(), DEFAULT_MAX_PAIR_GAP_US) {
        assert!(index.pairs.is_sorted_by(|a, b| a.utime < b.utime));
    }
});
