//! A list of pictures, of pairs of them, or of the times of frames, of any bytes: refused, or entries in the order of
//! time; a table of numbers of the same bytes: refused, or finite.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::folders::{parse_associations, parse_odometry};
use linkage_driver::text_table;
use linkage_driver::tum::parse_list;
use std::path::Path;

fuzz_target!(|bytes: &[u8]| {
    let text = text_table::decode(bytes);
    if let Ok(entries) = parse_list(&text) {
        assert!(entries.is_sorted_by(|a, b| a.utime < b.utime));
        assert!(entries.iter().all(|e| text_table::possible_names(e.name).contains(&e.name)));
    }
    if let Ok(pairs) = parse_associations(&text, Path::new("desk")) {
        assert!(
            pairs.is_sorted_by(|a, b| a.utime < b.utime) && pairs.iter().all(|p| p.gap_us >= 0)
        );
    }
    if let Ok(odometry) = parse_odometry(&text) {
        assert!(odometry.utimes.values().is_sorted_by(|a, b| a < b));
        assert!(odometry.first_line > 1);
    }
    for row in text_table::rows(&text) {
        let numbers = row.numbers().unwrap_or_default();
        assert!(numbers.iter().all(|x| x.is_finite()));
    }
});
