//! Cameras that OpenNI2 drives (Xtion, Astra, Kinect) and its recordings.

#[allow(unsafe_code)]
mod sys;

use crate::camera::PinholeCamera;
use crate::frame::{ColorImage, DepthImage, RgbdFrame};
use crate::gate::{Gate, Timeline};
use crate::live::{Camera, CameraFault, DeviceClock, Paired, Pairing, host_utime};
use crate::source::{RgbdSource, SourceError};
use crate::statistics::SourceStatistics;
use crate::tum::DEFAULT_MAX_PAIR_GAP_US;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use sys::{Device, Sensor};

pub use sys::list_devices;

/// A live camera.
pub struct OpenNi2Camera {
    device: Device,
    camera: Arc<PinholeCamera>,
    clock: DeviceClock,
    pairing: Pairing<sys::Picture, sys::Picture>,
}

impl OpenNi2Camera {
    /// Opens a device by its URI; the first one where it is empty.
    ///
    /// # Errors
    /// [`SourceError::Device`] with the library's own words and what to do.
    pub fn open(uri: &str, camera: Option<&PinholeCamera>) -> Result<Self, SourceError> {
        let failed = |reason| SourceError::Device { name: format!("openni2:{uri}"), reason };
        let device = Device::open(uri).map_err(|e| {
            failed(format!("{e}; \"linkage doctor\" lists devices and what is missing"))
        })?;
        let camera = Arc::new(camera.cloned().unwrap_or_else(|| camera_of(&device)));
        Ok(Self {
            device,
            camera,
            clock: DeviceClock::new(1.0),
            pairing: Pairing::new(DEFAULT_MAX_PAIR_GAP_US),
        })
    }
}

impl Camera for OpenNi2Camera {
    fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault> {
        let Some(sensor) = self.device.wait(timeout).map_err(CameraFault::Lost)? else {
            return Ok(None);
        };
        let picture = self.device.read(sensor).map_err(CameraFault::Lost)?;
        // The device counts from its start, which differs after each reconnection.
        let utime = self.clock.utime(picture.utime as u32, host_utime());
        let pair = match sensor {
            Sensor::Color => self.pairing.color(utime, picture),
            Sensor::Depth => self.pairing.depth(utime, picture),
        };
        pair.map(|pair| assemble(pair, &self.camera)).transpose().map_err(CameraFault::Damaged)
    }

    fn pairing(&self) -> (u64, i64) {
        self.pairing.losses()
    }
}

/// A recording of OpenNI2, read as fast as it is taken.
pub struct OniRecording {
    name: String,
    device: Device,
    camera: Arc<PinholeCamera>,
    pairing: Pairing<sys::Picture, sys::Picture>,
    gate: Gate,
    delivered: u64,
    frames: usize,
    /// Number of the last picture read of each: playback may pass over some.
    read: [usize; 2],
    /// Time of the last picture of each.
    reached: [i64; 2],
}

impl OniRecording {
    /// Opens an `.oni` file.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when it is missing, damaged or lacks colour or depth.
    pub fn open(path: &Path, camera: Option<&PinholeCamera>) -> Result<Self, SourceError> {
        let broken =
            |reason: String| SourceError::Recording { path: path.display().to_string(), reason };
        if !path.is_file() {
            return Err(broken("no such file".to_owned()));
        }
        let absolute = path.canonicalize().map_err(|e| broken(e.to_string()))?;
        let uri = absolute.to_str().ok_or_else(|| broken("its name is no UTF-8".to_owned()))?;
        let device = Device::open_recording(uri).map_err(|e| {
            broken(format!("{e}; a file that is cut short lacks its index: record it again"))
        })?;
        let frames = device.recorded(Sensor::Color).min(device.recorded(Sensor::Depth));
        if frames == 0 {
            return Err(broken("it holds no pair of colour and depth".to_owned()));
        }
        Ok(Self {
            name: format!("oni:{}", path.display()),
            camera: Arc::new(camera.cloned().unwrap_or_else(|| camera_of(&device))),
            device,
            pairing: Pairing::new(DEFAULT_MAX_PAIR_GAP_US),
            gate: Gate::new(Timeline::GoesOn),
            delivered: 0,
            frames,
            read: [0; 2],
            reached: [i64::MIN; 2],
        })
    }

    /// The sensor whose next picture is due: the one that lags behind. A read past the last
    /// picture would block for ever.
    fn due(&self) -> Option<Sensor> {
        [Sensor::Color, Sensor::Depth]
            .into_iter()
            .filter(|s| self.read[*s as usize] < self.device.recorded(*s))
            .min_by_key(|s| self.reached[*s as usize])
    }

    /// Reads the picture after the last one. The library keeps one picture a stream: on its way
    /// to the other stream's next one it may have passed over ours.
    fn read_next(&mut self, sensor: Sensor) -> Result<sys::Picture, String> {
        let next = self.read[sensor as usize] + 1;
        let picture = self.device.read(sensor)?;
        if picture.number <= next {
            return Ok(picture);
        }
        tracing::debug!(sensor = ?sensor, number = picture.number, next, "passed over");
        self.device.seek(sensor, next)?;
        self.device.read(sensor)
    }

    fn broken(&self, reason: String) -> SourceError {
        SourceError::Recording { path: self.name.clone(), reason }
    }
}

impl RgbdSource for OniRecording {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        while let Some(sensor) = self.due() {
            let picture = self.read_next(sensor).map_err(|e| self.broken(e))?;
            self.read[sensor as usize] = picture.number.max(self.read[sensor as usize] + 1);
            self.reached[sensor as usize] = picture.utime;
            let pair = match sensor {
                Sensor::Color => self.pairing.color(picture.utime, picture),
                Sensor::Depth => self.pairing.depth(picture.utime, picture),
            };
            let Some(pair) = pair else { continue };
            match assemble(pair, &self.camera) {
                Ok(frame) => {
                    // A recording has no other clock.
                    let arrival = frame.utime;
                    if let Some(frame) = self.gate.pass(frame, arrival) {
                        self.delivered += 1;
                        return Ok(Some(frame));
                    }
                }
                Err(reason) => {
                    self.gate.statistics.damaged += 1;
                    tracing::warn!(source = self.name, reason, "damaged frame");
                }
            }
        }
        Ok(None)
    }

    fn frame_count(&self) -> Option<usize> {
        Some(self.frames)
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn statistics(&self) -> SourceStatistics {
        let (unpaired, largest_pair_gap_us) = self.pairing.losses();
        SourceStatistics {
            delivered: self.delivered,
            unpaired,
            largest_pair_gap_us,
            ..self.gate.statistics
        }
    }
}

/// Intrinsics from the field of view, which is all that OpenNI2 tells.
fn camera_of(device: &Device) -> PinholeCamera {
    let (width, height) = device.size();
    let [horizontal, vertical] = device.field_of_view();
    let focal = |pixels: usize, angle: f64| pixels as f64 / (2.0 * (angle / 2.0).tan());
    PinholeCamera {
        width,
        height,
        fx: focal(width, horizontal),
        fy: focal(height, vertical),
        cx: (width as f64 - 1.0) / 2.0,
        cy: (height as f64 - 1.0) / 2.0,
        depth_units_per_metre: 1000.0,
        distortion: [0.0; 8],
    }
}

fn assemble(
    pair: Paired<sys::Picture, sys::Picture>,
    camera: &Arc<PinholeCamera>,
) -> Result<RgbdFrame, String> {
    let (color, depth) = (pair.color, pair.depth);
    let text = |e: crate::FrameError| e.to_string();
    let color = ColorImage::new(color.width, color.height, color.bytes).map_err(text)?;
    let raw: Vec<u16> =
        depth.bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    let depth = DepthImage::from_raw(depth.width, depth.height, &raw, depth.units_per_metre)
        .map_err(text)?;
    RgbdFrame::new(pair.utime, Arc::clone(camera), color, depth).map_err(text)
}
