//! A packet of any bytes behind each fingerprint that stands for frames.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::PinholeCamera;
use linkage_driver::lcm::decode_frame;
use linkage_lcm::Message;
use linkage_lcm::messages::{bot_core, kinect, openni};
use std::sync::Arc;

fuzz_target!(|input: (u8, &[u8])| {
    let (kind, body) = input;
    let fingerprint = match kind % 3 {
        0 => kinect::FrameMsg::fingerprint(),
        1 => openni::FrameMsg::fingerprint(),
        _ => bot_core::Images::fingerprint(),
    };
    let packet = [&fingerprint.to_be_bytes(), body].concat();
    let camera = PinholeCamera { width: 4, height: 2, cx: 1.5, cy: 0.5, ..PinholeCamera::kinect() };
    let _ = decode_frame(&packet, &Arc::new(camera));
});
