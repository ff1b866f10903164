//! Frames from bags: files that hold the messages of topics, whatever their container. Messages are
//! those of ROS, or Foxglove's own ([`message_format`]).
//!
//! A container is a [`reader::BagReader`]. Topics are chosen by their types and names
//! ([`topics`]), the cameras are looked for ([`survey`]), then colour and depth are paired by time
//! ([`pairing`]) and decoded ([`assembly`]) on a thread of their own, some frames ahead.

pub mod assembly;
pub mod camera_info;
pub mod foxglove;
pub mod foxglove_json;
pub mod foxglove_ros;
pub mod message_format;
pub mod messages;
pub mod pairing;
pub mod picture;
pub mod protobuf;
pub mod protobuf_writer;
pub mod reader;
pub mod survey;
pub mod topics;
pub mod transforms;
pub mod wire;

use crate::error::SourceError;
use crate::rgbd_source::RgbdSource;
use crate::statistics::SourceStatistics;
use crate::timestamp_filter::{Timeline, TimestampFilter};
use crate::tum::DEFAULT_MAX_PAIR_GAP_US;
use assembly::Assembly;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{ScaleCheck, ScaleIssue};
use linkage_frames::frame::RgbdFrame;
use pairing::{NearestPairing, Pair, Stamped};
use reader::{BagMessage, BagReader};
use std::sync::mpsc;
use topics::ChosenTopics;

/// Frames decoded ahead of the reader.
const READ_AHEAD: usize = 3;

/// Opens a container at its beginning; asked twice.
pub type Opener<'o> = &'o dyn Fn() -> Result<Box<dyn BagReader>, SourceError>;

/// What is asked of a bag.
#[derive(Debug, Clone, Default)]
pub struct BagOptions {
    /// The camera, where it is given; else the bag's.
    pub camera: Option<PinholeCamera>,
    /// Names of the topics of colour and depth, each may be empty; else they are looked for.
    pub topics: Option<(String, String)>,
}

/// An opened bag.
pub struct BagRecording {
    name: String,
    statistics: SourceStatistics,
    scale: ScaleCheck,
    frames: mpsc::Receiver<Result<Decoded, SourceError>>,
}

/// What the decoding thread hands over: a frame, or `None` at the end, and what was lost so far.
type Decoded = (Option<RgbdFrame>, SourceStatistics);

impl BagRecording {
    /// Chooses topics, looks for the cameras, and begins to read.
    ///
    /// # Errors
    /// [`SourceError::Recording`] says what is missing, and what to do.
    pub fn open(name: &str, opener: Opener<'_>, options: &BagOptions) -> Result<Self, SourceError> {
        let broken = |reason: String| SourceError::Recording { path: name.to_owned(), reason };
        let mut reader = opener()?;
        let wanted = options.topics.as_ref().map(|(color, depth)| (&**color, &**depth));
        let chosen = topics::choose(reader.topics(), wanted).map_err(broken)?;
        let found = survey::survey(&mut *reader, &chosen, options.camera.is_some())?;
        let given = options.camera.as_ref();
        let assembly =
            Assembly::new(name, reader.topics(), &chosen, &found, given).map_err(broken)?;
        let topic = |t: usize| &*reader.topics()[t].name;
        let (color, depth) = (topic(chosen.color.pictures), topic(chosen.depth.pictures));
        tracing::info!(source = name, color, depth, "topics");
        let mut reader = opener()?;
        reader.select(&[chosen.color.pictures, chosen.depth.pictures])?;
        let scale = ScaleCheck::new(assembly.camera().depth_units_per_metre, false);
        let (sender, frames) = mpsc::sync_channel(READ_AHEAD);
        let mut decoder = Decoder::new(name, reader, chosen, assembly);
        std::thread::spawn(move || {
            loop {
                let decoded = decoder.next();
                let ends = !matches!(decoded, Ok((Some(_), _)));
                if sender.send(decoded).is_err() || ends {
                    return;
                }
            }
        });
        let statistics = SourceStatistics::default();
        Ok(Self { name: name.to_owned(), statistics, scale, frames })
    }
}

impl RgbdSource for BagRecording {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        let Ok(decoded) = self.frames.recv() else { return Ok(None) };
        let (frame, statistics) = decoded?;
        self.statistics = SourceStatistics { delivered: self.statistics.delivered, ..statistics };
        if let Some(frame) = &frame {
            self.statistics.delivered += 1;
            self.statistics.invalid_depth = frame.depth.invalid_share();
            match self.scale.look(&frame.depth) {
                Some(ScaleIssue::Wrong(reason) | ScaleIssue::Odd(reason)) => {
                    tracing::warn!(source = self.name, "{reason}");
                }
                None => {}
            }
        }
        Ok(frame)
    }

    fn frame_count(&self) -> Option<usize> {
        None
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn statistics(&self) -> SourceStatistics {
        self.statistics
    }
}

/// Reads, pairs and decodes.
struct Decoder {
    name: String,
    reader: Box<dyn BagReader>,
    chosen: ChosenTopics,
    assembly: Assembly,
    pairing: NearestPairing,
    timestamps: TimestampFilter,
    damaged: u64,
    last_damage: Option<String>,
    delivered: u64,
    is_read: bool,
}

impl Decoder {
    fn new(
        name: &str,
        reader: Box<dyn BagReader>,
        chosen: ChosenTopics,
        assembly: Assembly,
    ) -> Self {
        Self {
            name: name.to_owned(),
            reader,
            chosen,
            assembly,
            pairing: NearestPairing::new(DEFAULT_MAX_PAIR_GAP_US),
            timestamps: TimestampFilter::new(Timeline::Continuous),
            damaged: 0,
            last_damage: None,
            delivered: 0,
            is_read: false,
        }
    }

    /// The next frame; messages that are damaged are passed over and counted.
    fn next(&mut self) -> Result<Decoded, SourceError> {
        loop {
            while let Some(pair) = self.pairing.next_pair(self.is_read) {
                if let Some(frame) = self.frame(&pair) {
                    self.delivered += 1;
                    return Ok((Some(frame), self.statistics()));
                }
            }
            if self.is_read {
                self.finish()?;
                return Ok((None, self.statistics()));
            }
            match self.reader.next_message()? {
                Some(message) => self.take(message),
                None => self.is_read = true,
            }
        }
    }

    fn take(&mut self, BagMessage { topic, log_utime, bytes }: BagMessage) {
        type Push = fn(&mut NearestPairing, Stamped);
        let (stamped, push): (_, Push) = if topic == self.chosen.color.pictures {
            (self.assembly.stamped_color(bytes, log_utime), NearestPairing::push_color)
        } else {
            (self.assembly.stamped_depth(bytes, log_utime), NearestPairing::push_depth)
        };
        match stamped {
            Ok(stamped) => push(&mut self.pairing, stamped),
            Err(e) => self.note_damage(e),
        }
    }

    fn frame(&mut self, pair: &Pair) -> Option<RgbdFrame> {
        match self.assembly.frame(pair) {
            Ok(frame) => self.timestamps.pass(frame, pair.color.log_utime),
            Err(e) => {
                self.note_damage(e);
                None
            }
        }
    }

    fn note_damage(&mut self, reason: String) {
        self.damaged += 1;
        self.last_damage = Some(reason);
    }

    fn statistics(&self) -> SourceStatistics {
        SourceStatistics {
            damaged: self.damaged,
            unpaired: self.pairing.unpaired,
            largest_pair_gap_us: self.pairing.largest_gap_us,
            ..self.timestamps.statistics
        }
    }

    /// At the end: an error when there was no frame at all, a warning when some were lost.
    fn finish(&self) -> Result<(), SourceError> {
        let SourceStatistics { damaged, unpaired, out_of_order, .. } = self.statistics();
        if self.delivered > 0 {
            if damaged + unpaired + out_of_order > 0 {
                let source = &self.name;
                let last = self.last_damage.as_deref().unwrap_or_default();
                tracing::warn!(source, damaged, unpaired, out_of_order, last, "frames lost");
            }
            return Ok(());
        }
        let reason = match (&self.last_damage, self.pairing.least_missed_us) {
            (Some(damage), _) => {
                format!("none of its pictures can be read ({damaged} tried), the last: {damage}")
            }
            (None, Some(gap_us)) => format!(
                "no colour picture has a depth picture within {} ms, the nearest is {} ms away; compare the time stamps of both topics",
                DEFAULT_MAX_PAIR_GAP_US / 1000,
                gap_us / 1000
            ),
            (None, None) => {
                "no picture of colour has one of depth: does the bag hold messages of both topics?"
                    .to_owned()
            }
        };
        Err(SourceError::Recording { path: self.name.clone(), reason })
    }
}
