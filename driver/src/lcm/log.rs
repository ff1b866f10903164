//! Frames recorded in an LCM event log.

use super::message::decode_frame;
use crate::error::SourceError;
use crate::rgbd_source::RgbdSource;
use crate::statistics::SourceStatistics;
use crate::timestamp_filter::{Timeline, TimestampFilter};
use linkage_frames::camera::PinholeCamera;
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
