//! What all recordings share: taking frames, and files that are written whole or not at all.

use linkage_frames::camera::PinholeCamera;
use linkage_frames::frame::RgbdFrame;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A recording that cannot go on. What was written before stays readable.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct RecordError {
    path: String,
    reason: String,
}

impl RecordError {
    pub(super) fn new(path: &Path, reason: impl ToString) -> Self {
        Self { path: path.display().to_string(), reason: reason.to_string() }
    }
}

/// Takes frames in order.
pub trait Recorder {
    /// Appends a frame, whole or not at all.
    ///
    /// # Errors
    /// [`RecordError`] names the file: a full disk, most often.
    fn write(&mut self, frame: &RgbdFrame) -> Result<(), RecordError>;

    /// Hands all to the disk.
    ///
    /// # Errors
    /// As [`Self::write`].
    fn finish(&mut self) -> Result<(), RecordError>;
}

/// Makes a folder that must not hold anything yet.
pub(super) fn new_folder(path: &Path) -> Result<(), RecordError> {
    let is_taken = path.is_dir()
        && std::fs::read_dir(path).map_err(|e| RecordError::new(path, e))?.next().is_some();
    if is_taken {
        return Err(RecordError::new(path, "is not empty; record into a new folder"));
    }
    std::fs::create_dir_all(path).map_err(|e| RecordError::new(path, e))
}

/// Writes a new file, whole or not at all.
pub(super) fn write_whole(
    path: &Path,
    content: impl FnOnce(&mut File) -> io::Result<()>,
) -> Result<(), RecordError> {
    let result = File::create(path).and_then(|mut file| content(&mut file));
    result.map_err(|e| {
        // The disk may be full: what there is of the file only takes room.
        let _ = std::fs::remove_file(path);
        RecordError::new(path, e)
    })
}

pub(super) fn write_camera(dir: &Path, camera: &PinholeCamera) -> Result<(), RecordError> {
    let path = dir.join("camera.toml");
    let text = toml::to_string(camera).map_err(|e| RecordError::new(&path, e))?;
    write_whole(&path, |file| file.write_all(text.as_bytes()))
}

/// A text file that grows by whole lines.
pub(super) struct LineFile {
    path: PathBuf,
    file: File,
    length: u64,
}

impl LineFile {
    pub(super) fn create(path: PathBuf) -> Result<Self, RecordError> {
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(true)
            .open(&path)
            .map_err(|e| RecordError::new(&path, e))?;
        Ok(Self { path, file, length: 0 })
    }

    pub(super) fn append(&mut self, line: &str) -> Result<(), RecordError> {
        let line = format!("{line}\n");
        self.file.write_all(line.as_bytes()).map_err(|e| {
            // Half a line would make the whole list unreadable.
            let _ = self.file.set_len(self.length);
            RecordError::new(&self.path, e)
        })?;
        self.length += line.len() as u64;
        Ok(())
    }

    pub(super) fn sync(&self) -> Result<(), RecordError> {
        self.file.sync_all().map_err(|e| RecordError::new(&self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_begins_in_a_folder_that_is_new_or_empty() {
        let dir = tempfile::tempdir().unwrap();
        let below = dir.path().join("a/b");
        assert!(new_folder(&below).is_ok() && below.is_dir());
        assert!(new_folder(&below).is_ok(), "it is empty");
        std::fs::write(below.join("rgb.txt"), "").unwrap();
        let error = new_folder(&below).unwrap_err().to_string();
        assert!(error.contains("a/b") && error.contains("is not empty"), "{error}");
        assert!(new_folder(&below.join("rgb.txt")).is_err(), "a file");
    }

    #[test]
    fn a_file_that_cannot_be_written_whole_is_taken_away() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("picture.png");
        let full = |file: &mut File| {
            file.write_all(b"half of it")?;
            Err(io::Error::other("no space left"))
        };
        let error = write_whole(&path, full).unwrap_err().to_string();
        assert!(error.contains("picture.png") && error.contains("no space left"), "{error}");
        assert!(!path.exists());
        write_whole(&path, |file| file.write_all(b"all of it")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"all of it");
    }

    #[test]
    fn a_list_grows_by_whole_lines() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rgb.txt");
        std::fs::write(&path, "what was there before").unwrap();
        let mut list = LineFile::create(path.clone()).unwrap();
        list.append("1.0 rgb/1.png").unwrap();
        list.append("2.0 rgb/2.png").unwrap();
        list.sync().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "1.0 rgb/1.png\n2.0 rgb/2.png\n");
        assert_eq!(list.length, text.len() as u64);
    }

    #[test]
    fn a_line_for_which_there_is_no_room_leaves_the_list_as_it_was() {
        let full = Path::new("/dev/full");
        if !full.exists() {
            println!("ignored: this system has no /dev/full");
            return;
        }
        let mut list = LineFile::create(full.to_owned()).unwrap();
        let error = list.append("1.0 rgb/1.png").unwrap_err().to_string();
        assert!(error.starts_with("/dev/full: "), "{error}");
        assert_eq!(list.length, 0);
    }

    #[test]
    fn a_camera_comes_back_as_it_was_written() {
        let dir = tempfile::tempdir().unwrap();
        let camera = PinholeCamera { fx: 512.25, cx: 311.5, ..PinholeCamera::kinect() };
        write_camera(dir.path(), &camera).unwrap();
        let read = crate::read_camera_file(&dir.path().join("camera.toml")).unwrap();
        assert_eq!(read, camera);
    }
}
