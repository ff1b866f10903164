//! Frames from a live LCM network.

use super::message::{LCM_UNITS_PER_METRE, decode_frame};
use crate::error::SourceError;
use crate::live::{Camera, CameraFault};
use linkage_frames::camera::{MAX_PIXELS, PinholeCamera};
use linkage_frames::depth::{ScaleCheck, ScaleIssue};
use linkage_frames::frame::RgbdFrame;
use linkage_lcm::{Lcm, Reception};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Bytes of a message at most: the largest camera's raw pictures have 3 bytes of colour and 2 of depth a pixel, and
/// there is some room for the rest. The camera's own size does not tell it: a message may hold a second picture, or be
/// of another size, which is told as damaged.
const MOST_BYTES: usize = 6 * MAX_PIXELS;
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
    /// Joins a network and listens on a channel.
    ///
    /// # Errors
    /// [`SourceError::Device`] when the network cannot be joined.
    pub fn open(url: &str, channel: &str, camera: Arc<PinholeCamera>) -> Result<Self, SourceError> {
        let failed = |e: linkage_lcm::LcmError| SourceError::Device {
            name: format!("lcm:{url}#{channel}"),
            reason: e.to_string(),
        };
        let mut lcm = Lcm::new(url).map_err(failed)?;
        lcm.subscribe_up_to(channel, MOST_BYTES).map_err(failed)?;
        let scale = ScaleCheck::new(LCM_UNITS_PER_METRE, false);
        Ok(Self { lcm, camera, scale, reported: Reported::default() })
    }

    /// Tells the log that frames do not arrive, and what to do, now and then.
    fn tell_missing(&mut self) {
        let reception = self.lcm.reception();
        let is_due = self.reported.when.is_none_or(|when| when.elapsed() >= TELL_EVERY);
        let missing = missing(&reception);
        if missing > self.reported.missing && is_due {
            self.reported = Reported { missing, when: Some(Instant::now()) };
            tracing::warn!(url = self.lcm.url(), "{}", words(&reception));
        }
    }
}

/// Frames that were sent and did not arrive, including those that are too large.
fn missing(reception: &Reception) -> u64 {
    reception.missing() + reception.oversized
}

fn words(reception: &Reception) -> String {
    let Reception { received, requested_buffer, granted_buffer, .. } = *reception;
    let missing = missing(reception);
    let mut words = format!("{missing} frames did not arrive, {received} did");
    if reception.oversized > 0 {
        let oversized = reception.oversized;
        words += &format!("; {oversized} of the {missing} are larger than {MOST_BYTES} bytes");
    }
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
        if let Some(ScaleIssue::Wrong(what) | ScaleIssue::Odd(what)) = self.scale.look(&frame.depth)
        {
            tracing::warn!(
                url = self.lcm.url(),
                "{what} (depth in LCM messages is in millimetres)"
            );
        }
        Ok(Some(frame))
    }

    fn missing(&self) -> u64 {
        missing(&self.lcm.reception())
    }
}

#[cfg(test)]
mod tests {
    use super::super::message::{Packing, encode_frame};
    use super::*;
    use linkage_frames::frame::{ColorImage, DepthImage};
    use linkage_lcm::encode;

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

    #[test]
    fn frames_that_are_too_large_are_counted_among_the_missing() {
        let reception = Reception { received: 37, lost: 4, oversized: 2, ..Reception::default() };
        assert_eq!(missing(&reception), 6);
        let told = words(&reception);
        assert!(
            told.starts_with("6 frames did not arrive, 37 did; 2 of the 6 are larger"),
            "{told}"
        );
        assert!(!words(&Reception { oversized: 0, ..reception }).contains("larger"));
    }

    #[test]
    fn the_largest_frame_that_is_taken_arrives() {
        let (width, height) = (3840, 2160);
        let camera = Arc::new(PinholeCamera { width, height, ..PinholeCamera::kinect() });
        assert_eq!(width * height, MAX_PIXELS);
        let color = ColorImage::new(width, height, vec![90; 3 * MAX_PIXELS]).unwrap();
        let depth = DepthImage::from_metres(width, height, vec![1.0; MAX_PIXELS]).unwrap();
        let frame = RgbdFrame::new(1, Arc::clone(&camera), color, depth).unwrap();
        let bytes =
            encode(&encode_frame(&frame, Packing { jpeg: false, zlib: false }).unwrap()).unwrap();
        drop(frame);
        let mut listener = LcmCamera::open("memq://", "FRAMES", camera).unwrap();
        listener.lcm.publish_bytes("FRAMES", &bytes).unwrap();
        let frame = listener.next_frame(Duration::from_secs(10)).unwrap();
        assert_eq!((frame.map(|f| f.utime), listener.missing()), (Some(1), 0));
        listener.lcm.publish_bytes("FRAMES", &vec![0; MOST_BYTES + 1]).unwrap();
        assert!(listener.next_frame(Duration::from_secs(1)).unwrap().is_none());
        assert_eq!(listener.missing(), 1);
    }
}
