//! Opens a source by its name.

use crate::bag::reader::BagReader;
use crate::bag::{BagOptions, BagRecording};
use crate::camera_file::read_camera_file;
use crate::error::SourceError;
use crate::folders::{self, Layout};
use crate::freenect::FreenectCamera;
use crate::lcm::{DEFAULT_CHANNEL, LCM_UNITS_PER_METRE, LcmCamera, LogRecording};
use crate::live::{Camera, LiveConfig, LiveSource};
use crate::mcap_file::McapReader;
use crate::openni2::{OniRecording, OpenNi2Camera};
use crate::path_kind::{PathKind, kind_of_path};
use crate::record3d;
use crate::rgbd_source::RgbdSource;
use crate::rosbag1::Rosbag1Reader;
use crate::rosbag2::{Rosbag2Reader, SqliteReader};
use crate::tum::TumRecording;
use crate::v4l::V4lCamera;
use linkage_frames::camera::PinholeCamera;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// How sources are opened.
#[derive(Debug, Clone, Default)]
pub struct SourceOptions {
    /// The camera of sources that do not say which they come from: LCM, V4L2. Kinect defaults
    /// where none is given.
    pub camera: Option<PinholeCamera>,
    /// How live cameras are watched.
    pub live: LiveConfig,
    /// Once set, a live camera ends as a recording does.
    pub stop: Arc<AtomicBool>,
}

/// Depth of V4L2 devices is in millimetres unless a camera says otherwise.
const V4L_UNITS_PER_METRE: f64 = 1000.0;

/// The kinds of sources, for messages.
const KINDS: &str = "a recording's path, tum:DIR, mcap:FILE, bag:FILE or rosbag2:DIR \
    (each with [#COLOR_TOPIC,DEPTH_TOPIC]), oni:FILE, \
    lcmlog:FILE[#CHANNEL], lcm:URL[#CHANNEL], freenect:N, openni2:[URI], v4l:COLOUR,DEPTH";

/// Opens a source by name with default options.
///
/// # Errors
/// As [`open_with`].
pub fn open(name: &str) -> Result<Box<dyn RgbdSource>, SourceError> {
    open_with(name, &SourceOptions::default())
}

/// Opens a source by name.
///
/// # Errors
/// [`SourceError::Name`] for a name that is not understood, [`SourceError::Recording`] for
/// files that are no recording, [`SourceError::Device`] for a device that is not there.
pub fn open_with(name: &str, options: &SourceOptions) -> Result<Box<dyn RgbdSource>, SourceError> {
    let wrong = |reason: String| SourceError::Name { name: name.to_owned(), reason };
    let Some((kind, rest)) = name.split_once(':').filter(|_| !Path::new(name).exists()) else {
        return open_path(name, options);
    };
    let rest = rest.to_owned();
    match kind {
        "tum" => {
            let given = options.camera.as_ref();
            Ok(Box::new(TumRecording::open_with_camera(Path::new(&rest), given)?))
        }
        "bag" => open_bag("bag", &rest, options, |path| Ok(Box::new(Rosbag1Reader::open(path)?))),
        "rosbag2" => open_bag("rosbag2", &rest, options, |path| {
            if path.is_dir() {
                return Ok(Box::new(Rosbag2Reader::open(path)?));
            }
            Ok(Box::new(SqliteReader::open(path)?))
        }),
        "mcap" => open_bag("mcap", &rest, options, |path| Ok(Box::new(McapReader::open(path)?))),
        "oni" => Ok(Box::new(OniRecording::open(Path::new(&rest), options.camera.as_ref())?)),
        "lcmlog" => {
            let (file, channel) = with_channel(&rest);
            let path = Path::new(file);
            let camera = match &options.camera {
                Some(camera) => camera.clone(),
                None => camera_beside(path)?,
            };
            Ok(Box::new(LogRecording::open(path, channel, Arc::new(camera))?))
        }
        "lcm" => {
            let (url, channel) = with_channel(&rest);
            let (url, channel) = (url.to_owned(), channel.to_owned());
            let camera = Arc::new(camera_or(name, options, LCM_UNITS_PER_METRE));
            let options = SourceOptions { live: options.live.for_network(), ..options.clone() };
            live(name, &options, move || LcmCamera::open(&url, &channel, Arc::clone(&camera)))
        }
        "freenect" => {
            let index = if rest.is_empty() { Ok(0) } else { rest.parse() };
            let index = index
                .map_err(|_| wrong(format!("\"{rest}\" is no device number; try freenect:0")))?;
            let camera = options.camera.clone();
            live(name, options, move || FreenectCamera::open(index, camera.clone()))
        }
        "openni2" => {
            let camera = options.camera.clone();
            live(name, options, move || OpenNi2Camera::open(&rest, camera.as_ref()))
        }
        "v4l" => open_v4l(name, &rest, options),
        _ => Err(wrong(format!("no source of kind \"{kind}:\"; there are {KINDS}"))),
    }
}

/// Opens two V4L2 devices, one of colour and one of depth.
fn open_v4l(
    name: &str,
    devices: &str,
    options: &SourceOptions,
) -> Result<Box<dyn RgbdSource>, SourceError> {
    let (color, depth) = devices.split_once(',').ok_or_else(|| SourceError::Name {
        name: name.to_owned(),
        reason: format!(
            "a colour device alone has no depth, which is needed; give v4l:{devices},DEPTH_DEVICE"
        ),
    })?;
    let (color, depth) = (color.to_owned(), depth.to_owned());
    let is_assumed = options.camera.is_none();
    let camera = Arc::new(camera_or(name, options, V4L_UNITS_PER_METRE));
    live(name, options, move || V4lCamera::open(&color, &depth, Arc::clone(&camera), is_assumed))
}

/// Opens a recording by its path alone; a bag's may have topics behind it.
fn open_path(name: &str, options: &SourceOptions) -> Result<Box<dyn RgbdSource>, SourceError> {
    let (path, given) = (Path::new(with_topics(name).0), options.camera.as_ref());
    let folder = |layout| folders::open(path, &layout, given).map(|r| Box::new(r) as _);
    match kind_of_path(path)? {
        PathKind::Tum => Ok(Box::new(TumRecording::open_with_camera(path, given)?)),
        PathKind::Associations(list) => Ok(Box::new(folders::open_associations(&list, given)?)),
        PathKind::Mcap => open_with(&format!("mcap:{name}"), options),
        PathKind::Rosbag1 => open_with(&format!("bag:{name}"), options),
        PathKind::Rosbag2 | PathKind::Sqlite => open_with(&format!("rosbag2:{name}"), options),
        PathKind::Open3d(json) => folder(Layout::Open3d(json)),
        PathKind::ScanNet => folder(Layout::ScanNet),
        PathKind::BundleFusion => folder(Layout::BundleFusion),
        PathKind::StrayScanner => folder(Layout::StrayScanner),
        PathKind::Record3d => Ok(Box::new(record3d::open(path, given)?)),
    }
}

/// Opens a container of messages.
fn open_bag(
    kind: &str,
    rest: &str,
    options: &SourceOptions,
    open: impl Fn(&Path) -> Result<Box<dyn BagReader>, SourceError>,
) -> Result<Box<dyn RgbdSource>, SourceError> {
    let (path, topics) = with_topics(rest);
    let topics = topics.map(|(color, depth)| (color.to_owned(), depth.to_owned()));
    let bag = BagOptions { camera: options.camera.clone(), topics };
    let opener = || open(Path::new(path));
    Ok(Box::new(BagRecording::open(&format!("{kind}:{path}"), &opener, &bag)?))
}

/// `PATH#COLOR_TOPIC,DEPTH_TOPIC`, or a path alone. One of the topics may be left out.
fn with_topics(name: &str) -> (&str, Option<(&str, &str)>) {
    match name.rsplit_once('#') {
        Some((path, topics)) if !Path::new(name).exists() => {
            let (color, depth) = topics.split_once(',').unwrap_or((topics, ""));
            (path, Some((color.trim(), depth.trim())))
        }
        _ => (name, None),
    }
}

fn live<C: Camera + 'static>(
    name: &str,
    options: &SourceOptions,
    mut open: impl FnMut() -> Result<C, SourceError> + Send + 'static,
) -> Result<Box<dyn RgbdSource>, SourceError> {
    let opener = move || open().map(|camera| Box::new(camera) as Box<dyn Camera>);
    let stop = Arc::clone(&options.stop);
    Ok(Box::new(LiveSource::start(name, Box::new(opener), options.live.clone(), stop)?))
}

/// `NAME#CHANNEL`, or a name alone.
fn with_channel(name: &str) -> (&str, &str) {
    match name.rsplit_once('#') {
        Some((name, channel)) if !channel.is_empty() => (name, channel),
        _ => (name.trim_end_matches('#'), DEFAULT_CHANNEL),
    }
}

/// The camera that is given, or a Kinect whose depth has this many units in a metre.
fn camera_or(source: &str, options: &SourceOptions, units: f64) -> PinholeCamera {
    options.camera.clone().unwrap_or_else(|| {
        let camera = PinholeCamera { depth_units_per_metre: units, ..PinholeCamera::kinect() };
        camera.warn_assumed(source, "give the right ones with --camera camera.toml");
        camera
    })
}

/// The camera of `door.camera.toml` beside `door.log`, or of `camera.toml` in the same folder; else a Kinect, which
/// is assumed.
fn camera_beside(file: &Path) -> Result<PinholeCamera, SourceError> {
    let candidates: [PathBuf; 2] =
        [file.with_extension("camera.toml"), file.with_file_name("camera.toml")];
    match candidates.iter().find(|path| path.is_file()) {
        Some(path) => read_camera_file(path),
        None => {
            let camera = PinholeCamera {
                depth_units_per_metre: LCM_UNITS_PER_METRE,
                ..PinholeCamera::kinect()
            };
            let remedy = format!("write the right ones into {}", candidates[0].display());
            camera.warn_assumed(&file.display().to_string(), &remedy);
            Ok(camera)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(name: &str) -> String {
        open(name).err().expect("it is refused").to_string()
    }

    #[test]
    fn a_kind_that_there_is_not_is_refused_with_those_that_there_are() {
        let said = refusal("kinect:0");
        assert!(said.contains("\"kinect:\"") && said.contains("freenect:N"), "{said}");
    }

    #[test]
    fn a_device_number_that_is_none_is_refused_before_a_device_is_opened() {
        for name in ["freenect:first", "freenect:-", "freenect:99999999999"] {
            let said = refusal(name);
            assert!(said.contains("is no device number; try freenect:0"), "{said}");
        }
    }

    #[test]
    fn colour_alone_is_refused_with_what_is_missing() {
        let said = refusal("v4l:/dev/video0");
        assert!(said.contains("give v4l:/dev/video0,DEPTH_DEVICE"), "{said}");
    }

    #[test]
    fn recordings_that_are_not_there_are_told_by_their_path() {
        for kind in ["tum", "bag", "rosbag2", "mcap", "lcmlog"] {
            let said = refusal(&format!("{kind}:/no/such/recording"));
            assert!(said.contains("/no/such/recording"), "{kind}: {said}");
        }
        assert!(refusal("/no/such/recording").contains("/no/such/recording"));
    }

    #[test]
    fn topics_stand_behind_the_last_sign_and_one_may_be_left_out() {
        assert_eq!(with_topics("a.bag"), ("a.bag", None));
        assert_eq!(with_topics("a.bag#/c, /d "), ("a.bag", Some(("/c", "/d"))));
        assert_eq!(with_topics("a.bag#/c"), ("a.bag", Some(("/c", ""))));
        assert_eq!(with_topics("a.bag#,/d"), ("a.bag", Some(("", "/d"))));
        assert_eq!(with_topics("a#1.bag#/c,/d"), ("a#1.bag", Some(("/c", "/d"))));
    }

    #[test]
    fn a_file_whose_name_has_the_sign_is_that_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("take#2.bag");
        std::fs::write(&path, "").unwrap();
        let name = path.to_string_lossy().into_owned();
        assert_eq!(with_topics(&name), (name.as_str(), None));
        let said = format!("{name}#/c,/d");
        assert_eq!(with_topics(&said), (name.as_str(), Some(("/c", "/d"))));
    }

    #[test]
    fn a_channel_stands_behind_the_last_sign_and_without_one_it_is_the_usual() {
        assert_eq!(with_channel("a.log#OTHER"), ("a.log", "OTHER"));
        for name in ["a.log", "a.log#"] {
            assert_eq!(with_channel(name), ("a.log", DEFAULT_CHANNEL));
        }
        assert_eq!(with_channel("udpm://239.255.76.67:7667?ttl=0#RGBD").1, "RGBD");
    }

    #[test]
    fn a_logs_own_camera_comes_before_that_of_its_folder() {
        let dir = tempfile::tempdir().unwrap();
        let log = dir.path().join("door.log");
        let write = |name: &str, fx: f64| {
            let camera = PinholeCamera { fx, ..PinholeCamera::kinect() };
            std::fs::write(dir.path().join(name), toml::to_string(&camera).unwrap()).unwrap();
        };
        assert_eq!(camera_beside(&log).unwrap().depth_units_per_metre, LCM_UNITS_PER_METRE);
        write("camera.toml", 400.0);
        assert_eq!(camera_beside(&log).unwrap().fx, 400.0);
        write("door.camera.toml", 300.0);
        assert_eq!(camera_beside(&log).unwrap().fx, 300.0);
        std::fs::write(dir.path().join("door.camera.toml"), "fx = \"wide\"").unwrap();
        assert!(camera_beside(&log).is_err(), "a damaged one is not passed over");
    }
}
