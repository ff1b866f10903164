//! Frames of the messages of a bag.

use super::camera_info::camera_of;
use super::message_format::MessageFormat;
use super::pairing::{Pair, Stamped};
use super::picture::{color_of_compressed, color_of_image, depth_of_compressed, depth_of_image};
use super::reader::Topic;
use super::survey::Survey;
use super::topics::{ChosenTopics, PictureType, is_rectified, is_registered};
use super::wire::WireFormat;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::Registration;
use linkage_frames::frame::{ColorImage, DepthImage, RgbdFrame};
use std::sync::Arc;

/// Units in a metre of depth in 16 bits, which ROS calls millimetres.
const MILLIMETRES: f64 = 1000.0;
/// Units in a metre that depth in floating point is recorded at again: steps of 0.2 mm.
const METRIC_UNITS: f64 = 5000.0;
/// Focal lengths and centres that differ by less are the same, pixels.
const SAME_PIXELS: f64 = 0.5;
/// Cameras that differ by less stand at the same place, metres.
const SAME_PLACE_M: f64 = 1e-4;
/// Cameras that differ by less look the same way, radians.
const SAME_DIRECTION_RAD: f64 = 1e-4;

/// How pictures become frames.
pub struct Assembly {
    /// Names of the topics of colour and depth.
    names: [String; 2],
    formats: [MessageFormat; 2],
    picture_types: [PictureType; 2],
    camera: Arc<PinholeCamera>,
    /// Columns and rows of depth.
    depth_size: (usize, usize),
    depth_units_per_metre: f64,
    /// How depth is seen from the colour camera, where it is not registered yet.
    registration: Option<Registration>,
}

impl Assembly {
    /// Decides by what the bag says; a `camera` that is given counts more.
    ///
    /// # Errors
    /// What is wrong and what to do, in a line.
    pub fn new(
        source: &str,
        topics: &[Topic],
        chosen: &ChosenTopics,
        found: &Survey,
        given: Option<&PinholeCamera>,
    ) -> Result<Self, String> {
        let names = [chosen.color.pictures, chosen.depth.pictures].map(|t| &*topics[t].name);
        let units = depth_units(found)?;
        let camera = match (given, &found.color_camera) {
            (Some(camera), _) => camera.clone(),
            (None, Some(info)) => camera_of(info, is_rectified(names[0]), units)
                .map_err(|e| format!("the camera of {}: {e}", names[0]))?,
            (None, None) => {
                let camera =
                    PinholeCamera { depth_units_per_metre: units, ..PinholeCamera::kinect() };
                camera.warn_assumed(source, "give the right ones with --camera camera.toml");
                camera
            }
        };
        let depth_units_per_metre = given.map_or(units, |camera| camera.depth_units_per_metre);
        let registration = registration(source, names, found, &camera)?;
        let depth_camera = registration.as_ref().map_or(&camera, |r| &r.depth_camera);
        let format =
            |topic: usize| topics[topic].format.unwrap_or(MessageFormat::Ros(WireFormat::Cdr));
        Ok(Self {
            names: names.map(str::to_owned),
            formats: [chosen.color.pictures, chosen.depth.pictures].map(format),
            picture_types: [chosen.color.picture_type, chosen.depth.picture_type],
            depth_size: (depth_camera.width, depth_camera.height),
            camera: Arc::new(camera),
            depth_units_per_metre,
            registration,
        })
    }

    /// The camera of the frames.
    pub fn camera(&self) -> &PinholeCamera {
        &self.camera
    }

    /// A colour message with its time: that of its header, or when it was recorded.
    ///
    /// # Errors
    /// What is damaged.
    pub fn stamped_color(&self, bytes: Vec<u8>, log_utime: i64) -> Result<Stamped, String> {
        stamped(bytes, log_utime, self.formats[0], self.picture_types[0])
            .map_err(|e| format!("{}: {e}", self.names[0]))
    }

    /// The same for a depth message.
    ///
    /// # Errors
    /// What is damaged.
    pub fn stamped_depth(&self, bytes: Vec<u8>, log_utime: i64) -> Result<Stamped, String> {
        stamped(bytes, log_utime, self.formats[1], self.picture_types[1])
            .map_err(|e| format!("{}: {e}", self.names[1]))
    }

    /// Decodes a pair.
    ///
    /// # Errors
    /// What is damaged.
    pub fn frame(&self, pair: &Pair) -> Result<RgbdFrame, String> {
        let color = self.color(&pair.color.bytes)?;
        let depth = self.depth(&pair.depth.bytes)?;
        let depth = match &self.registration {
            Some(registration) => registration.register(&depth, &self.camera),
            None => depth,
        };
        RgbdFrame::new(pair.color.utime, Arc::clone(&self.camera), color, depth)
            .map_err(|e| e.to_string())
    }

    fn color(&self, bytes: &[u8]) -> Result<ColorImage, String> {
        let size = (self.camera.width, self.camera.height);
        let (name, format) = (&self.names[0], self.formats[0]);
        let told = |e: &dyn std::fmt::Display| format!("{name}: {e}");
        match self.picture_types[0] {
            PictureType::Image => {
                let image = format.image(bytes).map_err(|e| told(&e))?;
                color_of_image(&image, size).map_err(|e| told(&e))
            }
            PictureType::Compressed => {
                let image = format.compressed_image(bytes).map_err(|e| told(&e))?;
                color_of_compressed(&image, size).map_err(|e| told(&e))
            }
        }
    }

    fn depth(&self, bytes: &[u8]) -> Result<DepthImage, String> {
        let (size, units) = (self.depth_size, self.depth_units_per_metre);
        let (name, format) = (&self.names[1], self.formats[1]);
        let told = |e: &dyn std::fmt::Display| format!("{name}: {e}");
        match self.picture_types[1] {
            PictureType::Image => {
                let image = format.image(bytes).map_err(|e| told(&e))?;
                depth_of_image(&image, size, units).map_err(|e| told(&e))
            }
            PictureType::Compressed => {
                let image = format.compressed_image(bytes).map_err(|e| told(&e))?;
                depth_of_compressed(&image, size, units).map_err(|e| told(&e))
            }
        }
    }
}

fn stamped(
    bytes: Vec<u8>,
    log_utime: i64,
    format: MessageFormat,
    picture_type: PictureType,
) -> Result<Stamped, String> {
    let header = match picture_type {
        PictureType::Image => format.image(&bytes).map(|i| i.header.utime),
        PictureType::Compressed => format.compressed_image(&bytes).map(|i| i.header.utime),
    };
    let stamp = header.map_err(|e| e.to_string())?;
    let utime = if stamp == 0 { log_utime } else { stamp };
    Ok(Stamped { utime, log_utime, bytes: Arc::new(bytes) })
}

/// Units in a metre: the bag's, else what its encoding means.
fn depth_units(found: &Survey) -> Result<f64, String> {
    match found.depth_unit_m {
        Some(metres) if metres > 0.0 && metres.is_finite() => {
            Ok((1.0 / metres * 1e3).round() / 1e3)
        }
        Some(metres) => Err(format!("its unit of depth is {metres} m, which cannot be")),
        None if found.is_depth_metric => Ok(METRIC_UNITS),
        None => Ok(MILLIMETRES),
    }
}

/// How depth that another camera took is seen from the colour camera; `None` where it is
/// registered already, or must be taken for it.
fn registration(
    source: &str,
    [color_name, depth_name]: [&str; 2],
    found: &Survey,
    camera: &PinholeCamera,
) -> Result<Option<Registration>, String> {
    let frames = [&found.color_frame, &found.depth_frame].map(|f| f.as_deref().unwrap_or_default());
    let Some(info) = &found.depth_camera else { return Ok(None) };
    let same_size = (info.width, info.height) == (camera.width, camera.height);
    let named = is_registered(depth_name);
    if same_size && (named || frames[0] == frames[1] && same_intrinsics(info.k, camera)) {
        return Ok(None);
    }
    let known = if named || frames[0] == frames[1] && !frames[0].is_empty() {
        Some(nalgebra::Isometry3::identity())
    } else {
        found.color_from_depth()
    };
    let is_one_camera = same_size && same_intrinsics(info.k, camera);
    if is_one_camera && known.as_ref().is_some_and(is_nearly_identity) {
        return Ok(None);
    }
    if let Some(color_from_depth) = known {
        let units = camera.depth_units_per_metre;
        let depth_camera = camera_of(info, is_rectified(depth_name), units)
            .map_err(|e| format!("the camera of {depth_name}: {e}"))?;
        tracing::info!(source, "depth of {depth_name} is registered to {color_name}");
        return Ok(Some(Registration { depth_camera, color_from_depth }));
    }
    if same_size {
        tracing::warn!(
            source,
            "depth of {depth_name} is in frame \"{}\", colour of {color_name} in \"{}\", and nothing tells how they stand to each other: depth is taken as registered to colour; record depth that the driver aligned, or /tf_static too",
            frames[1],
            frames[0]
        );
        return Ok(None);
    }
    Err(format!(
        "depth of {depth_name} has {}x{} pixels in frame \"{}\", colour of {color_name} {}x{} in \"{}\", and nothing tells how the cameras stand to each other; record depth that the driver aligned to colour, or /tf_static too",
        info.width, info.height, frames[1], camera.width, camera.height, frames[0]
    ))
}

fn is_nearly_identity(pose: &nalgebra::Isometry3<f64>) -> bool {
    pose.translation.vector.norm() < SAME_PLACE_M && pose.rotation.angle() < SAME_DIRECTION_RAD
}

fn same_intrinsics(k: [f64; 9], camera: &PinholeCamera) -> bool {
    [(k[0], camera.fx), (k[2], camera.cx), (k[4], camera.fy), (k[5], camera.cy)]
        .iter()
        .all(|(a, b)| (a - b).abs() < SAME_PIXELS)
}
