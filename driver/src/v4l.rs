//! A colour and a depth device of V4L2 side by side (RealSense, Astra).
//!
//! Depth must come registered to colour, at one size: V4L2 tells nothing of lenses, so the camera
//! is given (`--camera`), or Kinect defaults with depth in millimetres, which the first frames must
//! confirm.

use crate::error::SourceError;
use crate::jpeg;
use crate::live::{Camera, CameraFault, Paired, Pairing};
use crate::yuv::yuv_to_rgb;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{ScaleCheck, ScaleIssue};
use linkage_frames::frame::{ColorImage, DepthImage, RgbdFrame};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;
use v4l::buffer::Type;
use v4l::io::mmap::Stream;
use v4l::io::traits::CaptureStream;
use v4l::video::Capture;
use v4l::{Device, Format, FourCC};

/// Largest difference of time within a pair: two devices run freely, so half a period.
const MAX_PAIR_GAP_US: i64 = 17_000;
/// Buffers that a driver fills in turn.
const BUFFERS: u32 = 4;
/// Pictures of both devices that wait; more are dropped.
const WAITING: usize = 8;
/// Longest wait of a device's thread before it looks whether it is to stop.
const POLL: Duration = Duration::from_millis(100);

/// Formats that are understood, best first.
const COLOR_FORMATS: [&[u8; 4]; 3] = [b"RGB3", b"YUYV", b"MJPG"];
const DEPTH_FORMATS: [&[u8; 4]; 2] = [b"Z16 ", b"Y16 "];

/// Names of the capture devices of this machine: path and what the driver calls it.
pub fn list_devices() -> Vec<(String, String)> {
    v4l::context::enum_devices()
        .into_iter()
        .map(|node| (node.path().display().to_string(), node.name().unwrap_or_default()))
        .collect()
}

/// A picture as the driver gave it.
struct Picture {
    is_depth: bool,
    utime: i64,
    bytes: Vec<u8>,
}

/// How a device lays out its pictures.
struct Layout {
    format: FourCC,
    /// Bytes from one line to the next.
    stride: usize,
}

/// Two open devices, each with a thread that waits for it.
pub struct V4lCamera {
    camera: Arc<PinholeCamera>,
    /// Looks whether the first frames' depth fits the camera's units.
    scale: ScaleCheck,
    color: Layout,
    depth: Layout,
    pictures: Receiver<Result<Picture, String>>,
    pairing: Pairing<Vec<u8>, Vec<u8>>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl V4lCamera {
    /// Opens both devices at the size of a camera that is given, or else of the one assumed.
    ///
    /// # Errors
    /// [`SourceError::Device`] names the device and what it offers or lacks.
    pub fn open(
        color: &str,
        depth: &str,
        camera: Arc<PinholeCamera>,
        is_assumed: bool,
    ) -> Result<Self, SourceError> {
        camera.check().map_err(|e| SourceError::Device {
            name: format!("v4l:{color},{depth}"),
            reason: e.to_string(),
        })?;
        let (sender, pictures) = sync_channel(WAITING);
        let stop = Arc::new(AtomicBool::new(false));
        let (color_device, color) = negotiate(color, &COLOR_FORMATS, &camera)?;
        let (depth_device, depth) = negotiate(depth, &DEPTH_FORMATS, &camera)?;
        let threads = [(color_device, false), (depth_device, true)]
            .map(|(device, is_depth)| {
                let (sender, stop) = (sender.clone(), Arc::clone(&stop));
                std::thread::spawn(move || stream(&device, is_depth, &sender, &stop))
            })
            .into();
        let pairing = Pairing::new(MAX_PAIR_GAP_US);
        let scale = ScaleCheck::new(camera.depth_units_per_metre, is_assumed);
        Ok(Self { camera, scale, color, depth, pictures, pairing, stop, threads })
    }

    fn frame_of(&mut self, pair: Paired<Vec<u8>, Vec<u8>>) -> Result<RgbdFrame, CameraFault> {
        let frame = self.assemble(pair).map_err(CameraFault::Damaged)?;
        match self.scale.look(&frame.depth) {
            Some(ScaleIssue::Wrong(reason)) => return Err(CameraFault::Unusable(reason)),
            Some(ScaleIssue::Odd(reason)) => tracing::warn!("{reason}"),
            None => {}
        }
        Ok(frame)
    }

    fn assemble(&self, pair: Paired<Vec<u8>, Vec<u8>>) -> Result<RgbdFrame, String> {
        let (width, height) = (self.camera.width, self.camera.height);
        let color = decode_color(pair.color, &self.color, width, height)?;
        let depth = packed(pair.depth, self.depth.stride, 2 * width);
        let raw: Vec<u16> =
            depth.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        let depth = DepthImage::from_raw(width, height, &raw, self.camera.depth_units_per_metre)
            .map_err(|e| e.to_string())?;
        RgbdFrame::new(pair.utime, Arc::clone(&self.camera), color, depth)
            .map_err(|e| e.to_string())
    }
}

impl Camera for V4lCamera {
    fn next_frame(&mut self, timeout: Duration) -> Result<Option<RgbdFrame>, CameraFault> {
        loop {
            let picture = match self.pictures.recv_timeout(timeout) {
                Ok(picture) => picture.map_err(CameraFault::Lost)?,
                Err(RecvTimeoutError::Timeout) => return Ok(None),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(CameraFault::Lost("both devices are gone".to_owned()));
                }
            };
            let pair = if picture.is_depth {
                self.pairing.depth(picture.utime, picture.bytes)
            } else {
                self.pairing.color(picture.utime, picture.bytes)
            };
            if let Some(pair) = pair {
                return self.frame_of(pair).map(Some);
            }
        }
    }

    fn pairing(&self) -> (u64, i64) {
        self.pairing.losses()
    }
}

impl Drop for V4lCamera {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                tracing::warn!("a V4L2 device did not stop cleanly");
            }
        }
    }
}

/// Opens a device and sets the best format that it and we know.
fn negotiate(
    path: &str,
    wanted: &[&[u8; 4]],
    camera: &PinholeCamera,
) -> Result<(Device, Layout), SourceError> {
    let failed = |reason: String| SourceError::Device { name: format!("v4l:{path}"), reason };
    let device = Device::with_path(Path::new(path)).map_err(|e| {
        failed(match e.kind() {
            io::ErrorKind::NotFound => {
                format!("no such device; there are {}", names(&list_devices()))
            }
            io::ErrorKind::PermissionDenied => {
                format!("{e}: add yourself to the group video, or set a udev rule")
            }
            _ => e.to_string(),
        })
    })?;
    let offered: Vec<FourCC> = device
        .enum_formats()
        .map_err(|e| failed(format!("it captures nothing: {e}")))?
        .into_iter()
        .map(|f| f.fourcc)
        .collect();
    let fourcc = wanted
        .iter()
        .map(|w| FourCC::new(w))
        .find(|w| offered.iter().any(|o| same_format(o, w)))
        .ok_or_else(|| {
            let list = |all: &[FourCC]| {
                all.iter().map(|f| f.to_string().trim().to_owned()).collect::<Vec<_>>().join(", ")
            };
            let understood: Vec<FourCC> = wanted.iter().map(|w| FourCC::new(w)).collect();
            failed(format!("it offers {}; understood is {}", list(&offered), list(&understood)))
        })?;
    let set = device
        .set_format(&Format::new(camera.width as u32, camera.height as u32, fourcc))
        .map_err(|e| failed(format!("format {fourcc} is refused: {e}")))?;
    if (set.width as usize, set.height as usize) != (camera.width, camera.height) {
        return Err(failed(format!(
            "it gives {}x{} where the camera is {}x{}; describe it with --camera",
            set.width, set.height, camera.width, camera.height
        )));
    }
    Ok((device, Layout { format: set.fourcc, stride: set.stride as usize }))
}

fn same_format(a: &FourCC, b: &FourCC) -> bool {
    a.repr == b.repr
}

fn names(devices: &[(String, String)]) -> String {
    if devices.is_empty() {
        return "none".to_owned();
    }
    devices.iter().map(|(path, name)| format!("{path} ({name})")).collect::<Vec<_>>().join(", ")
}

/// Sends a device's pictures until told to stop or it fails.
fn stream(
    device: &Device,
    is_depth: bool,
    sender: &SyncSender<Result<Picture, String>>,
    stop: &AtomicBool,
) {
    let mut stream = match Stream::with_buffers(device, Type::VideoCapture, BUFFERS) {
        Ok(stream) => stream,
        Err(e) => return drop(sender.send(Err(format!("streaming does not start: {e}")))),
    };
    stream.set_timeout(POLL);
    while !stop.load(Ordering::Relaxed) {
        let picture = match stream.next() {
            Ok((bytes, meta)) => Picture {
                is_depth,
                utime: meta
                    .timestamp
                    .sec
                    .saturating_mul(1_000_000)
                    .saturating_add(meta.timestamp.usec),
                bytes: bytes[..(meta.bytesused as usize).min(bytes.len())].to_vec(),
            },
            Err(e) if e.kind() == io::ErrorKind::TimedOut => continue,
            Err(e) => return drop(sender.try_send(Err(format!("capture failed: {e}")))),
        };
        if let Err(TrySendError::Disconnected(_)) = sender.try_send(Ok(picture)) {
            return;
        }
    }
}

fn decode_color(
    bytes: Vec<u8>,
    layout: &Layout,
    width: usize,
    height: usize,
) -> Result<ColorImage, String> {
    match &layout.format.repr {
        b"MJPG" => jpeg::decode_motion(&bytes, (width, height)).map_err(|e| e.to_string()),
        b"YUYV" => {
            let bytes = packed(bytes, layout.stride, 2 * width);
            let rgb = bytes.chunks_exact(4).flat_map(|p| {
                let [first, second] = [p[0], p[2]].map(|y| yuv_to_rgb(y, p[1], p[3]));
                [first[0], first[1], first[2], second[0], second[1], second[2]]
            });
            ColorImage::new(width, height, rgb.collect()).map_err(|e| e.to_string())
        }
        _ => {
            let bytes = packed(bytes, layout.stride, 3 * width);
            ColorImage::new(width, height, bytes).map_err(|e| e.to_string())
        }
    }
}

/// Lines without what pads them.
fn packed(bytes: Vec<u8>, stride: usize, line: usize) -> Vec<u8> {
    if stride <= line {
        return bytes;
    }
    bytes.chunks(stride).flat_map(|padded| &padded[..line.min(padded.len())]).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_picture_is_an_error() {
        let layout = Layout { format: FourCC::new(b"YUYV"), stride: 8 };
        let error = decode_color(vec![0; 10], &layout, 4, 2).unwrap_err();
        assert!(error.contains("4x2"), "{error}");
    }
}
