//! The layout of the TUM RGB-D benchmark.

use super::recorder::{LineFile, RecordError, Recorder, new_folder, write_camera, write_whole};
use crate::{image_file, jpeg};
use linkage_frames::frame::RgbdFrame;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Quality of JPEG pictures: artefacts below the noise of a cheap camera.
const JPEG_QUALITY: u8 = 95;

/// Writes pictures and their lists.
pub struct TumRecorder {
    dir: PathBuf,
    color_ending: &'static str,
    lists: Option<[LineFile; 2]>,
}

impl TumRecorder {
    /// Starts a recording in a new folder; colour as `png` or `jpg`.
    ///
    /// # Errors
    /// [`RecordError`] when the folder is not empty or cannot be made.
    pub fn create(dir: &Path, color_ending: &'static str) -> Result<Self, RecordError> {
        new_folder(dir)?;
        for part in ["rgb", "depth"] {
            let path = dir.join(part);
            std::fs::create_dir_all(&path).map_err(|e| RecordError::new(&path, e))?;
        }
        Ok(Self { dir: dir.to_owned(), color_ending, lists: None })
    }

    /// The lists; with the first frame, whose camera is written beside them.
    fn lists(&mut self, frame: &RgbdFrame) -> Result<&mut [LineFile; 2], RecordError> {
        if self.lists.is_none() {
            write_camera(&self.dir, &frame.camera)?;
            let mut lists = [
                LineFile::create(self.dir.join("rgb.txt"))?,
                LineFile::create(self.dir.join("depth.txt"))?,
            ];
            for list in &mut lists {
                list.append("# timestamp filename")?;
            }
            self.lists = Some(lists);
        }
        Ok(self.lists.as_mut().expect("made above"))
    }

    fn write_pictures(
        &self,
        frame: &RgbdFrame,
        color: &str,
        depth: &str,
    ) -> Result<(), RecordError> {
        let path = self.dir.join(color);
        if self.color_ending == "jpg" {
            let bytes =
                jpeg::encode(&frame.color, JPEG_QUALITY).map_err(|e| RecordError::new(&path, e))?;
            write_whole(&path, |file| file.write_all(&bytes))?;
        } else {
            let written = image_file::write_color(&path, &frame.color);
            take_back_on_failure(&path, written)?;
        }
        let path = self.dir.join(depth);
        let raw = frame.depth.to_raw(frame.camera.depth_units_per_metre);
        let written =
            image_file::write_depth(&path, frame.depth.width(), frame.depth.height(), &raw);
        take_back_on_failure(&path, written)
    }
}

fn take_back_on_failure(
    path: &Path,
    written: Result<(), image_file::ImageFileError>,
) -> Result<(), RecordError> {
    written.map_err(|e| {
        let _ = std::fs::remove_file(path);
        RecordError::new(path, e)
    })
}

impl Recorder for TumRecorder {
    fn write(&mut self, frame: &RgbdFrame) -> Result<(), RecordError> {
        let stamp = format!(
            "{}.{:06}",
            frame.utime.div_euclid(1_000_000),
            frame.utime.rem_euclid(1_000_000)
        );
        let color = format!("rgb/{stamp}.{}", self.color_ending);
        let depth = format!("depth/{stamp}.png");
        self.lists(frame)?;
        self.write_pictures(frame, &color, &depth)?;
        // Depth first: a reader asks which depth picture belongs to a colour picture.
        let [colors, depths] = self.lists(frame)?;
        depths.append(&format!("{stamp} {depth}"))?;
        colors.append(&format!("{stamp} {color}"))
    }

    fn finish(&mut self) -> Result<(), RecordError> {
        self.lists.iter().flatten().try_for_each(LineFile::sync)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rgbd_source::RgbdSource;
    use crate::tum::TumRecording;
    use linkage_frames::camera::PinholeCamera;
    use linkage_frames::frame::{ColorImage, DepthImage};
    use std::sync::Arc;

    fn frame(utime: i64, grey: u8) -> RgbdFrame {
        let (width, height) = (64, 48);
        let camera = PinholeCamera { width, height, cx: 31.5, cy: 23.5, ..PinholeCamera::kinect() };
        let color = ColorImage::new(width, height, vec![grey; width * height * 3]).unwrap();
        let metres = (0..width * height).map(|i| if i % 7 == 0 { f32::NAN } else { 1.25 });
        let depth = DepthImage::from_metres(width, height, metres.collect()).unwrap();
        RgbdFrame::new(utime, Arc::new(camera), color, depth).unwrap()
    }

    /// What is read again of some frames that were recorded.
    fn read_again(frames: &[RgbdFrame], ending: &'static str) -> Vec<RgbdFrame> {
        let dir = tempfile::tempdir().unwrap();
        let mut recorder = TumRecorder::create(dir.path(), ending).unwrap();
        frames.iter().for_each(|frame| recorder.write(frame).unwrap());
        recorder.finish().unwrap();
        let mut recording = TumRecording::open(dir.path()).unwrap();
        std::iter::from_fn(|| recording.next_frame().unwrap()).collect()
    }

    #[test]
    fn what_was_recorded_comes_back_with_its_time_camera_colour_and_depth() {
        let frames = [frame(1_700_000_000_000_007, 50), frame(1_700_000_000_040_000, 90)];
        let read = read_again(&frames, "png");
        assert_eq!(read.len(), 2);
        for (read, written) in read.iter().zip(&frames) {
            assert_eq!((read.utime, &read.camera), (written.utime, &written.camera));
            assert_eq!(read.color, written.color);
            for (a, b) in read.depth.as_metres().iter().zip(written.depth.as_metres()) {
                assert!((a.is_nan() && b.is_nan()) || (a - b).abs() < 1e-3, "{a} for {b}");
            }
        }
    }

    #[test]
    fn jpeg_pictures_are_nearly_what_they_were() {
        let read = read_again(&[frame(5_000_000, 120)], "jpg");
        assert!(read[0].color.luma_at(20, 20).unwrap().abs_diff(120) < 3);
    }

    #[test]
    fn a_recording_without_frames_has_no_lists() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("empty");
        TumRecorder::create(&path, "png").unwrap().finish().unwrap();
        assert!(!path.join("rgb.txt").exists());
    }

    #[test]
    fn another_recording_is_not_written_into_a_folder_that_has_one() {
        let dir = tempfile::tempdir().unwrap();
        TumRecorder::create(dir.path(), "png").unwrap().write(&frame(1, 9)).unwrap();
        assert!(TumRecorder::create(dir.path(), "png").is_err());
    }
}
