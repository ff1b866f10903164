//! A camera.toml of any text: refused, or a camera that projects what it back-projects.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::PinholeCamera;

fuzz_target!(|text: &str| {
    if let Ok(camera) = PinholeCamera::parse(text) {
        let point = camera.back_project(camera.cx, camera.cy, 1.0);
        let _ = camera.project(&point);
    }
});
