//! A dump that fakenect plays to programs that use libfreenect: colour, and depth as the
//! sensor's disparities of 11 bits. Depth is registered, which `camera.toml` in the dump says.

use super::recorder::{LineFile, RecordError, Recorder, new_folder, write_camera, write_whole};
use crate::kinect;
use linkage_frames::frame::RgbdFrame;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Counts of the device's clock in a microsecond.
const TICKS_PER_US: i64 = 60;
/// The size that libfreenect knows.
const SIZE: (usize, usize) = (640, 480);

/// Writes pictures and the index that names them.
pub struct FakenectRecorder {
    dir: PathBuf,
    index: Option<LineFile>,
}

impl FakenectRecorder {
    /// Starts a dump in a new folder.
    ///
    /// # Errors
    /// [`RecordError`] when the folder is not empty or cannot be made.
    pub fn create(dir: &Path) -> Result<Self, RecordError> {
        new_folder(dir)?;
        Ok(Self { dir: dir.to_owned(), index: None })
    }

    fn start(&mut self, frame: &RgbdFrame) -> Result<(), RecordError> {
        let size = (frame.color.width(), frame.color.height());
        if size != SIZE {
            return Err(RecordError::new(
                &self.dir,
                format!("a Kinect's pictures are 640x480, not {}x{}", size.0, size.1),
            ));
        }
        write_camera(&self.dir, &frame.camera)?;
        self.index = Some(LineFile::create(self.dir.join("INDEX.txt"))?);
        Ok(())
    }

    fn append(&mut self, name: &str, header: &str, pixels: &[u8]) -> Result<(), RecordError> {
        write_whole(&self.dir.join(name), |file| {
            file.write_all(header.as_bytes())?;
            file.write_all(pixels)
        })?;
        self.index.as_mut().expect("started with the first frame").append(name)
    }
}

impl Recorder for FakenectRecorder {
    fn write(&mut self, frame: &RgbdFrame) -> Result<(), RecordError> {
        if self.index.is_none() {
            self.start(frame)?;
        }
        let ticks = (frame.utime * TICKS_PER_US) as u32;
        let seconds = frame.utime as f64 * 1e-6;
        let disparities: Vec<u8> = frame
            .depth
            .as_metres()
            .iter()
            .flat_map(|&z| kinect::disparity_of(z).to_le_bytes())
            .collect();
        self.append(&format!("d-{seconds:.6}-{ticks}.pgm"), "P5 640 480 65535\n", &disparities)?;
        self.append(
            &format!("r-{seconds:.6}-{ticks}.ppm"),
            "P6 640 480 255\n",
            frame.color.as_rgb(),
        )
    }

    fn finish(&mut self) -> Result<(), RecordError> {
        self.index.iter().try_for_each(LineFile::sync)
    }
}
