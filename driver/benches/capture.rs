//! What a frame costs between camera and taker beside its decoding: at 30 Hz a core has
//! 33.3 ms for each.

use criterion::{Criterion, criterion_group, criterion_main};
use linkage_driver::lcm::{Packing, decode_frame, encode_frame};
use linkage_driver::live::{Camera, CameraFault, LiveConfig, LiveSource, Pairing};
use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame, RgbdSource};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

fn frame() -> RgbdFrame {
    let camera = Arc::new(PinholeCamera::kinect());
    let rgb = (0..640 * 480 * 3_u32).map(|i| (i * 37 % 251) as u8).collect();
    let metres = (0..640 * 480_u32).map(|i| 0.8 + (i % 640) as f32 * 0.003).collect();
    let color = ColorImage::new(640, 480, rgb).expect("the buffer fits");
    let depth = DepthImage::from_metres(640, 480, metres).expect("the buffer fits");
    RgbdFrame::new(0, camera, color, depth).expect("one size")
}

/// A camera that always has the next frame.
struct Ready(RgbdFrame);

impl Camera for Ready {
    fn next_frame(&mut self, _: Duration) -> Result<Option<RgbdFrame>, CameraFault> {
        self.0.utime += 33_333;
        Ok(Some(self.0.clone()))
    }
}

fn capture(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("a frame of 640x480");
    let opener = || Ok(Box::new(Ready(frame())) as Box<dyn Camera>);
    // The camera is always ahead, so that the taker waits for nothing but the capture.
    let config = LiveConfig { queue: 2, ..LiveConfig::default() };
    let mut source = LiveSource::start("bench", Box::new(opener), config, Arc::default())
        .expect("the camera opens");
    group.bench_function("captured, watched, queued, taken", |b| {
        b.iter(|| black_box(source.next_frame().expect("a frame")));
    });
    drop(source);
    let mut pairing = Pairing::new(20_000);
    let mut utime = 0;
    group.bench_function("paired", |b| {
        b.iter(|| {
            utime += 33_333;
            pairing.color(utime, ());
            black_box(pairing.depth(utime + 4_000, ()))
        });
    });
    for (name, packing) in [("raw", Packing::LOSSLESS), ("JPEG", Packing::SMALL)] {
        let message = encode_frame(&frame(), packing).expect("can be encoded");
        let bytes = linkage_lcm::encode(&message).expect("can be encoded");
        let camera = Arc::new(PinholeCamera::kinect());
        group.bench_function(format!("decoded from a message, {name}"), |b| {
            b.iter(|| black_box(decode_frame(&bytes, &camera).expect("whole")));
        });
    }
}

criterion_group!(benches, capture);
criterion_main!(benches);
