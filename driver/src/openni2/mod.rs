//! Cameras that OpenNI2 drives (Xtion, Astra, Kinect) and its recordings.

mod idle;
#[allow(unsafe_code)]
mod sys;

use crate::error::SourceError;
use crate::kinect;
use crate::live::{Camera, CameraFault, DeviceClock, Paired, Pairing, host_utime};
use crate::rgbd_source::RgbdSource;
use crate::statistics::SourceStatistics;
use crate::timestamp_filter::{Timeline, TimestampFilter};
use crate::tum::DEFAULT_MAX_PAIR_GAP_US;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{DepthSensor, Registration};
use linkage_frames::frame::{ColorImage, DepthImage, RgbdFrame};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use sys::{Device, Optics, Registered, Sensor};

pub use sys::list_devices;

/// A live camera.
pub struct OpenNi2Camera {
    device: Device,
    geometry: Geometry,
    clock: DeviceClock,
    pairing: Pairing<sys::Picture, sys::Picture>,
}

impl OpenNi2Camera {
    /// Opens a device by its URI; the first one where it is empty.
    ///
    /// # Errors
    /// [`SourceError::Device`] with the library's own error and what to do.
    pub fn open(uri: &str, camera: Option<&PinholeCamera>) -> Result<Self, SourceError> {
        let failed = |reason| SourceError::Device { name: format!("openni2:{uri}"), reason };
        let device = Device::open(uri).map_err(|e| {
            failed(format!("{e}; \"linkage doctor\" lists devices and what is missing"))
        })?;
        let geometry = Geometry::of(&device, camera, &format!("openni2:{uri}")).map_err(failed)?;
        Ok(Self {
            device,
            geometry,
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
        self.geometry.tell_mirroring(&self.device);
        // The device counts from its start, which differs after each reconnection.
        let utime = self.clock.utime(picture.utime as u32, host_utime());
        let pair = match sensor {
            Sensor::Color => self.pairing.color(utime, picture),
            Sensor::Depth => self.pairing.depth(utime, picture),
        };
        pair.map(|pair| self.geometry.assemble(pair)).transpose().map_err(CameraFault::Damaged)
    }

    fn pairing(&self) -> (u64, i64) {
        self.pairing.losses()
    }
}

/// Times that a recording is played anew for pictures that were passed over, each of which takes as
/// long as reading up to there: beyond that they are counted as missing.
const MOST_REPLAYS: usize = 3;

/// A recording of OpenNI2, read as fast as it is taken.
pub struct OniRecording {
    name: String,
    uri: String,
    replays: usize,
    device: Device,
    geometry: Geometry,
    pairing: Pairing<sys::Picture, sys::Picture>,
    timestamps: TimestampFilter,
    delivered: u64,
    frames: usize,
    played: Played,
}

/// How far each stream of a recording was played.
#[derive(Debug, Clone, Copy)]
struct Played {
    /// Number of the last picture read of each: playback may pass over some.
    read: [usize; 2],
    /// Time of the last picture of each, microseconds.
    reached: [i64; 2],
}

impl Default for Played {
    fn default() -> Self {
        Self { read: [0; 2], reached: [i64::MIN; 2] }
    }
}

impl Played {
    /// The sensor whose next picture is due, of those that were not played up to a picture of this
    /// number: the one that lags behind. A read past the last picture would block for ever.
    fn lagging(&self, until: [usize; 2]) -> Option<Sensor> {
        let behind = |s: &Sensor| self.read[*s as usize] < until[*s as usize];
        let both = [Sensor::Color, Sensor::Depth].into_iter().filter(behind);
        both.min_by_key(|s| self.reached[*s as usize])
    }

    fn pass(&mut self, sensor: Sensor, picture: &sys::Picture) {
        let i = sensor as usize;
        self.read[i] = picture.number.max(self.read[i] + 1);
        self.reached[i] = picture.utime;
    }
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
        let name = format!("oni:{}", path.display());
        Ok(Self {
            geometry: Geometry::of(&device, camera, &name).map_err(broken)?,
            name,
            uri: uri.to_owned(),
            replays: 0,
            device,
            pairing: Pairing::new(DEFAULT_MAX_PAIR_GAP_US),
            timestamps: TimestampFilter::new(Timeline::Continuous),
            delivered: 0,
            frames,
            played: Played::default(),
        })
    }

    /// Reads the picture after the last one. The library keeps one picture a stream: on its way
    /// to the other stream's next one it may have passed over ours, where the machine is busy.
    fn read_next(&mut self, sensor: Sensor) -> Result<sys::Picture, String> {
        let next = self.played.read[sensor as usize] + 1;
        let mut picture = self.device.read(sensor)?;
        while picture.number > next && self.replays < MOST_REPLAYS {
            self.replays += 1;
            tracing::debug!(sensor = ?sensor, number = picture.number, next, "passed over");
            picture = self.replayed(sensor, next)?;
        }
        Ok(picture)
    }

    /// Plays the recording anew, up to a picture of one sensor, or the first after it, and to where the
    /// other was. Seeking would be faster, but the library crashes in every seek: built with
    /// optimisation it passes on the address of a variable that has left its scope.
    fn replayed(&mut self, sensor: Sensor, next: usize) -> Result<sys::Picture, String> {
        let mut until = self.played.read;
        until[sensor as usize] = next;
        self.device.replay(&self.uri)?;
        let (mut played, mut reached) = (Played::default(), None);
        while let Some(due) = played.lagging(until) {
            let picture = self.device.read(due)?;
            played.pass(due, &picture);
            if due == sensor {
                reached = Some(picture);
            }
        }
        reached.ok_or_else(|| format!("picture {next} cannot be read"))
    }

    fn broken(&self, reason: String) -> SourceError {
        SourceError::Recording { path: self.name.clone(), reason }
    }
}

impl RgbdSource for OniRecording {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        let recorded = [Sensor::Color, Sensor::Depth].map(|s| self.device.recorded(s));
        while let Some(sensor) = self.played.lagging(recorded) {
            let picture = self.read_next(sensor).map_err(|e| self.broken(e))?;
            self.geometry.tell_mirroring(&self.device);
            self.played.pass(sensor, &picture);
            let pair = match sensor {
                Sensor::Color => self.pairing.color(picture.utime, picture),
                Sensor::Depth => self.pairing.depth(picture.utime, picture),
            };
            let Some(pair) = pair else { continue };
            match self.geometry.assemble(pair) {
                Ok(frame) => {
                    // A recording has no other clock.
                    let arrival = frame.utime;
                    if let Some(frame) = self.timestamps.pass(frame, arrival) {
                        self.delivered += 1;
                        return Ok(Some(frame));
                    }
                }
                Err(reason) => {
                    self.timestamps.statistics.damaged += 1;
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
            ..self.timestamps.statistics
        }
    }
}

/// How a device's pictures become frames.
struct Geometry {
    name: String,
    camera: Arc<PinholeCamera>,
    /// Registration of depth that the device does not register itself.
    registration: Option<Registration>,
    is_mirroring_told: bool,
}

impl Geometry {
    /// What a device tells of itself; the camera is the one that is given, if one is. Whatever is
    /// assumed is logged.
    fn of(device: &Device, camera: Option<&PinholeCamera>, name: &str) -> Result<Self, String> {
        let told = || camera_of(device.optics(Sensor::Color), "colour");
        let camera = camera.cloned().map_or_else(told, Ok)?;
        let registration = match device.registered() {
            Registered::Yes => None,
            Registered::Untold => {
                tracing::warn!(
                    source = name,
                    "it does not tell whether depth is registered to colour: it is taken as registered"
                );
                None
            }
            Registered::No => {
                tracing::warn!(
                    source = name,
                    "the device does not register depth to colour: it is registered here, by the usual 23 mm between the cameras"
                );
                let depth_camera = camera_of(device.optics(Sensor::Depth), "depth")?;
                Some(Registration { depth_camera, ..kinect::registration() })
            }
        };
        let (name, camera) = (name.to_owned(), Arc::new(camera));
        Ok(Self { name, camera, registration, is_mirroring_told: false })
    }

    /// Says once that pictures come mirrored and are turned back.
    fn tell_mirroring(&mut self, device: &Device) {
        let is_mirrored = [Sensor::Color, Sensor::Depth].iter().any(|s| device.is_mirrored(*s));
        if is_mirrored && !self.is_mirroring_told {
            self.is_mirroring_told = true;
            tracing::warn!(source = self.name, "its pictures are mirrored: they are turned back");
        }
    }

    fn assemble(&self, pair: Paired<sys::Picture, sys::Picture>) -> Result<RgbdFrame, String> {
        let (color, depth) = (pair.color, pair.depth);
        let text = |e: crate::FrameError| e.to_string();
        let color = ColorImage::new(color.width, color.height, color.bytes).map_err(text)?;
        let raw: Vec<u16> =
            depth.bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        let mut depth =
            DepthImage::from_raw(depth.width, depth.height, &raw, depth.units_per_metre)
                .map_err(text)?;
        if let Some(registration) = &self.registration {
            depth = registration.register(&depth, &self.camera);
        }
        RgbdFrame::new(pair.utime, Arc::clone(&self.camera), color, depth).map_err(text)
    }
}

/// Intrinsics from the field of view, which is all that OpenNI2 tells.
fn camera_of(optics: Optics, what: &str) -> Result<PinholeCamera, String> {
    let Optics { size: (width, height), field_of_view: [horizontal, vertical] } = optics;
    let focal = |pixels: usize, angle: f64| pixels as f64 / (2.0 * (angle / 2.0).tan());
    let camera = PinholeCamera {
        width,
        height,
        fx: focal(width, horizontal),
        fy: focal(height, vertical),
        cx: (width as f64 - 1.0) / 2.0,
        cy: (height as f64 - 1.0) / 2.0,
        depth_units_per_metre: 1000.0,
        distortion: [0.0; 8],
        depth_sensor: DepthSensor::default(),
    };
    camera.check().map_err(|e| {
        format!(
            "its {what} of {width}x{height} pixels, {horizontal} by {vertical} rad, cannot be: {e}; give the camera with --camera"
        )
    })?;
    Ok(camera)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stream_that_lags_behind_is_read_and_none_beyond_its_last_picture() {
        let picture = |number, utime| sys::Picture {
            utime,
            number,
            width: 0,
            height: 0,
            bytes: Vec::new(),
            units_per_metre: 1000.0,
        };
        let mut played = Played::default();
        assert_eq!(played.lagging([2, 2]), Some(Sensor::Color));
        played.pass(Sensor::Color, &picture(1, 40));
        assert_eq!(played.lagging([2, 2]), Some(Sensor::Depth));
        assert_eq!(played.lagging([2, 0]), Some(Sensor::Color));
        // Playback passed over the first one.
        played.pass(Sensor::Depth, &picture(2, 80));
        assert_eq!(played.lagging([2, 2]), Some(Sensor::Color));
        played.pass(Sensor::Color, &picture(2, 80));
        assert_eq!(played.lagging([2, 2]), None);
    }

    #[test]
    fn what_a_device_tells_of_its_lens_must_be_a_camera() {
        let kinect = Optics { size: (640, 480), field_of_view: [1.0947, 0.8579] };
        assert!((camera_of(kinect, "colour").unwrap().fx - 525.0).abs() < 2.0);
        for (size, field_of_view) in [
            ((640, 480), [0.0, 0.0]),
            ((640, 480), [1.0947, f64::NAN]),
            ((640, 480), [62.7, 49.2]),
            ((0, 480), [1.0947, 0.8579]),
            ((100_000, 100_000), [1.0947, 0.8579]),
        ] {
            let error = camera_of(Optics { size, field_of_view }, "depth").unwrap_err();
            assert!(error.contains("--camera") && error.contains("depth"), "{error}");
        }
    }
}
