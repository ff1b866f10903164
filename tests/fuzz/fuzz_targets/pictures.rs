//! A PNG or JPEG of any bytes: refused, or a picture of the size that was expected.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::{image_file, jpeg};
use std::io::Cursor;

const SIZE: (usize, usize) = (16, 8);

fuzz_target!(|bytes: &[u8]| {
    for color in [
        image_file::decode_png_color(Cursor::new(bytes), SIZE),
        jpeg::decode(bytes, SIZE),
        jpeg::decode_motion(bytes, SIZE),
    ]
    .into_iter()
    .flatten()
    {
        assert_eq!((color.width(), color.height()), SIZE);
    }
    if let Ok(raw) = image_file::decode_png_depth(Cursor::new(bytes), SIZE) {
        assert_eq!(raw.len(), SIZE.0 * SIZE.1);
    }
});
