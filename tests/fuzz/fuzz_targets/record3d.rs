//! What a recording of Record3D holds, of any bytes: its description, depth and confidence are refused, or have the
//! size that is told.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::record3d::{confidence, metres, parse_metadata};

const SIZE: (usize, usize) = (24, 32);

fuzz_target!(|bytes: &[u8]| {
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
