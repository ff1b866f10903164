//! Frames from a live LCM network.

use super::message::decode_frame;
use crate::error::SourceError;
use crate::live::{Camera, CameraFault};
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{ScaleCheck, ScaleIssue};
use linkage_frames::frame::RgbdFrame;
use linkage_lcm::{Lcm, Reception};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Bytes of a pixel at most: colour, and depth as floats.
const BYTES_PER_PIXEL: usize = 3 + 4;
/// Bytes of a message beside its pixels at most.
const BESIDE_PIXELS: usize = 64 << 10;
/// Time between two log messages about frames that do not arrive.
const TELL_EVERY: Duration = Duration::from_secs(10);

/// A camera whose frames another program publishes.
pub struct LcmCamera {
    lcm: Lcm,
    camera: Arc<PinholeCamera>,
    /// Checks whether the first frames' depth fits the camera.
    scale: ScaleCheck,
    reported: Reported,
}

/// What was last logged about frames that did not arrive.
#[derive(Default)]
struct Reported {
    missing: u64,
    when: Option<Instant>,
}

impl LcmCamera {
    /// Joins a network and listens on a channel. The camera is given, or assumed.
    ///
    /// # Errors
    /// [`SourceError::Device`] when the network cannot be joined.
    pub fn open(
        url: &str,
        channel: &str,
        camera: Arc<PinholeCamera>,
        is_camera_assumed: bool,
    ) -> Result<Self, SourceError> {
        let failed = |e: linkage_lcm::LcmError| SourceError::Device {
            name: format!("lcm:{url}#{channel}"),
            reason: e.to_string(),
        };
        let mut lcm = Lcm::new(url).map_err(failed)?;
        let pixels = camera.width.saturating_mul(camera.height);
        let largest = pixels.saturating_mul(BYTES_PER_PIXEL).saturating_add(BESIDE_PIXELS);
        lcm.subscribe_up_to(channel, largest).map_err(failed)?;
        let scale = ScaleCheck::new(camera.depth_units_per_metre, is_camera_assumed);
        Ok(Self { lcm, camera, scale, reported: Reported::default() })
    }

    /// Tells the log that frames do not arrive, and what to do, now and then.
    fn tell_missing(&mut self) {
        let reception = self.lcm.reception();
        let is_due = self.reported.when.is_none_or(|when| when.elapsed() >= TELL_EVERY);
        if reception.missing() > self.reported.missing && is_due {
            self.reported = Reported { missing: reception.missing(), when: Some(Instant::now()) };
            tracing::warn!(url = self.lcm.url(), "{}", words(&reception));
        }
    }
}

fn words(reception: &Reception) -> String {
    let Reception { received, requested_buffer, granted_buffer, .. } = *reception;
    let mut words = format!("{} frames did not arrive, {received} did", reception.missing());
    if granted_buffer < requested_buffer {
        words += &format!(
            "; the system granted {granted_buffer} of {requested_buffer} bytes to receive them: as root, \"sysctl -w net.core.rmem_max={requested_buffer}\""
        );
    }
    words
}

impl Camera for LcmCamera {
    fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault> {
        let packet = self.lcm.receive(timeout).map_err(|e| CameraFault::Lost(e.to_string()))?;
        self.tell_missing();
        let Some(packet) = packet else { return Ok(None) };
        let frame = decode_frame(&packet.bytes, &self.camera)
            .map_err(|e| CameraFault::Damaged(e.to_string()))?;
        match self.scale.look(&frame.depth) {
            Some(ScaleIssue::Wrong(reason)) => return Err(CameraFault::Unusable(reason)),
            Some(ScaleIssue::Odd(reason)) => tracing::warn!(url = self.lcm.url(), "{reason}"),
            None => {}
        }
        Ok(Some(frame))
    }

    fn missing(&self) -> u64 {
        self.lcm.reception().missing()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_do_not_arrive_are_told_with_what_to_do() {
        let reception = Reception {
            received: 37,
            lost: 1,
            incomplete: 103,
            requested_buffer: 8_388_608,
            granted_buffer: 212_992,
            ..Reception::default()
        };
        let told = words(&reception);
        assert!(told.starts_with("104 frames did not arrive, 37 did"), "{told}");
        assert!(told.contains("sysctl -w net.core.rmem_max=8388608"), "{told}");
        let enough = Reception { granted_buffer: 8_388_608, ..reception };
        assert!(!words(&enough).contains("sysctl"));
    }
}
