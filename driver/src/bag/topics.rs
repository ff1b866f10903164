//! Which topics of a bag hold colour, depth, and their cameras.
//!
//! Types say what is a picture, names what it shows: drivers agree on `rgb` or `color` and on
//! `depth`. A camera lies beside its pictures: its topic has the longest common path with theirs.

use super::message_format::MessageFormat;
use super::reader::Topic;

/// How a topic holds pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureType {
    /// `sensor_msgs/Image`, `foxglove.RawImage`.
    Image,
    /// `sensor_msgs/CompressedImage`, `foxglove.CompressedImage`.
    Compressed,
}

/// A topic of pictures, by its place among the topics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureTopic {
    /// The topic of the pictures.
    pub pictures: usize,
    /// How it holds them.
    pub picture_type: PictureType,
    /// The topic of their camera.
    pub camera: Option<usize>,
}

/// The topics that frames are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChosenTopics {
    /// Colour.
    pub color: PictureTopic,
    /// Depth.
    pub depth: PictureTopic,
}

/// Parts of names by which a topic shows colour.
const COLOR_WORDS: [&str; 3] = ["rgb", "color", "colour"];
/// Parts of names of pictures that are neither colour nor depth.
const OTHER_WORDS: [&str; 9] =
    ["infra", "/ir/", "/ir_", "confidence", "mask", "disparity", "theora", "colorized", "fisheye"];
/// Parts of names by which depth is registered to colour.
const REGISTERED_WORDS: [&str; 4] = ["aligned", "registered", "to_color", "to_rgb"];

/// True where the topic's name says that depth is registered to colour.
pub fn is_registered(name: &str) -> bool {
    contains_any(name, &REGISTERED_WORDS)
}

/// True where the topic's name says that pictures are rectified: `image_rect`,
/// `image_rect_color`.
pub fn is_rectified(name: &str) -> bool {
    name.to_ascii_lowercase().contains("rect")
}

/// Chooses colour and depth; `wanted` are the names that the user gives, each may be empty.
///
/// # Errors
/// What is not there, and what is.
pub fn choose(topics: &[Topic], wanted: Option<(&str, &str)>) -> Result<ChosenTopics, String> {
    let (wanted_color, wanted_depth) = wanted.unwrap_or_default();
    let colors = candidates(topics, wanted_color, color_score)?;
    let depths = candidates(topics, wanted_depth, depth_score)?;
    let pairs = colors.iter().flat_map(|c| depths.iter().map(move |d| (c, d)));
    let score = |color: &Candidate, depth: &Candidate| {
        let together = common_path(&topics[color.topic].name, &topics[depth.topic].name);
        // Of equal pairs that whose topics come first.
        let first = std::cmp::Reverse((color.topic, depth.topic));
        (color.score + depth.score + together as i32, first)
    };
    let best = pairs.filter(|(c, d)| c.topic != d.topic).max_by_key(|(c, d)| score(c, d));
    let Some((color, depth)) = best else {
        return Err(format!(
            "no topic is a picture of colour and another one of depth ({}); name them: #COLOR_TOPIC,DEPTH_TOPIC",
            listed(topics)
        ));
    };
    let stream = |candidate: &Candidate, is_depth| PictureTopic {
        pictures: candidate.topic,
        picture_type: candidate.picture_type,
        camera: camera_topic(topics, candidate.topic, is_depth),
    };
    Ok(ChosenTopics { color: stream(color, false), depth: stream(depth, true) })
}

/// A topic that may be the one.
struct Candidate {
    topic: usize,
    picture_type: PictureType,
    score: i32,
}

/// The topics that a score is above 0 for, or the one that is asked for by name.
fn candidates(
    topics: &[Topic],
    wanted: &str,
    score: fn(&str) -> i32,
) -> Result<Vec<Candidate>, String> {
    let pictures = topics.iter().enumerate().filter_map(|(topic, t)| {
        let picture_type = picture_type(t)?;
        // What is not compressed is read exactly and fast.
        let exact = i32::from(picture_type == PictureType::Image);
        let score = 2 * score(&t.name.to_ascii_lowercase());
        Some(Candidate { topic, picture_type, score: if score > 0 { score + exact } else { 0 } })
    });
    if wanted.is_empty() {
        return Ok(pictures.filter(|c| c.score > 0).collect());
    }
    let found: Vec<Candidate> = pictures.filter(|c| topics[c.topic].name == wanted).collect();
    if found.is_empty() {
        return Err(format!("no pictures on topic {wanted} ({})", listed(topics)));
    }
    Ok(found)
}

fn picture_type(topic: &Topic) -> Option<PictureType> {
    match (topic.format?, topic.message_type.as_str()) {
        (MessageFormat::Ros(_), "sensor_msgs/Image")
        | (MessageFormat::Foxglove | MessageFormat::FoxgloveRos(_), "foxglove.RawImage") => {
            Some(PictureType::Image)
        }
        (MessageFormat::Ros(_), "sensor_msgs/CompressedImage")
        | (MessageFormat::Foxglove | MessageFormat::FoxgloveRos(_), "foxglove.CompressedImage") => {
            Some(PictureType::Compressed)
        }
        _ => None,
    }
}

fn color_score(name: &str) -> i32 {
    if name.contains("depth") || contains_any(name, &OTHER_WORDS) {
        return 0;
    }
    let rectified = i32::from(is_rectified(name));
    match () {
        () if contains_any(name, &COLOR_WORDS) => 8 + rectified,
        () if name.contains("left") => 3 + rectified,
        () if name.contains("image") => 2 + rectified,
        () => 0,
    }
}

fn depth_score(name: &str) -> i32 {
    if !name.contains("depth") || contains_any(name, &OTHER_WORDS) {
        return 0;
    }
    let registered = if is_registered(name) { 8 } else { 0 };
    // `compressed` beside `compressedDepth` is a JPEG of what depth would look like.
    let lossless = if name.ends_with("/compressed") { 0 } else { 2 };
    4 + registered + lossless
}

fn contains_any(name: &str, words: &[&str]) -> bool {
    let name = name.to_ascii_lowercase();
    words.iter().any(|word| name.contains(word))
}

/// The topic of the camera that took a topic's pictures.
fn camera_topic(topics: &[Topic], pictures: usize, is_depth: bool) -> Option<usize> {
    let name = &topics[pictures].name;
    let fits = |t: &Topic| {
        let says_depth = t.name.to_ascii_lowercase().contains("depth");
        let says_color = contains_any(&t.name, &COLOR_WORDS);
        let is_other = contains_any(&t.name, &OTHER_WORDS);
        let contradicts = if is_depth { says_color && !says_depth } else { says_depth };
        is_camera(t) && !contradicts && (!is_other || contains_any(name, &OTHER_WORDS))
    };
    let cameras = topics.iter().enumerate().filter(|(_, t)| fits(t));
    cameras.max_by_key(|(i, t)| (common_path(name, &t.name), std::cmp::Reverse(*i))).map(|(i, _)| i)
}

fn is_camera(topic: &Topic) -> bool {
    match topic.format {
        Some(MessageFormat::Ros(_)) => topic.message_type == "sensor_msgs/CameraInfo",
        Some(MessageFormat::Foxglove | MessageFormat::FoxgloveRos(_)) => {
            topic.message_type == "foxglove.CameraCalibration"
        }
        None => false,
    }
}

/// Parts of a path that two topics begin with.
fn common_path(a: &str, b: &str) -> usize {
    a.split('/').zip(b.split('/')).skip(1).take_while(|(a, b)| a == b).count()
}

/// All topics of pictures, for messages.
fn listed(topics: &[Topic]) -> String {
    let pictures = topics.iter().filter(|t| t.message_type.contains("Image"));
    let named = |t: &Topic| {
        let unread = if t.format.is_none() { ", whose encoding is not read" } else { "" };
        format!("{} of {}{unread}", t.name, t.message_type)
    };
    let names: Vec<String> = pictures.map(named).take(20).collect();
    if names.is_empty() {
        return format!("of {} topics none holds pictures", topics.len());
    }
    format!("pictures are on {}", names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::wire::WireFormat;

    const IMAGE: &str = "sensor_msgs/msg/Image";
    const COMPRESSED: &str = "sensor_msgs/msg/CompressedImage";
    const INFO: &str = "sensor_msgs/msg/CameraInfo";

    fn topics(names: &[(&str, &str)]) -> Vec<Topic> {
        let format = |kind: &str| match kind.split_once('.') {
            Some(("foxglove", _)) => MessageFormat::Foxglove,
            _ => MessageFormat::Ros(WireFormat::Cdr),
        };
        names.iter().map(|(name, kind)| Topic::new(name, kind, Some(format(kind)))).collect()
    }

    /// Names of colour, its camera, depth, its camera.
    fn chosen(names: &[(&str, &str)], wanted: Option<(&str, &str)>) -> [String; 4] {
        let topics = topics(names);
        let chosen = choose(&topics, wanted).unwrap();
        let name = |topic: Option<usize>| topic.map_or(String::new(), |t| topics[t].name.clone());
        let ChosenTopics { color, depth } = chosen;
        [Some(color.pictures), color.camera, Some(depth.pictures), depth.camera].map(name)
    }

    #[test]
    fn a_realsense_under_ros_2_is_read_with_aligned_depth() {
        let names = [
            ("/camera/camera/depth/image_rect_raw", IMAGE),
            ("/camera/camera/depth/camera_info", INFO),
            ("/camera/camera/infra1/image_rect_raw", IMAGE),
            ("/camera/camera/color/image_raw/compressed", COMPRESSED),
            ("/camera/camera/color/image_raw", IMAGE),
            ("/camera/camera/color/camera_info", INFO),
            ("/camera/camera/aligned_depth_to_color/image_raw", IMAGE),
            ("/camera/camera/aligned_depth_to_color/camera_info", INFO),
        ];
        let expected = [
            "/camera/camera/color/image_raw",
            "/camera/camera/color/camera_info",
            "/camera/camera/aligned_depth_to_color/image_raw",
            "/camera/camera/aligned_depth_to_color/camera_info",
        ];
        assert_eq!(chosen(&names, None), expected);
        let wanted = ("/camera/camera/color/image_raw/compressed", "");
        assert_eq!(chosen(&names, Some(wanted))[0], wanted.0);
    }

    #[test]
    fn realsense_viewer_and_kinect_name_their_topics_otherwise() {
        let device = [
            ("/device_0/sensor_0/Depth_0/info/camera_info", INFO),
            ("/device_0/sensor_0/Depth_0/image/data", IMAGE),
            ("/device_0/sensor_0/Infrared_1/image/data", IMAGE),
            ("/device_0/sensor_1/Color_0/info/camera_info", INFO),
            ("/device_0/sensor_1/Color_0/image/data", IMAGE),
        ];
        let found = chosen(&device, None);
        assert_eq!(found, [device[4].0, device[3].0, device[1].0, device[0].0]);
        let kinect = [
            ("/camera/rgb/image_raw/compressed", COMPRESSED),
            ("/camera/rgb/camera_info", INFO),
            ("/camera/depth_registered/image_raw/compressed", COMPRESSED),
            ("/camera/depth_registered/image_raw/compressedDepth", COMPRESSED),
        ];
        let found = chosen(&kinect, None);
        assert_eq!(found, [kinect[0].0, kinect[1].0, kinect[3].0, ""]);
    }

    #[test]
    fn foxgloves_own_messages_are_pictures_and_cameras_too() {
        let view = [
            ("/camera/color", "foxglove.CompressedImage"),
            ("/camera/depth", "foxglove.RawImage"),
            ("/camera/calibration", "foxglove.CameraCalibration"),
            ("/surface", "foxglove.PointCloud"),
        ];
        assert_eq!(chosen(&view, None), [view[0].0, view[2].0, view[1].0, view[2].0]);
        let json = ["/color", "/depth"].map(|name| Topic::new(name, "foxglove.RawImage", None));
        let error = choose(&json, None).unwrap_err();
        assert!(
            error.contains("/color of foxglove.RawImage, whose encoding is not read"),
            "{error}"
        );
    }

    #[test]
    fn colour_and_depth_of_two_cameras_are_not_mixed() {
        let names = [
            ("/left_arm/color/image_raw", IMAGE),
            ("/head/color/image_raw", IMAGE),
            ("/head/depth/image_raw", IMAGE),
        ];
        assert_eq!(chosen(&names, None)[0], "/head/color/image_raw");
    }

    #[test]
    fn what_is_not_there_is_told_with_what_is() {
        let only_color = topics(&[("/color/image_raw", IMAGE), ("/points", "x/PointCloud2")]);
        let error = choose(&only_color, None).unwrap_err();
        assert!(error.contains("/color/image_raw") && error.contains("#COLOR_TOPIC"), "{error}");
        let error = choose(&only_color, Some(("/a", "/b"))).unwrap_err();
        assert!(error.contains("no pictures on topic /a"), "{error}");
        assert!(choose(&[], None).unwrap_err().contains("none holds pictures"));
    }
}
