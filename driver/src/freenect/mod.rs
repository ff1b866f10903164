//! The first Kinect through libfreenect: colour, and depth in millimetres registered to it.
//! Tilt and LED are left alone.
//!
//! Played back by fakenect the library offers disparities alone; they are turned into
//! metres, and registered unless the dump holds a `camera.toml`, which says that they are.

#[allow(unsafe_code)]
mod sys;

use crate::camera_file::read_camera_file;
use crate::error::SourceError;
use crate::kinect;
use crate::live::{Camera, CameraFault, DeviceClock, Paired, Pairing, host_utime};
use crate::tum::DEFAULT_MAX_PAIR_GAP_US;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::frame::{ColorImage, DepthImage, RgbdFrame};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

pub use sys::device_count;

/// The device counts at 60 MHz.
const TICKS_PER_US: f64 = 60.0;
const MM_PER_METRE: f64 = 1000.0;

/// An open Kinect.
pub struct FreenectCamera {
    device: sys::Device,
    camera: Arc<PinholeCamera>,
    registered: bool,
    clock: DeviceClock,
    pairing: Pairing<Vec<u8>, Vec<u16>>,
}

impl FreenectCamera {
    /// Opens the device of a number, counted from 0.
    ///
    /// # Errors
    /// [`SourceError::Device`] says whether it is missing or held by another, and what to do.
    pub fn open(index: i32, camera: Option<PinholeCamera>) -> Result<Self, SourceError> {
        let device = sys::Device::open(index)
            .map_err(|reason| SourceError::Device { name: format!("freenect:{index}"), reason })?;
        let dump = dump_camera().filter(|_| device.is_playback());
        let described = dump.map(|path| read_camera_file(&path)).transpose()?;
        let registered = described.is_some() || !device.is_playback();
        let camera = camera.or(described).unwrap_or_else(PinholeCamera::kinect);
        Ok(Self {
            device,
            camera: Arc::new(camera),
            registered,
            clock: DeviceClock::new(TICKS_PER_US),
            pairing: Pairing::new(DEFAULT_MAX_PAIR_GAP_US),
        })
    }

    fn assemble(&self, pair: Paired<Vec<u8>, Vec<u16>>) -> Result<RgbdFrame, CameraFault> {
        let (width, height) = sys::SIZE;
        let depth = if self.device.is_playback() {
            let metres = pair.depth.iter().map(|&d| kinect::metres_of(d)).collect();
            DepthImage::from_metres(width, height, metres)
        } else {
            DepthImage::from_raw(width, height, &pair.depth, MM_PER_METRE)
        };
        let damaged = |e: crate::FrameError| CameraFault::Damaged(e.to_string());
        let mut depth = depth.map_err(damaged)?;
        if !self.registered {
            depth = kinect::registration().register(&depth, &self.camera);
        }
        let color = ColorImage::new(width, height, pair.color).map_err(damaged)?;
        RgbdFrame::new(pair.utime, Arc::clone(&self.camera), color, depth).map_err(damaged)
    }
}

/// `camera.toml` of the dump that fakenect plays.
fn dump_camera() -> Option<PathBuf> {
    let path = PathBuf::from(std::env::var_os("FAKENECT_PATH")?).join("camera.toml");
    path.is_file().then_some(path)
}

impl Camera for FreenectCamera {
    fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault> {
        if self.device.is_idle() {
            self.device.process_events(timeout)?;
        }
        while let Some(picture) = self.device.take_picture() {
            let utime = self.clock.utime(picture.ticks, host_utime());
            let pair = match picture.pixels {
                sys::Pixels::Color(rgb) => self.pairing.color(utime, rgb),
                sys::Pixels::Depth(raw) => self.pairing.depth(utime, raw),
            };
            if let Some(pair) = pair {
                return self.assemble(pair).map(Some);
            }
        }
        Ok(None)
    }

    fn pairing(&self) -> (u64, i64) {
        self.pairing.losses()
    }
}
