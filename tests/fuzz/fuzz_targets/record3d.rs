//! A recording of Record3D, and what it holds, of any bytes: its archive is refused or opened; its description, depth
//! and confidence are refused, or have the size that is told.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::record3d::{confidence, metres, open, parse_metadata};
use std::sync::LazyLock;
use tempfile::TempDir;

const SIZE: (usize, usize) = (24, 32);

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder"));

fuzz_target!(|bytes: &[u8]| {
    let path = FOLDER.path().join("fuzz.r3d");
    std::fs::write(&path, bytes).expect("a file can be written");
    let _ = open(&path, None);
    if let Ok(metadata) = parse_metadata(bytes) {
        let (width, height) = metadata.depth_size;
        assert!(width * height > 0);
        let _ = metadata.utime(7);
    }
    if let Ok(metres) = metres(bytes, SIZE) {
        assert_eq!(metres.len(), SIZE.0 * SIZE.1);
    }
    if let Ok(confidence) = confidence(bytes, SIZE) {
        assert_eq!(confidence.len(), SIZE.0 * SIZE.1);
    }
});
