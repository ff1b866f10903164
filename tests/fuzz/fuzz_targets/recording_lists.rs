//! A list of pictures of any bytes: refused, or entries in the order of time; a table of numbers
//! of the same bytes: refused, or finite.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::text_table;
use linkage_driver::tum::parse_list;

fuzz_target!(|bytes: &[u8]| {
    let text = text_table::decode(bytes);
    if let Ok(entries) = parse_list(&text) {
        assert!(entries.is_sorted_by(|a, b| a.utime < b.utime));
    }
    for row in text_table::rows(&text) {
        let numbers = row.numbers().unwrap_or_default();
        assert!(numbers.iter().all(|x| x.is_finite()));
    }
});
