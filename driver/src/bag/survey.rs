//! What a bag says about its cameras, before its pictures are read.
//!
//! The cameras' messages may stand anywhere in a bag: it is read from its beginning until all that
//! is asked for was seen, most often for some frames.

use super::message_format::MessageFormat;
use super::messages::{CameraInfo, Header};
use super::reader::{BagMessage, BagReader, Topic};
use super::topics::{ChosenTopics, PictureTopic, PictureType};
use super::transforms::{FrameTree, parse_transform};
use super::wire::{WireError, WireFormat, WireReader};
use crate::error::SourceError;
use nalgebra::Isometry3;

/// Most messages that are looked at.
const MAX_MESSAGES: usize = 20_000;
/// Messages that are looked at when all but the transforms was seen.
const ENOUGH_MESSAGES: usize = 500;

/// Types of messages of transforms.
const TRANSFORMS: [&str; 4] =
    ["tf2_msgs/TFMessage", "tf/tfMessage", "foxglove.FrameTransforms", "foxglove.FrameTransform"];

/// What was found.
#[derive(Debug, Default)]
pub struct Survey {
    /// The colour pictures' frame of coordinates.
    pub color_frame: Option<String>,
    /// The depth pictures'.
    pub depth_frame: Option<String>,
    /// The camera of colour.
    pub color_camera: Option<CameraInfo>,
    /// The camera of depth.
    pub depth_camera: Option<CameraInfo>,
    /// Metres of a unit of depth, where the bag says so.
    pub depth_unit_m: Option<f64>,
    /// True where depth comes as metres in floating point.
    pub is_depth_metric: bool,
    /// Frames that stand fixed to each other.
    pub frames: FrameTree,
    /// RealSense's `color_from_reference` and `depth_from_reference`.
    from_reference: [Option<Isometry3<f64>>; 2],
}

impl Survey {
    /// Maps the depth camera's coordinates into the colour camera's frame, where that is known.
    pub fn color_from_depth(&self) -> Option<Isometry3<f64>> {
        if let [Some(color), Some(depth)] = self.from_reference {
            return Some(color * depth.inverse());
        }
        self.frames.between(self.color_frame.as_deref()?, self.depth_frame.as_deref()?)
    }
}

/// Topics beside those of pictures and cameras that are looked at.
struct Extras {
    transforms: Vec<usize>,
    depth_unit: Option<usize>,
    /// RealSense's transforms of colour and of depth.
    from_reference: [Option<usize>; 2],
}

impl Extras {
    fn of(topics: &[Topic], chosen: &ChosenTopics) -> Self {
        let place = |fits: &dyn Fn(&Topic) -> bool| topics.iter().position(fits);
        // `/device_0/sensor_0/Depth_0/image/data` has `/device_0/sensor_0/Depth_0/tf/0`.
        let stream = |t: usize| topics[t].name.strip_suffix("/image/data").map(str::to_owned);
        let reference = |pictures: &PictureTopic| {
            let beginning = format!("{}/tf/", stream(pictures.pictures)?);
            place(&|t| {
                t.name.starts_with(&beginning) && t.message_type == "geometry_msgs/Transform"
            })
        };
        let sensor = stream(chosen.depth.pictures)
            .and_then(|s| s.rsplit_once('/').map(|(sensor, _)| sensor.to_owned()));
        let transforms = topics
            .iter()
            .enumerate()
            .filter(|(_, t)| t.name == "/tf_static" && TRANSFORMS.contains(&&*t.message_type));
        Self {
            transforms: transforms.map(|(i, _)| i).collect(),
            depth_unit: sensor
                .and_then(|s| place(&|t| t.name == format!("{s}/option/Depth_Units/value"))),
            from_reference: [reference(&chosen.color), reference(&chosen.depth)],
        }
    }
}

/// Reads a bag as far as needed.
///
/// # Errors
/// Those of the reader. Messages that cannot be read are passed over.
pub fn survey(
    reader: &mut dyn BagReader,
    chosen: &ChosenTopics,
    has_camera: bool,
) -> Result<Survey, SourceError> {
    let topics = reader.topics().to_vec();
    let extras = Extras::of(&topics, chosen);
    let mut asked: Vec<usize> = [Some(chosen.color.pictures), Some(chosen.depth.pictures)]
        .into_iter()
        .chain([chosen.color.camera, chosen.depth.camera, extras.depth_unit])
        .chain(extras.from_reference)
        .flatten()
        .chain(extras.transforms.iter().copied())
        .collect();
    asked.sort_unstable();
    asked.dedup();
    reader.select(&asked)?;
    let mut found = Survey::default();
    let mut unseen = asked;
    // With a camera that was given, none of the bag's is waited for.
    if has_camera {
        unseen.retain(|t| Some(*t) != chosen.color.camera);
    }
    for count in 0..MAX_MESSAGES {
        if unseen.is_empty() || count > ENOUGH_MESSAGES && is_enough(&unseen, chosen) {
            break;
        }
        let Some(message) = reader.next_message()? else { break };
        match found.take(&message, &topics[message.topic], chosen, &extras) {
            Ok(()) => unseen.retain(|t| *t != message.topic),
            Err(e) => tracing::debug!(topic = topics[message.topic].name, "{e}"),
        }
    }
    Ok(found)
}

/// Pictures of both kinds and their cameras were seen.
fn is_enough(unseen: &[usize], chosen: &ChosenTopics) -> bool {
    let needed = [Some(chosen.color.pictures), Some(chosen.depth.pictures), chosen.color.camera];
    !needed.iter().flatten().any(|t| unseen.contains(t))
}

impl Survey {
    fn take(
        &mut self,
        message: &BagMessage,
        Topic { format, message_type, .. }: &Topic,
        chosen: &ChosenTopics,
        extras: &Extras,
    ) -> Result<(), WireError> {
        let Some(format) = *format else { return Ok(()) };
        let (topic, bytes) = (message.topic, message.bytes.as_slice());
        if topic == chosen.color.pictures {
            let header = picture_header(bytes, format, chosen.color.picture_type)?.0;
            self.color_frame.get_or_insert_with(|| header.frame.to_owned());
        }
        if topic == chosen.depth.pictures {
            let (header, encoding) = picture_header(bytes, format, chosen.depth.picture_type)?;
            self.is_depth_metric = encoding.trim_start().to_ascii_uppercase().starts_with("32FC1");
            self.depth_frame.get_or_insert_with(|| header.frame.to_owned());
        }
        for (camera, place) in [
            (chosen.color.camera, &mut self.color_camera),
            (chosen.depth.camera, &mut self.depth_camera),
        ] {
            if camera == Some(topic) && place.is_none() {
                *place = Some(format.camera_info(bytes)?);
            }
        }
        if extras.transforms.contains(&topic) {
            self.frames.add(format.transforms(bytes, message_type)?);
        }
        match format {
            MessageFormat::Ros(format) => self.take_of_realsense(topic, bytes, format, extras),
            MessageFormat::Foxglove | MessageFormat::FoxgloveRos(_) => Ok(()),
        }
    }

    /// What RealSense's own recordings hold beside.
    fn take_of_realsense(
        &mut self,
        topic: usize,
        bytes: &[u8],
        format: WireFormat,
        extras: &Extras,
    ) -> Result<(), WireError> {
        if extras.depth_unit == Some(topic) {
            let unit = WireReader::new(bytes, format)?.f32("depth unit")?;
            self.depth_unit_m = Some(f64::from(unit));
        }
        for (reference, place) in extras.from_reference.iter().zip(&mut self.from_reference) {
            if *reference == Some(topic) {
                *place = Some(parse_transform(bytes, format)?);
            }
        }
        Ok(())
    }
}

/// A picture's header, and what its pixels are.
fn picture_header(
    bytes: &[u8],
    format: MessageFormat,
    picture_type: PictureType,
) -> Result<(Header<'_>, &str), WireError> {
    match picture_type {
        PictureType::Image => format.image(bytes).map(|i| (i.header, i.encoding)),
        PictureType::Compressed => format.compressed_image(bytes).map(|i| (i.header, i.format)),
    }
}
