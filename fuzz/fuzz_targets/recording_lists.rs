//! A list of pictures of any text: refused, or entries in the order of time.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::tum::parse_list;

fuzz_target!(|text: &str| {
    if let Ok(entries) = parse_list(text) {
        assert!(entries.is_sorted_by(|a, b| a.utime < b.utime));
    }
});
