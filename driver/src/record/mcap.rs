//! An MCAP file of ROS 2 messages, which Foxglove, `ros2 bag` and any MCAP library read.
//!
//! Colour is JPEG; depth is not compressed by itself but with the file's chunks, so that nothing is
//! lost: `16UC1` where it is in millimetres, which is what ROS means by that, else `32FC1` in metres.
//! Each frame is a chunk, so that a recording that is cut short holds all frames before.

use super::recorder::{RecordError, Recorder};
use super::ros2_messages::{
    RawPicture, Stamp, camera_info, camera_info_definition, compressed_image,
    compressed_image_definition, image, image_definition,
};
use crate::jpeg;
use linkage_frames::frame::RgbdFrame;
use mcap::records::MessageHeader;
use mcap::{McapResult, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// Quality of JPEG pictures: artefacts below the noise of a cheap camera.
const JPEG_QUALITY: u8 = 95;
/// Units in a metre of ROS's depth in 16 bits.
const MILLIMETRES: f64 = 1000.0;
/// The frame of coordinates of both pictures.
const FRAME: &str = "camera_color_optical_frame";
/// Topics, in the names that RealSense's driver made common.
const COLOR_TOPIC: &str = "/camera/color/image_raw/compressed";
const COLOR_CAMERA_TOPIC: &str = "/camera/color/camera_info";
const DEPTH_TOPIC: &str = "/camera/aligned_depth_to_color/image_raw";
const DEPTH_CAMERA_TOPIC: &str = "/camera/aligned_depth_to_color/camera_info";

/// Writes a file.
pub struct McapRecorder {
    path: PathBuf,
    /// `None` once writing has failed.
    writer: Option<Writer<BufWriter<File>>>,
    channels: Channels,
    sequence: u32,
    /// Bytes of all whole frames.
    whole_bytes: u64,
}

/// Numbers of the topics in the file.
struct Channels {
    color: u16,
    color_camera: u16,
    depth: u16,
    depth_camera: u16,
}

impl McapRecorder {
    /// Starts a new file.
    ///
    /// # Errors
    /// [`RecordError`] when the file is there already or cannot be made.
    pub fn create(path: &Path) -> Result<Self, RecordError> {
        if path.exists() {
            return Err(RecordError::new(path, "is there already; record into a new file"));
        }
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|e| RecordError::new(folder, e))?;
        }
        let file = File::create(path).map_err(|e| RecordError::new(path, e))?;
        let begin = || {
            let options = WriteOptions::new().profile("ros2").library("linkage");
            let mut writer = options.create(BufWriter::new(file))?;
            let channels = Channels::add(&mut writer)?;
            writer.flush()?;
            Ok((writer, channels))
        };
        let (writer, channels) = begin().map_err(|e: mcap::McapError| RecordError::new(path, e))?;
        let path = path.to_owned();
        let mut recorder =
            Self { path, writer: Some(writer), channels, sequence: 0, whole_bytes: 0 };
        recorder.whole_bytes = recorder.file_bytes();
        Ok(recorder)
    }

    fn file_bytes(&self) -> u64 {
        std::fs::metadata(&self.path).map_or(self.whole_bytes, |m| m.len())
    }

    /// Removes the incomplete frame from the file, and stops writing.
    fn give_up(&mut self, reason: impl ToString) -> RecordError {
        if let Some(writer) = self.writer.take() {
            // Dropping it would write again.
            std::mem::forget(writer);
            let file = OpenOptions::new().write(true).open(&self.path);
            let _ = file.and_then(|file| file.set_len(self.whole_bytes));
        }
        RecordError::new(&self.path, reason)
    }

    fn write_messages(&mut self, frame: &RgbdFrame, jpeg: &[u8]) -> McapResult<()> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        let stamp = Stamp { utime: frame.utime, frame: FRAME };
        let log_time = u64::try_from(frame.utime).unwrap_or_default().saturating_mul(1000);
        let camera = camera_info(stamp, &frame.camera);
        let channels = &self.channels;
        for (channel_id, data) in [
            (channels.color_camera, &camera),
            (channels.color, &compressed_image(stamp, "jpeg", jpeg)),
            (channels.depth_camera, &camera),
            (channels.depth, &depth_message(frame, stamp)),
        ] {
            let sequence = self.sequence;
            let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
            writer.write_to_known_channel(&header, data)?;
        }
        self.sequence = self.sequence.wrapping_add(1);
        writer.flush()
    }
}

impl Channels {
    fn add(writer: &mut Writer<BufWriter<File>>) -> McapResult<Self> {
        let mut schema = |name: &str, text: String| {
            writer.add_schema(&format!("sensor_msgs/msg/{name}"), "ros2msg", text.as_bytes())
        };
        let compressed = schema("CompressedImage", compressed_image_definition())?;
        let image = schema("Image", image_definition())?;
        let camera = schema("CameraInfo", camera_info_definition())?;
        let mut channel =
            |topic, schema| writer.add_channel(schema, topic, "cdr", &BTreeMap::new());
        Ok(Self {
            color: channel(COLOR_TOPIC, compressed)?,
            color_camera: channel(COLOR_CAMERA_TOPIC, camera)?,
            depth: channel(DEPTH_TOPIC, image)?,
            depth_camera: channel(DEPTH_CAMERA_TOPIC, camera)?,
        })
    }
}

fn depth_message(frame: &RgbdFrame, stamp: Stamp<'_>) -> Vec<u8> {
    let (width, height) = (frame.depth.width(), frame.depth.height());
    if frame.camera.depth_units_per_metre == MILLIMETRES {
        let raw = frame.depth.to_raw(MILLIMETRES);
        let data: Vec<u8> = raw.iter().flat_map(|mm| mm.to_le_bytes()).collect();
        return image(stamp, &RawPicture { width, height, encoding: "16UC1", data: &data });
    }
    let data: Vec<u8> = frame.depth.as_metres().iter().flat_map(|z| z.to_le_bytes()).collect();
    image(stamp, &RawPicture { width, height, encoding: "32FC1", data: &data })
}

impl Recorder for McapRecorder {
    fn write(&mut self, frame: &RgbdFrame) -> Result<(), RecordError> {
        if self.writer.is_none() {
            return Err(RecordError::new(&self.path, "writing has failed before"));
        }
        let jpeg = jpeg::encode(&frame.color, JPEG_QUALITY)
            .map_err(|e| RecordError::new(&self.path, e))?;
        if let Err(e) = self.write_messages(frame, &jpeg) {
            return Err(self.give_up(e));
        }
        self.whole_bytes = self.file_bytes();
        Ok(())
    }

    fn finish(&mut self) -> Result<(), RecordError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        match writer.finish() {
            Ok(_) => Ok(()),
            Err(e) => Err(self.give_up(e)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::{BagOptions, BagRecording};
    use crate::mcap_file::McapReader;
    use crate::rgbd_source::RgbdSource;
    use linkage_frames::camera::PinholeCamera;
    use linkage_frames::frame::{ColorImage, DepthImage};
    use std::sync::Arc;

    const START: i64 = 1_700_000_000_000_000;

    fn camera(units: f64) -> PinholeCamera {
        PinholeCamera {
            width: 32,
            height: 24,
            fx: 30.0,
            fy: 30.0,
            cx: 15.5,
            cy: 11.5,
            depth_units_per_metre: units,
            ..PinholeCamera::kinect()
        }
    }

    fn frames(units: f64) -> Vec<RgbdFrame> {
        let camera = Arc::new(camera(units));
        let frame = |i: usize| {
            let color = ColorImage::new(32, 24, vec![(40 * i) as u8; 32 * 24 * 3]).unwrap();
            let raw: Vec<u16> = (0..32 * 24).map(|k| (1000 + 7 * k + i) as u16).collect();
            let depth = DepthImage::from_raw(32, 24, &raw, units).unwrap();
            RgbdFrame::new(START + 33_333 * i as i64, Arc::clone(&camera), color, depth).unwrap()
        };
        (0..5).map(frame).collect()
    }

    fn write(path: &Path, frames: &[RgbdFrame]) {
        let mut recorder = McapRecorder::create(path).unwrap();
        frames.iter().for_each(|frame| recorder.write(frame).unwrap());
        recorder.finish().unwrap();
    }

    fn read(path: &Path) -> Vec<RgbdFrame> {
        let opener = || McapReader::open(path).map(|r| Box::new(r) as _);
        let mut source = BagRecording::open("mcap:test", &opener, &BagOptions::default()).unwrap();
        let frames: Vec<_> = std::iter::from_fn(|| source.next_frame().unwrap()).collect();
        assert_eq!(source.statistics().lost(), 0);
        frames
    }

    #[test]
    fn depth_comes_back_as_it_was_in_millimetres_and_in_finer_units() {
        for units in [1000.0, 5000.0] {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("a.mcap");
            let written = frames(units);
            write(&path, &written);
            let read = read(&path);
            assert_eq!(read.len(), written.len());
            for (a, b) in written.iter().zip(&read) {
                assert_eq!((a.utime, &a.camera), (b.utime, &b.camera));
                assert_eq!(a.depth.to_raw(units), b.depth.to_raw(units));
                let near = |(a, b): (&u8, &u8)| a.abs_diff(*b) <= 2;
                assert!(a.color.as_rgb().iter().zip(b.color.as_rgb()).all(near));
            }
        }
    }

    #[test]
    fn a_recording_that_is_cut_short_is_read_up_to_there() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let written = frames(1000.0);
        let mut recorder = McapRecorder::create(&path).unwrap();
        written[..3].iter().for_each(|frame| recorder.write(frame).unwrap());
        // The recorder is never finished, as in a crash.
        std::mem::forget(recorder);
        assert_eq!(read(&path).len(), 3);
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 40]).unwrap();
        assert!(read(&path).len() >= 2);
    }

    #[test]
    fn bytes_that_are_no_mcap_file_are_errors() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        write(&path, &frames(1000.0));
        let whole = std::fs::read(&path).unwrap();
        for at in (0..whole.len()).step_by(whole.len() / 300) {
            let mut damaged = whole.clone();
            for byte in &mut damaged[at..(at + 9).min(whole.len())] {
                *byte ^= 0xa5;
            }
            std::fs::write(&path, &damaged).unwrap();
            let opener = || McapReader::open(&path).map(|r| Box::new(r) as _);
            let opened = BagRecording::open("mcap:test", &opener, &BagOptions::default());
            let Ok(mut source) = opened else { continue };
            while let Ok(Some(_)) = source.next_frame() {}
        }
        std::fs::write(&path, b"not a recording").unwrap();
        let error = McapReader::open(&path).err().unwrap().to_string();
        assert!(error.contains("a.mcap") && error.contains("no MCAP file"), "{error}");
    }
}
