//! Where frames come from.

use crate::camera::PinholeCamera;
use crate::frame::{FrameError, RgbdFrame};
use crate::freenect::FreenectCamera;
use crate::lcm::{DEFAULT_CHANNEL, LcmCamera, LogRecording};
use crate::live::{Camera, LiveConfig, LiveSource};
use crate::openni2::{OniRecording, OpenNi2Camera};
use crate::statistics::SourceStatistics;
use crate::tum::TumRecording;
use crate::v4l::V4lCamera;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// A source that cannot be opened or read.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// No source goes by that name.
    #[error("{name}: {reason}")]
    Name {
        /// As it was given.
        name: String,
        /// What would be right.
        reason: String,
    },
    /// A file of a recording is missing, damaged or contradicts another.
    #[error("{path}: {reason}")]
    Recording {
        /// The file or folder.
        path: String,
        /// What is wrong and what to do.
        reason: String,
    },
    /// The frames of a recording do not fit its camera.
    #[error("{path}")]
    Frame {
        /// The picture.
        path: String,
        /// How it does not fit.
        source: FrameError,
    },
    /// A device or network cannot be used, or not any more.
    #[error("{name}: {reason}")]
    Device {
        /// The source.
        name: String,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// What waiting for a frame gave.
#[derive(Debug)]
pub enum Awaited {
    /// A frame.
    Frame(RgbdFrame),
    /// None came in time; one may come later.
    Nothing,
    /// None will come any more.
    End,
}

/// Where frames come from: a live camera or a recording.
pub trait RgbdSource: Send {
    /// Blocks until the next frame; `Ok(None)` once a recording has ended.
    ///
    /// # Errors
    /// [`SourceError`] names what could not be read.
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError>;

    /// The same, but waits no longer than it is told for a live camera that is silent.
    /// Recordings do not wait: theirs is the next frame.
    ///
    /// # Errors
    /// As [`Self::next_frame`].
    fn next_frame_within(&mut self, _timeout: Duration) -> Result<Awaited, SourceError> {
        Ok(self.next_frame()?.map_or(Awaited::End, Awaited::Frame))
    }

    /// Frames in all, where that is known.
    fn frame_count(&self) -> Option<usize>;

    /// Name for logs and provenance.
    fn name(&self) -> &str;

    /// True for a camera that goes on until it is stopped.
    fn is_live(&self) -> bool {
        false
    }

    /// What was delivered and what was lost so far.
    fn statistics(&self) -> SourceStatistics;
}

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
const KINDS: &str = "tum:DIR or a directory, oni:FILE, lcmlog:FILE[#CHANNEL], \
    lcm:URL[#CHANNEL], freenect:N, openni2:[URI], v4l:COLOUR,DEPTH";

/// Opens a source by name (DESIGN 4.2) with default options.
///
/// # Errors
/// As [`open_with`].
pub fn open(name: &str) -> Result<Box<dyn RgbdSource>, SourceError> {
    open_with(name, &SourceOptions::default())
}

/// Opens a source by name (DESIGN 4.2).
///
/// # Errors
/// [`SourceError::Name`] for a name that is not understood, [`SourceError::Recording`] for
/// files that are no recording, [`SourceError::Device`] for a device that is not there.
pub fn open_with(name: &str, options: &SourceOptions) -> Result<Box<dyn RgbdSource>, SourceError> {
    let wrong = |reason: String| SourceError::Name { name: name.to_owned(), reason };
    let Some((kind, rest)) = name.split_once(':').filter(|_| !Path::new(name).exists()) else {
        return Ok(Box::new(TumRecording::open(Path::new(name))?));
    };
    let rest = rest.to_owned();
    match kind {
        "tum" => Ok(Box::new(TumRecording::open(Path::new(&rest))?)),
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
            let options = SourceOptions { live: options.live.patient(), ..options.clone() };
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

/// The camera that is given, or a Kinect whose depth has so many units in a metre.
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
        Some(path) => PinholeCamera::read_or_explain(path),
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
