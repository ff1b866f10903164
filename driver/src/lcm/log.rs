//! Frames recorded in an LCM event log.

use super::message::{LCM_UNITS_PER_METRE, decode_frame};
use crate::error::SourceError;
use crate::rgbd_source::RgbdSource;
use crate::statistics::SourceStatistics;
use crate::timestamp_filter::{Timeline, TimestampFilter};
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{ScaleCheck, ScaleIssue};
use linkage_frames::frame::RgbdFrame;
use linkage_frames::text_table;
use linkage_lcm::LogReader;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

/// An event log whose frames are read one after the other, at times that go on even where the
/// log holds several recordings. Damaged frames are passed over and counted.
pub struct LogRecording {
    name: String,
    reader: LogReader<File>,
    channel: String,
    camera: Arc<PinholeCamera>,
    /// Checks whether the first frames' depth fits the camera.
    scale: ScaleCheck,
    timestamps: TimestampFilter,
    delivered: u64,
    other_channels: BTreeMap<String, u64>,
    last_damage: Option<String>,
    ended: bool,
}

impl LogRecording {
    /// Opens a log.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when the file cannot be read.
    pub fn open(
        path: &Path,
        channel: &str,
        camera: Arc<PinholeCamera>,
    ) -> Result<Self, SourceError> {
        let file = text_table::regular_file(path).map_err(|e| SourceError::Recording {
            path: path.display().to_string(),
            reason: e.to_string(),
        })?;
        let reader = LogReader::new(file);
        Ok(Self {
            name: format!("lcmlog:{}", path.display()),
            reader,
            channel: channel.to_owned(),
            scale: ScaleCheck::new(LCM_UNITS_PER_METRE, false),
            camera,
            timestamps: TimestampFilter::new(Timeline::Continuous),
            delivered: 0,
            other_channels: BTreeMap::new(),
            last_damage: None,
            ended: false,
        })
    }

    fn broken(&self, reason: String) -> SourceError {
        SourceError::Recording { path: self.name.clone(), reason }
    }

    /// At the end: an error when there was no frame at all, a warning when some were lost.
    fn finish(&mut self) -> Result<(), SourceError> {
        let statistics = self.statistics();
        if self.delivered == 0 {
            let why = match &self.last_damage {
                Some(damage) => {
                    let damaged = self.timestamps.statistics.damaged;
                    format!("all {damaged} frames are damaged, the last: {damage}")
                }
                None if self.other_channels.is_empty() => "no event: is it an LCM log?".to_owned(),
                None => format!(
                    "no event on channel {}; there are {}",
                    self.channel,
                    self.other_channels.keys().cloned().collect::<Vec<_>>().join(", ")
                ),
            };
            return Err(self.broken(why));
        }
        let skipped_bytes = self.reader.skipped_bytes();
        let SourceStatistics { damaged, out_of_order, restamped, reconnections, .. } = statistics;
        if !self.ended && statistics.lost() > 0 {
            tracing::warn!(log = self.name, damaged, out_of_order, skipped_bytes, "frames lost");
        }
        if !self.ended && restamped + reconnections > 0 {
            let begins_again = reconnections;
            tracing::warn!(log = self.name, restamped, begins_again, "time stamps do not go on");
        }
        Ok(())
    }
}

impl RgbdSource for LogRecording {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        loop {
            let event = self.reader.next_event().map_err(|e| self.broken(e.to_string()))?;
            let Some(event) = event else {
                self.finish()?;
                self.ended = true;
                return Ok(None);
            };
            if event.channel != self.channel {
                *self.other_channels.entry(event.channel).or_default() += 1;
                continue;
            }
            match decode_frame(&event.bytes, &self.camera) {
                Ok(frame) => {
                    if let Some(frame) = self.timestamps.pass(frame, event.utime) {
                        let issue = self.scale.look(&frame.depth);
                        if let Some(ScaleIssue::Wrong(what) | ScaleIssue::Odd(what)) = issue {
                            tracing::warn!(
                                log = self.name,
                                "{what} (depth in LCM messages is in millimetres)"
                            );
                        }
                        self.delivered += 1;
                        return Ok(Some(frame));
                    }
                }
                Err(e) => {
                    self.timestamps.statistics.damaged += 1;
                    self.last_damage = Some(e.to_string());
                }
            }
        }
    }

    fn frame_count(&self) -> Option<usize> {
        None
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn statistics(&self) -> SourceStatistics {
        let counted = self.timestamps.statistics;
        SourceStatistics {
            delivered: self.delivered,
            damaged: counted.damaged + self.reader.damaged_stretches(),
            ..counted
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::message::{Packing, encode_frame};
    use super::*;
    use linkage_frames::frame::{ColorImage, DepthImage};
    use linkage_lcm::{LogWriter, encode};

    const FRAMES: &str = "FRAMES";

    fn camera() -> Arc<PinholeCamera> {
        Arc::new(PinholeCamera { width: 8, height: 6, ..PinholeCamera::kinect() })
    }

    fn message(utime: i64) -> Vec<u8> {
        let color = ColorImage::new(8, 6, vec![90; 8 * 6 * 3]).unwrap();
        let depth = DepthImage::from_metres(8, 6, vec![1.5; 48]).unwrap();
        let frame = RgbdFrame::new(utime, camera(), color, depth).unwrap();
        encode(&encode_frame(&frame, Packing::LOSSLESS).unwrap()).unwrap()
    }

    /// A log of some events, each on a channel, opened to read frames of one of them.
    fn opened(events: &[(&str, Vec<u8>)]) -> (tempfile::TempDir, LogRecording) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("door.log");
        let mut log = LogWriter::create(&path).unwrap();
        for (utime, (channel, bytes)) in (1..).zip(events) {
            log.write(40_000 * utime, channel, bytes).unwrap();
        }
        log.flush().unwrap();
        drop(log);
        let recording = LogRecording::open(&path, FRAMES, camera()).unwrap();
        (dir, recording)
    }

    fn damaged() -> Vec<u8> {
        message(1)[..40].to_vec()
    }

    #[test]
    fn frames_come_in_their_order_and_other_channels_are_passed_over() {
        let events = [
            (FRAMES, message(100_000)),
            ("OTHER", b"anything".to_vec()),
            (FRAMES, message(140_000)),
        ];
        let (_dir, mut recording) = opened(&events);
        let times: Vec<i64> =
            std::iter::from_fn(|| recording.next_frame().unwrap()).map(|f| f.utime).collect();
        assert_eq!(times, [100_000, 140_000]);
        assert_eq!(recording.statistics().delivered, 2);
        assert!(recording.next_frame().unwrap().is_none(), "the end stays the end");
    }

    #[test]
    fn damaged_frames_are_counted_and_the_others_are_read() {
        let events = [(FRAMES, message(100_000)), (FRAMES, damaged()), (FRAMES, message(180_000))];
        let (_dir, mut recording) = opened(&events);
        assert_eq!(std::iter::from_fn(|| recording.next_frame().unwrap()).count(), 2);
        let counted = recording.statistics();
        assert_eq!((counted.delivered, counted.damaged), (2, 1));
    }

    #[test]
    fn a_log_without_a_frame_says_why_there_is_none() {
        let said =
            |events: &[(&str, Vec<u8>)]| opened(events).1.next_frame().unwrap_err().to_string();
        let elsewhere = said(&[("A", vec![1]), ("B", vec![2]), ("A", vec![3])]);
        assert!(elsewhere.contains("there are A, B"), "{elsewhere}");
        assert!(said(&[]).contains("is it an LCM log?"));
        let broken = said(&[(FRAMES, damaged()), (FRAMES, damaged())]);
        assert!(broken.contains("all 2 frames are damaged"), "{broken}");
    }

    #[test]
    fn what_is_no_file_is_refused_by_its_path() {
        let dir = tempfile::tempdir().unwrap();
        for path in [dir.path().to_owned(), dir.path().join("no.log")] {
            let error = LogRecording::open(&path, FRAMES, camera()).err();
            let said = error.expect("it is refused").to_string();
            assert!(said.contains(&path.display().to_string()), "{said}");
        }
    }
}
