//! Descriptions of recordings of any bytes: `metadata.yaml` of ROS 2, and intrinsics of other
//! programs: refused, or read.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::folders::{parse_info, parse_matrix, parse_open3d};
use linkage_driver::rosbag2::parse_metadata;
use linkage_driver::text_table;
use std::path::Path;

fuzz_target!(|bytes: &[u8]| {
    let text = text_table::decode(bytes);
    let dir = Path::new("bag");
    if let Ok(metadata) = parse_metadata(&text, dir) {
        assert!(metadata.files.iter().all(|file| file.parent() == Some(dir)));
    }
    let _ = (parse_matrix(&text), parse_open3d(&text), parse_info(&text));
});
