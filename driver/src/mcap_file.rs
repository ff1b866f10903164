//! MCAP files: the container of ROS 2's bags and of Foxglove, with the messages of either.
//!
//! Read from beginning to end, so that a file that was cut short is read as far as it goes; memory
//! is that of the largest message.

use crate::bag::foxglove_json;
use crate::bag::message_format::MessageFormat;
use crate::bag::reader::{BagMessage, BagReader, MAX_MESSAGE_BYTES, MAX_TOPICS, Topic};
use crate::bag::wire::WireFormat;
use crate::error::SourceError;
use linkage_frames::text_table;
use mcap::sans_io::{LinearReaderOptions, SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{Channel, McapError};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

/// Largest record of a file, bytes: a message with its header, or an index of chunks.
const MAX_RECORD_BYTES: usize = MAX_MESSAGE_BYTES + 1024;

/// The encoding of messages in JSON, which are handed on in protobuf.
const JSON: &str = "json";

/// An opened file.
pub struct McapReader {
    path: PathBuf,
    topics: Vec<Topic>,
    /// Places of topics by their names.
    places: BTreeMap<String, usize>,
    selected: Vec<bool>,
    messages: mcap::io::MessageReader<BufReader<File>>,
    has_ended: bool,
}

impl McapReader {
    /// Opens a file and lists its topics: from its summary, or where a recording was cut short
    /// from its messages.
    ///
    /// # Errors
    /// [`SourceError::Recording`] when it cannot be read or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let broken = |reason: String| broken(path, reason);
        let mut file = text_table::regular_file(path).map_err(|e| broken(e.to_string()))?;
        let topics = match topics_of_summary(&mut file) {
            Ok(topics) if !topics.is_empty() => topics,
            _ => {
                let mut file = text_table::regular_file(path).map_err(|e| broken(e.to_string()))?;
                topics_of_messages(&mut file).map_err(|e| broken(told(&e)))?
            }
        };
        let places = topics.iter().enumerate().map(|(i, t)| (t.name.clone(), i)).collect();
        let file = text_table::regular_file(path).map_err(|e| broken(e.to_string()))?;
        let (selected, messages) = (vec![true; topics.len()], message_reader(file));
        let path = path.to_owned();
        Ok(Self { path, topics, places, selected, messages, has_ended: false })
    }
}

impl BagReader for McapReader {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn select(&mut self, topics: &[usize]) -> Result<(), SourceError> {
        self.selected = (0..self.topics.len()).map(|t| topics.contains(&t)).collect();
        Ok(())
    }

    fn next_message(&mut self) -> Result<Option<BagMessage>, SourceError> {
        while !self.has_ended {
            let message = match self.messages.next() {
                Some(Ok(message)) => message,
                Some(Err(e)) if is_cut(&e) => {
                    let file = self.path.display();
                    tracing::warn!(%file, "the file ends too early; what came before is read");
                    self.has_ended = true;
                    break;
                }
                Some(Err(e)) => return Err(broken(&self.path, told(&e))),
                None => {
                    self.has_ended = true;
                    break;
                }
            };
            let Some(&topic) = self.places.get(&message.channel.topic) else { continue };
            if !self.selected[topic] {
                continue;
            }
            let log_utime = i64::try_from(message.log_time / 1000).unwrap_or(i64::MAX);
            let is_json = message.channel.message_encoding == JSON;
            let bytes = match is_json {
                false => Ok(message.data.into_owned()),
                true => foxglove_json::in_protobuf(&self.topics[topic].message_type, &message.data),
            };
            match bytes {
                Ok(bytes) => return Ok(Some(BagMessage { topic, log_utime, bytes })),
                Err(reason) => {
                    let topic = &self.topics[topic].name;
                    tracing::warn!(topic, "a message is passed over: {reason}");
                }
            }
        }
        Ok(None)
    }
}

fn broken(path: &Path, reason: String) -> SourceError {
    SourceError::Recording { path: path.display().to_string(), reason }
}

/// An error in our own words where the library's text does not help.
fn told(error: &McapError) -> String {
    match error {
        McapError::BadMagic => "is no MCAP file".to_owned(),
        other => format!("damaged MCAP file: {other}"),
    }
}

fn is_cut(error: &McapError) -> bool {
    matches!(error, McapError::UnexpectedEof | McapError::UnexpectedEoc)
}

fn message_reader(file: File) -> mcap::io::MessageReader<BufReader<File>> {
    let options = LinearReaderOptions::default().with_record_length_limit(MAX_RECORD_BYTES);
    mcap::io::MessageReader::new_with_options(BufReader::with_capacity(1 << 16, file), options)
}

fn topics_of_summary(file: &mut File) -> Result<Vec<Topic>, McapError> {
    let size = file.metadata()?.len();
    let options = SummaryReaderOptions::default()
        .with_file_size(size)
        .with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(count) => {
                let read = file.read(reader.insert(count))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    let channels = reader.finish().map(|summary| summary.channels).unwrap_or_default();
    let mut channels: Vec<_> = channels.into_iter().collect();
    channels.sort_by_key(|(id, _)| *id);
    Ok(distinct(channels.iter().map(|(_, channel)| topic_of(channel))))
}

fn topics_of_messages(file: &mut File) -> Result<Vec<Topic>, McapError> {
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    for message in message_reader(file.try_clone()?) {
        match message {
            Ok(message) if !topics.contains_key(&message.channel.topic) => {
                topics.insert(message.channel.topic.clone(), topic_of(&message.channel));
            }
            Ok(_) => {}
            // What came before the end is read.
            Err(e) if is_cut(&e) && !topics.is_empty() => break,
            Err(e) => return Err(e),
        }
        if topics.len() >= MAX_TOPICS {
            break;
        }
    }
    Ok(topics.into_values().collect())
}

/// Topics by their names; a topic may have several channels.
fn distinct(topics: impl Iterator<Item = Topic>) -> Vec<Topic> {
    let mut seen = std::collections::BTreeSet::new();
    topics.filter(|t| seen.insert(t.name.clone())).take(MAX_TOPICS).collect()
}

fn topic_of(channel: &Channel<'_>) -> Topic {
    let schema = channel.schema.as_ref().map_or("", |schema| &*schema.name);
    let format = match channel.message_encoding.as_str() {
        "cdr" => Some(MessageFormat::Ros(WireFormat::Cdr)),
        "ros1" => Some(MessageFormat::Ros(WireFormat::Ros1)),
        "protobuf" | JSON if schema.starts_with("foxglove.") => Some(MessageFormat::Foxglove),
        _ => None,
    };
    Topic::new(&channel.topic, schema, format)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::foxglove::tests::timestamp;
    use crate::bag::protobuf_writer::{bytes, doubles, fixed32};
    use crate::bag::{BagOptions, BagRecording};
    use crate::image_file;
    use crate::rgbd_source::RgbdSource;
    use base64::Engine;
    use linkage_frames::frame::RgbdFrame;
    use mcap::Writer;
    use mcap::records::MessageHeader;

    /// Columns and rows.
    const SIZE: (usize, usize) = (8, 6);
    const START: i64 = 1_700_000_000_000_000;

    /// Colour and depth of a frame, no two pixels of which are the same.
    fn pixels(frame: usize) -> (Vec<u8>, Vec<u16>) {
        let count = SIZE.0 * SIZE.1;
        let color = (0..3 * count).map(|i| (i + 60 * frame) as u8).collect();
        (color, (0..count).map(|i| (500 + 11 * i + frame) as u16).collect())
    }

    /// Message type, topic, and a message.
    type Message = (&'static str, &'static str, Vec<u8>);

    /// A picture without compression.
    fn raw(utime: i64, encoding: &str, pixel_bytes: usize, data: &[u8]) -> Vec<u8> {
        let side = |n: usize| u32::try_from(n).unwrap();
        [
            timestamp(utime),
            fixed32(2, side(SIZE.0)),
            fixed32(3, side(SIZE.1)),
            bytes(4, encoding.as_bytes()),
            fixed32(5, side(SIZE.0 * pixel_bytes)),
            bytes(6, data),
            bytes(7, b"camera"),
        ]
        .concat()
    }

    /// A frame as Foxglove's messages.
    fn messages(frame: usize, is_compressed: bool) -> [Message; 3] {
        let utime = START + 33_333 * frame as i64;
        let (color, depth) = pixels(frame);
        let k = [30.0, 0.0, 3.5, 0.0, 31.0, 2.5, 0.0, 0.0, 1.0];
        let (width, height) = (fixed32(2, 8), fixed32(3, 6));
        let (model, d) = (bytes(4, b"plumb_bob"), doubles(5, &[0.1, 0.0, 0.0, 0.0, 0.0]));
        let camera = [timestamp(utime), width, height, model, d, doubles(6, &k)].concat();
        let camera = ("foxglove.CameraCalibration", "/camera/calibration", camera);
        if is_compressed {
            let png = |data: Vec<u8>| {
                [timestamp(utime), bytes(2, &data), bytes(3, b"png"), bytes(4, b"camera")].concat()
            };
            let (kind, rgb) = ("foxglove.CompressedImage", encode_color(&color));
            let depth = image_file::encode_png_depth(SIZE.0, SIZE.1, &depth).unwrap();
            return [
                (kind, "/camera/color", png(rgb)),
                (kind, "/camera/depth", png(depth)),
                camera,
            ];
        }
        let millimetres: Vec<u8> = depth.iter().flat_map(|mm| mm.to_le_bytes()).collect();
        let kind = "foxglove.RawImage";
        let color = (kind, "/camera/color", raw(utime, "rgb8", 3, &color));
        [color, (kind, "/camera/depth", raw(utime, "16UC1", 2, &millimetres)), camera]
    }

    fn encode_color(rgb: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, SIZE.0 as u32, SIZE.1 as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(rgb).unwrap();
        out
    }

    fn write(path: &Path, messages: &[Message]) {
        write_as("protobuf", path, messages);
    }

    /// Writes a file; messages are logged a minute after they were made.
    fn write_as(encoding: &str, path: &Path, messages: &[Message]) {
        let mut writer = Writer::new(File::create(path).unwrap()).unwrap();
        for (kind, topic, data) in messages {
            let schema = writer.add_schema(kind, encoding, b"").unwrap();
            let id = writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap();
            let log_time = (START as u64 + 60_000_000) * 1000;
            let header =
                MessageHeader { channel_id: id, sequence: 0, log_time, publish_time: log_time };
            writer.write_to_known_channel(&header, data).unwrap();
        }
        writer.finish().unwrap();
    }

    fn read(path: &Path) -> Result<Vec<RgbdFrame>, SourceError> {
        let opener = || McapReader::open(path).map(|r| Box::new(r) as _);
        let mut source = BagRecording::open("mcap:test", &opener, &BagOptions::default())?;
        std::iter::from_fn(|| source.next_frame().transpose()).collect()
    }

    #[test]
    fn foxgloves_pictures_come_back_to_the_pixel_at_the_time_that_they_bear() {
        for is_compressed in [false, true] {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("a.mcap");
            let written: Vec<_> = (0..4).flat_map(|i| messages(i, is_compressed)).collect();
            write(&path, &written);
            let frames = read(&path).unwrap();
            assert_eq!(frames.len(), 4, "compressed: {is_compressed}");
            for (i, frame) in frames.iter().enumerate() {
                let (color, depth) = pixels(i);
                assert_eq!(frame.utime, START + 33_333 * i as i64);
                assert_eq!(frame.color.as_rgb(), color);
                assert_eq!(frame.depth.to_raw(1000.0), depth);
                let camera = &frame.camera;
                assert_eq!([camera.fx, camera.fy, camera.cx, camera.cy], [30.0, 31.0, 3.5, 2.5]);
                assert_eq!(camera.distortion[..2], [0.1, 0.0]);
            }
        }
    }

    /// A frame as Foxglove's messages in JSON.
    fn messages_in_json(frame: usize) -> [Message; 3] {
        let us = START + 33_333 * frame as i64;
        let stamp = serde_json::json!({ "sec": us / 1_000_000, "nsec": us % 1_000_000 * 1000 });
        let raw = |encoding: &str, step: usize, data: &[u8]| {
            let data = base64::engine::general_purpose::STANDARD.encode(data);
            serde_json::json!({ "timestamp": stamp, "frame_id": "camera", "width": SIZE.0,
                "height": SIZE.1, "encoding": encoding, "step": step, "data": data })
        };
        let (color, depth) = pixels(frame);
        let millimetres: Vec<u8> = depth.iter().flat_map(|mm| mm.to_le_bytes()).collect();
        let camera = serde_json::json!({ "timestamp": stamp, "frame_id": "camera", "width": SIZE.0,
            "height": SIZE.1, "distortion_model": "plumb_bob", "D": [0.1, 0.0, 0.0, 0.0, 0.0],
            "K": [30.0, 0.0, 3.5, 0.0, 31.0, 2.5, 0.0, 0.0, 1.0], "R": [], "P": [] });
        let (picture, calibration) = ("foxglove.RawImage", "foxglove.CameraCalibration");
        [
            (picture, "/camera/color", raw("rgb8", 3 * SIZE.0, &color).to_string().into_bytes()),
            (
                picture,
                "/camera/depth",
                raw("16UC1", 2 * SIZE.0, &millimetres).to_string().into_bytes(),
            ),
            (calibration, "/camera/calibration", camera.to_string().into_bytes()),
        ]
    }

    #[test]
    fn foxgloves_pictures_in_json_are_read_and_a_damaged_one_is_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let mut written: Vec<_> = (0..4).flat_map(messages_in_json).collect();
        written[6].2.truncate(40);
        write_as("json", &path, &written);
        let frames = read(&path).unwrap();
        assert_eq!(frames.len(), 3);
        for (frame, i) in frames.iter().zip([0, 1, 3]) {
            let (color, depth) = pixels(i);
            assert_eq!(frame.utime, START + 33_333 * i as i64);
            assert_eq!(frame.color.as_rgb(), color);
            assert_eq!(frame.depth.to_raw(1000.0), depth);
            assert_eq!((frame.camera.fx, frame.camera.distortion[0]), (30.0, 0.1));
        }
    }

    #[test]
    fn an_encoding_that_is_not_read_is_told_with_its_topic() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let [_, depth, camera] = messages(0, false);
        let (utime, data) = (START, [0; 8 * 6 * 3 / 2]);
        let color = ("foxglove.RawImage", "/camera/color", raw(utime, "nv12", 1, &data));
        write(&path, &[color, depth, camera]);
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("/camera/color: ") && error.contains("\"nv12\""), "{error}");
    }
}
