//! Opens a source by its name.

use crate::bag::reader::BagReader;
use crate::bag::{BagOptions, BagRecording};
use crate::camera_file::read_camera_file;
use crate::error::SourceError;
use crate::folders::{self, Layout};
use crate::freenect::FreenectCamera;
use crate::lcm::{DEFAULT_CHANNEL, LcmCamera, LogRecording};
use crate::live::{Camera, LiveConfig, LiveSource};
use crate::mcap_file::McapReader;
use crate::openni2::{OniRecording, OpenNi2Camera};
use crate::path_kind::{PathKind, kind_of_path};
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
/// Messages carry depth in millimetres.
const LCM_UNITS_PER_METRE: f64 = 1000.0;

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
        "tum" => Ok(Box::new(TumRecording::open(Path::new(&rest))?)),
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
        "v4l" => {
            let (color, depth) = rest.split_once(',').ok_or_else(|| {
                wrong(format!(
                    "a colour device alone has no depth, which is needed; give v4l:{rest},DEPTH_DEVICE"
                ))
            })?;
            let (color, depth) = (color.to_owned(), depth.to_owned());
            let is_assumed = options.camera.is_none();
            let camera = Arc::new(camera_or(name, options, V4L_UNITS_PER_METRE));
            live(name, options, move || {
                V4lCamera::open(&color, &depth, Arc::clone(&camera), is_assumed)
            })
        }
        _ => Err(wrong(format!("no source of kind \"{kind}:\"; there are {KINDS}"))),
    }
}

/// Opens a recording by its path alone; a bag's may have topics behind it.
fn open_path(name: &str, options: &SourceOptions) -> Result<Box<dyn RgbdSource>, SourceError> {
    let (path, given) = (Path::new(with_topics(name).0), options.camera.as_ref());
    let folder = |layout| folders::open(path, &layout, given).map(|r| Box::new(r) as _);
    match kind_of_path(path)? {
        PathKind::Tum => Ok(Box::new(TumRecording::open(path)?)),
        PathKind::Associations(list) => Ok(Box::new(folders::open_associations(&list, given)?)),
        PathKind::Mcap => open_with(&format!("mcap:{name}"), options),
        PathKind::Rosbag1 => open_with(&format!("bag:{name}"), options),
        PathKind::Rosbag2 | PathKind::Sqlite => open_with(&format!("rosbag2:{name}"), options),
        PathKind::Open3d(json) => folder(Layout::Open3d(json)),
        PathKind::ScanNet => folder(Layout::ScanNet),
        PathKind::BundleFusion => folder(Layout::BundleFusion),
        PathKind::StrayScanner => folder(Layout::StrayScanner),
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

/// `door.camera.toml` beside `door.log`, or `camera.toml` in the same folder.
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
