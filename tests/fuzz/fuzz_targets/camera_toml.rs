//! A camera.toml of any bytes: refused, or a camera that projects what it back-projects to where
//! it was.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::{PinholeCamera, text_table};

fuzz_target!(|bytes: &[u8]| {
    let Ok(camera) = PinholeCamera::parse(&text_table::decode(bytes)) else { return };
    for (u, v) in [(0.0, 0.0), (camera.cx, camera.cy)] {
        let pixel = camera.project(&camera.back_project(u, v, 1.0)).expect("it lies ahead");
        assert!((pixel.x - u).abs() < 0.1 && (pixel.y - v).abs() < 0.1, "{camera:?} {pixel}");
    }
});
