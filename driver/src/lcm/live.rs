//! Frames from a live LCM network.

use super::message::decode_frame;
use crate::camera::PinholeCamera;
use crate::frame::RgbdFrame;
use crate::live::{Camera, CameraFault};
use crate::source::SourceError;
use linkage_lcm::Lcm;
use std::sync::Arc;
use std::time::Duration;

/// A camera whose frames another program publishes.
pub struct LcmCamera {
    lcm: Lcm,
    camera: Arc<PinholeCamera>,
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
        lcm.subscribe(channel).map_err(failed)?;
        Ok(Self { lcm, camera })
    }
}

impl Camera for LcmCamera {
    fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault> {
        let packet = self.lcm.receive(timeout).map_err(|e| CameraFault::Lost(e.to_string()))?;
        packet
            .map(|p| decode_frame(&p.bytes, &self.camera))
            .transpose()
            .map_err(|e| CameraFault::Damaged(e.to_string()))
    }
}
