//! A packet of any bytes behind each fingerprint that stands for frames.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_driver::PinholeCamera;
use linkage_driver::lcm::decode_frame;
use linkage_lcm::Message;
use linkage_lcm::messages::{bot_core, kinect};
use std::sync::Arc;

fuzz_target!(|input: (bool, &[u8])| {
    let (of_kinect, body) = input;
    let fingerprint = if of_kinect {
        kinect::FrameMsg::fingerprint()
    } else {
        bot_core::Images::fingerprint()
    };
    let packet = [&fingerprint.to_be_bytes(), body].concat();
    let camera = PinholeCamera { width: 4, height: 2, cx: 1.5, cy: 0.5, ..PinholeCamera::kinect() };
    let _ = decode_frame(&packet, &Arc::new(camera));
});
