//! An LCM event log of `kinect.frame_msg_t`, which lcm-logplayer plays.

use super::recorder::{RecordError, Recorder, write_whole};
use crate::lcm::{DEFAULT_CHANNEL, Packing, encode_frame};
use linkage_frames::frame::RgbdFrame;
use linkage_lcm::{LogWriter, encode};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a log, and `<name>.camera.toml` beside it, which messages do not tell.
pub struct LogRecorder {
    path: PathBuf,
    log: LogWriter<BufWriter<File>>,
    has_camera: bool,
}

impl LogRecorder {
    /// Starts a log in a new file.
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
        let log = LogWriter::create(path).map_err(|e| RecordError::new(path, e))?;
        Ok(Self { path: path.to_owned(), log, has_camera: false })
    }

    fn write_camera(&mut self, frame: &RgbdFrame) -> Result<(), RecordError> {
        let path = self.path.with_extension("camera.toml");
        let text = toml::to_string(&*frame.camera).map_err(|e| RecordError::new(&path, e))?;
        write_whole(&path, |file| file.write_all(text.as_bytes()))?;
        self.has_camera = true;
        Ok(())
    }
}

impl Recorder for LogRecorder {
    fn write(&mut self, frame: &RgbdFrame) -> Result<(), RecordError> {
        if !self.has_camera {
            self.write_camera(frame)?;
        }
        let failed = |e: &dyn std::fmt::Display| RecordError::new(&self.path, e);
        let message = encode_frame(frame, Packing::LOSSLESS).map_err(|e| failed(&e))?;
        let bytes = encode(&message).map_err(|e| failed(&e))?;
        self.log.write(frame.utime, DEFAULT_CHANNEL, &bytes).map_err(|e| failed(&e))?;
        // A log that is cut inside an event is readable up to it.
        self.log.flush().map_err(|e| failed(&e))
    }

    fn finish(&mut self) -> Result<(), RecordError> {
        self.log.flush().map_err(|e| RecordError::new(&self.path, e))
    }
}
