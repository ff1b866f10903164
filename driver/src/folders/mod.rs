//! Folders of pictures as other programs make them: Open3D, ScanNet, BundleFusion, Stray Scanner,
//! ORB-SLAM's lists.
//!
//! Intrinsics and the unit of depth are taken from the files that the layout has for them; a
//! `camera.toml` beside them, or one that is given, counts more. What nothing tells is assumed, and
//! said with its number.

mod associations;
mod confidence;
mod intrinsics;
mod numbered;
mod odometry;
mod times;

pub use associations::{open_associations, parse_associations};
pub use intrinsics::{Intrinsics, parse_info, parse_matrix, parse_open3d};
pub use odometry::{Odometry, parse_odometry};

use crate::camera_file::read_camera_file;
use crate::error::{PictureFault, SourceError};
use crate::image_file::{self, ImageFileError};
use crate::statistics::SourceStatistics;
use crate::tum::{FramePair, TumRecording, rate_hz};
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{DepthSensor, Registration, ScaleCheck};
use linkage_frames::frame::{DepthImage, RgbdFrame};
use linkage_frames::text_table;
use nalgebra::Isometry3;
use numbered::{Pictures, pairs};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Units in a metre of all these layouts where their files say nothing else.
const MILLIMETRES: f64 = 1000.0;
/// Largest text of intrinsics, bytes.
const MAX_TEXT_BYTES: u64 = 1 << 20;
/// Depth of 7-Scenes where there is no reading.
const NO_READING: u16 = u16::MAX;

/// The layouts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Layout {
    /// With the JSON file of the intrinsics.
    Open3d(PathBuf),
    /// With a folder `intrinsic/`.
    ScanNet,
    /// With `info.txt` or `camera-intrinsics.txt`.
    BundleFusion,
    /// With `camera_matrix.csv`.
    StrayScanner,
}

/// How depth belongs to the pixels of colour.
enum DepthView {
    /// Pixel by pixel.
    Registered,
    /// Another camera saw it.
    Other(Registration),
    /// The same camera saw it in this many larger pixels.
    Coarse((usize, usize)),
}

/// Everything that a pair needs to become a frame.
struct Loader {
    camera: Arc<PinholeCamera>,
    view: DepthView,
    /// Folder of the pictures that tell how sure depth is.
    confidence_dir: Option<PathBuf>,
}

fn broken(path: &Path, reason: impl ToString) -> SourceError {
    SourceError::Recording { path: path.display().to_string(), reason: reason.to_string() }
}

/// Opens a folder.
///
/// # Errors
/// [`SourceError::Recording`] names the file that is missing or damaged.
pub fn open(
    dir: &Path,
    layout: &Layout,
    given: Option<&PinholeCamera>,
) -> Result<TumRecording, SourceError> {
    let color_dir = ["color", "rgb", "image"].map(|name| dir.join(name));
    let color_dir = color_dir.into_iter().find(|d| d.is_dir()).unwrap_or_else(|| dir.to_owned());
    let is_flat = *layout == Layout::BundleFusion;
    let (color_dir, depth_dir) =
        if is_flat { (dir.to_owned(), dir.to_owned()) } else { (color_dir, dir.join("depth")) };
    let color_endings: &[&str] =
        if is_flat { &[".color.png", ".color.jpg"] } else { &[".jpg", ".jpeg", ".png"] };
    let depth_endings: &[&str] = if is_flat { &[".depth.png"] } else { &[".png"] };
    let colors = Pictures { dir: &color_dir, endings: color_endings };
    let depths = Pictures { dir: &depth_dir, endings: depth_endings };
    let (pairs, unpaired) = pairs(&colors, &depths).map_err(|e| broken(dir, e))?;
    let Some(first) = pairs.first() else { return Err(broken(dir, "holds no picture")) };
    let size = |path: &Path| image_file::read_size(path).map_err(|e| broken(dir, e));
    let (color_size, depth_size) = (size(&first.color)?, size(&first.depth)?);
    let Described { camera, view, are_units_assumed } =
        camera_and_view(dir, layout, given, [color_size, depth_size])?;
    let numbered = pairs.len();
    let odometry = dir.join("odometry.csv");
    let pairs = match *layout == Layout::StrayScanner && odometry.exists() {
        true => times::told_by(&odometry, pairs)?,
        false => times::assumed(dir, pairs),
    };
    let statistics = SourceStatistics {
        unpaired: (unpaired + numbered - pairs.len()) as u64,
        rate_hz: rate_hz(&pairs),
        ..Default::default()
    };
    let scale = ScaleCheck::new(camera.depth_units_per_metre, are_units_assumed);
    let confidence_dir = (*layout == Layout::StrayScanner).then(|| dir.join("confidence"));
    let loader = Loader { camera: Arc::new(camera), view, confidence_dir };
    let name = dir.display().to_string();
    Ok(TumRecording::play(&name, pairs, statistics, scale, move |pair| loader.load(pair)))
}

/// What a folder tells of its camera.
struct Described {
    /// The camera of colour.
    camera: PinholeCamera,
    /// How depth belongs to it.
    view: DepthView,
    /// Nothing tells the unit of depth.
    are_units_assumed: bool,
}

/// The camera of a folder. Sizes are those of the first colour and depth
/// pictures.
fn camera_and_view(
    dir: &Path,
    layout: &Layout,
    given: Option<&PinholeCamera>,
    [color_size, depth_size]: [(usize, usize); 2],
) -> Result<Described, SourceError> {
    let toml = dir.join("camera.toml");
    let described = match given {
        Some(camera) => Some(camera.clone()),
        None if toml.is_file() => Some(read_camera_file(&toml)?),
        None => None,
    };
    let coarse = if color_size == depth_size {
        DepthView::Registered
    } else {
        DepthView::Coarse(depth_size)
    };
    if let Some(camera) = described {
        return Ok(Described { camera, view: coarse, are_units_assumed: false });
    }
    let described = |found: Intrinsics, file: &Path| {
        let are_units_assumed = found.depth_units_per_metre.is_none();
        let camera = camera_of(dir, found, color_size, file)?;
        Ok(Described { camera, view: coarse, are_units_assumed })
    };
    match layout {
        Layout::Open3d(json) => described(read(json, parse_open3d)?, json),
        Layout::StrayScanner => {
            let file = dir.join("camera_matrix.csv");
            let found = read(&file, parse_matrix)?;
            // The matrix is that of the video, of which the pictures may be smaller copies.
            let video = video_size(&found, color_size);
            let mut described = described(found.scaled(video, color_size), &file)?;
            // The LiDAR of a phone.
            described.camera.depth_sensor = DepthSensor::TimeOfFlight;
            Ok(described)
        }
        Layout::BundleFusion => {
            let info = dir.join("info.txt");
            let matrix = dir.join("camera-intrinsics.txt");
            let (found, file) = if info.is_file() {
                (read(&info, parse_info)?, info)
            } else if matrix.is_file() {
                (read(&matrix, parse_matrix)?, matrix)
            } else {
                let reason = "no intrinsics: neither info.txt nor camera-intrinsics.txt; give them with --camera camera.toml";
                return Err(broken(dir, reason));
            };
            described(found, &file)
        }
        Layout::ScanNet => scannet(dir, color_size, depth_size),
    }
}

/// ScanNet's depth camera is another one, unless its exporter made colour as small as depth.
fn scannet(
    dir: &Path,
    color_size: (usize, usize),
    depth_size: (usize, usize),
) -> Result<Described, SourceError> {
    // ScanNet's depth is always in millimetres.
    let described = |camera, view| Described { camera, view, are_units_assumed: false };
    let file = |name: &str| dir.join("intrinsic").join(name);
    let (color_file, depth_file) = (file("intrinsic_color.txt"), file("intrinsic_depth.txt"));
    if color_size == depth_size && depth_file.is_file() {
        let camera = camera_of(dir, read(&depth_file, parse_matrix)?, depth_size, &depth_file)?;
        return Ok(described(camera, DepthView::Registered));
    }
    let camera = camera_of(dir, read(&color_file, parse_matrix)?, color_size, &color_file)?;
    if color_size == depth_size {
        return Ok(described(camera, DepthView::Registered));
    }
    let depth_camera = camera_of(dir, read(&depth_file, parse_matrix)?, depth_size, &depth_file)?;
    let color_from_depth = Isometry3::identity();
    Ok(described(camera, DepthView::Other(Registration { depth_camera, color_from_depth })))
}

/// Checks what a file tells against the size of its pictures, and says what is assumed.
fn camera_of(
    dir: &Path,
    found: Intrinsics,
    size: (usize, usize),
    file: &Path,
) -> Result<PinholeCamera, SourceError> {
    let found = match found.size {
        Some(told) if told != size && told.0 > 0 && told.1 > 0 => {
            tracing::warn!(
                file = %file.display(),
                "is for {}x{} pixels, the pictures have {}x{}: the intrinsics are scaled",
                told.0, told.1, size.0, size.1
            );
            found.scaled(told, size)
        }
        _ => found,
    };
    let units = found.depth_units_per_metre.unwrap_or_else(|| {
        tracing::warn!(
            recording = %dir.display(),
            "nothing tells the unit of depth: assumed are {MILLIMETRES} units in a metre; write others into camera.toml"
        );
        MILLIMETRES
    });
    let camera = PinholeCamera {
        width: size.0,
        height: size.1,
        fx: found.fx,
        fy: found.fy,
        cx: found.cx,
        cy: found.cy,
        depth_units_per_metre: units,
        distortion: [0.0; 8],
        depth_sensor: DepthSensor::default(),
    };
    camera.check().map_err(|e| broken(file, e))?;
    Ok(camera)
}

/// Size of the video that a matrix belongs to: its principal point lies near the middle.
fn video_size(found: &Intrinsics, picture: (usize, usize)) -> (usize, usize) {
    let ratio = (2.0 * found.cx / picture.0 as f64).max(1e-3);
    // A whole multiple or fraction of the pictures, as cameras and converters make them.
    let known = [1920.0, 1280.0, 1440.0, 960.0, 720.0, 640.0, picture.0 as f64];
    let width = known
        .into_iter()
        .min_by(|a, b| (a - 2.0 * found.cx).abs().total_cmp(&(b - 2.0 * found.cx).abs()));
    let width = width.unwrap_or(ratio * picture.0 as f64);
    let height = width * picture.1 as f64 / picture.0 as f64;
    (width.round() as usize, height.round() as usize)
}

fn read(
    file: &Path,
    parse: fn(&str) -> Result<Intrinsics, String>,
) -> Result<Intrinsics, SourceError> {
    let size = std::fs::metadata(file).map_err(|e| broken(file, e))?.len();
    if size > MAX_TEXT_BYTES {
        return Err(broken(file, format!("has {size} bytes, more than {MAX_TEXT_BYTES}")));
    }
    let text = text_table::read(file).map_err(|e| broken(file, e))?;
    parse(&text).map_err(|e| broken(file, e))
}

impl Loader {
    fn load(&self, pair: &FramePair) -> Result<RgbdFrame, SourceError> {
        let unusable = |e: ImageFileError| match e.fault {
            PictureFault::Size(source) => SourceError::Frame { path: e.path, source },
            PictureFault::Damaged(reason) => SourceError::Recording {
                path: e.path,
                reason: format!("{reason}: record it again, or remove it and its partner"),
            },
        };
        let size = (self.camera.width, self.camera.height);
        let depth_size = match &self.view {
            DepthView::Registered => size,
            DepthView::Other(registration) => {
                (registration.depth_camera.width, registration.depth_camera.height)
            }
            DepthView::Coarse(depth_size) => *depth_size,
        };
        let color = image_file::read_color(&pair.color, size).map_err(unusable)?;
        let mut raw = self.raw_depth(&pair.depth, depth_size).map_err(unusable)?;
        let misfit = |source| SourceError::Frame { path: pair.depth.display().to_string(), source };
        if let DepthView::Coarse(coarse) = self.view {
            raw = finer(&raw, coarse, size);
        }
        let units = self.camera.depth_units_per_metre;
        let depth = match &self.view {
            DepthView::Other(registration) => {
                let depth = DepthImage::from_raw(depth_size.0, depth_size.1, &raw, units);
                registration.register(&depth.map_err(misfit)?, &self.camera)
            }
            _ => DepthImage::from_raw(size.0, size.1, &raw, units).map_err(misfit)?,
        };
        RgbdFrame::new(pair.utime, Arc::clone(&self.camera), color, depth).map_err(misfit)
    }

    /// Raw depth of a picture; 0 where there is no reading.
    fn raw_depth(&self, depth: &Path, size: (usize, usize)) -> Result<Vec<u16>, ImageFileError> {
        let mut raw = image_file::read_depth(depth, size)?;
        raw.iter_mut().filter(|r| **r == NO_READING).for_each(|r| *r = 0);
        let confidence = self.confidence_dir.as_ref().zip(depth.file_name());
        if let Some(picture) = confidence.map(|(dir, name)| dir.join(name)).filter(|p| p.exists()) {
            confidence::remove_low(&mut raw, size, &picture)?;
        }
        Ok(raw)
    }
}

/// Depth in more pixels: each takes the reading that it lies in, so that no edge is blurred.
pub(crate) fn finer<T: Copy>(raw: &[T], from: (usize, usize), to: (usize, usize)) -> Vec<T> {
    let mut finer = Vec::with_capacity(to.0 * to.1);
    for v in 0..to.1 {
        let row = v * from.1 / to.1 * from.0;
        finer.extend((0..to.0).map(|u| raw[row + u * from.0 / to.0]));
    }
    finer
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rgbd_source::RgbdSource;
    use linkage_frames::frame::ColorImage;

    /// Columns and rows of the colour and the depth pictures of [`stray_folder`].
    const COLOR_SIZE: (usize, usize) = (8, 6);
    const DEPTH_SIZE: (usize, usize) = (4, 3);
    const HEADER: &str = "timestamp, frame, x, y, z, qx, qy, qz, qw\n";

    /// A folder of Stray Scanner with these frames: colour in more pixels than depth, all of it 1 m away.
    fn stray_folder(frames: impl IntoIterator<Item = u32>) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: String| dir.path().join(name);
        std::fs::write(path("camera_matrix.csv".into()), "1450,0,960\n0,1450,720\n0,0,1\n")
            .unwrap();
        for folder in ["rgb", "depth", "confidence"] {
            std::fs::create_dir(path(folder.into())).unwrap();
        }
        let color = ColorImage::new(COLOR_SIZE.0, COLOR_SIZE.1, vec![90; 8 * 6 * 3]).unwrap();
        for frame in frames {
            let depth = path(format!("depth/{frame:06}.png"));
            image_file::write_color(&path(format!("rgb/{frame:06}.png")), &color).unwrap();
            image_file::write_depth(&depth, DEPTH_SIZE.0, DEPTH_SIZE.1, &[1000; 12]).unwrap();
        }
        dir
    }

    fn stray_frames(dir: &tempfile::TempDir) -> Result<Vec<RgbdFrame>, SourceError> {
        let mut source = open(dir.path(), &Layout::StrayScanner, None)?;
        std::iter::from_fn(|| source.next_frame().transpose()).collect()
    }

    fn with_odometry(dir: &tempfile::TempDir, text: &str) {
        std::fs::write(dir.path().join("odometry.csv"), text).unwrap();
    }

    #[test]
    fn stray_scanners_odometry_tells_the_times_of_its_frames() {
        let dir = stray_folder([0, 1, 2, 7]);
        let rows = "12.5, 000000, 0, 0, 0, 0, 0, 0, 1\n12.516667, 000001, 0, 0, 0, 0, 0, 0, 1\n\
                    12.6, 000003, 0, 0, 0, 0, 0, 0, 1\n13.5, 000007, 0, 0, 0, 0, 0, 0, 1\n";
        with_odometry(&dir, &format!("{HEADER}{rows}"));
        let mut source = open(dir.path(), &Layout::StrayScanner, None).unwrap();
        let counted = source.statistics();
        assert_eq!((counted.unpaired, counted.rate_hz), (1, 2.0), "frame 2 has no time");
        let utimes: Vec<i64> =
            std::iter::from_fn(|| source.next_frame().unwrap()).map(|f| f.utime).collect();
        assert_eq!(utimes, [12_500_000, 12_516_667, 13_500_000]);
    }

    #[test]
    fn without_odometry_a_rate_is_assumed() {
        let frames = stray_frames(&stray_folder([0, 3])).unwrap();
        assert_eq!(frames.iter().map(|f| f.utime).collect::<Vec<_>>(), [0, 100_000]);
    }

    #[test]
    fn odometry_that_tells_no_time_of_a_picture_is_an_error_with_its_file_and_line() {
        let dir = stray_folder([0, 1]);
        for (text, line) in [
            (String::new(), "line 1"),
            ("0.1, 0\n0.2, 1\n".to_owned(), "line 1"),
            (HEADER.to_owned(), "line 1"),
            (format!("{HEADER}, 0, 0\nlate, 1, 0\n"), "line 2"),
            (format!("{HEADER}0.1, 5, 0\n0.2, 6, 0\n"), "line 2"),
            (format!("{HEADER}0.2, 0, 0\n0.1, 1, 0\n"), "line 3"),
        ] {
            with_odometry(&dir, &text);
            let told = stray_frames(&dir).unwrap_err().to_string();
            assert!(told.contains("odometry.csv: ") && told.contains(line), "{text:?}: {told}");
        }
    }

    #[test]
    fn a_phones_scanner_measures_time_of_flight_unless_a_camera_is_given() {
        let dir = stray_folder([0]);
        let sensor = |frames: Vec<RgbdFrame>| frames[0].camera.depth_sensor;
        assert_eq!(sensor(stray_frames(&dir).unwrap()), DepthSensor::TimeOfFlight);
        let camera = PinholeCamera {
            width: COLOR_SIZE.0,
            height: COLOR_SIZE.1,
            fx: 8.0,
            fy: 8.0,
            cx: 3.5,
            cy: 2.5,
            depth_sensor: DepthSensor::Stereo,
            ..PinholeCamera::kinect()
        };
        std::fs::write(dir.path().join("camera.toml"), toml::to_string(&camera).unwrap()).unwrap();
        assert_eq!(sensor(stray_frames(&dir).unwrap()), DepthSensor::Stereo);
    }

    #[test]
    fn depth_of_no_confidence_is_no_reading() {
        let dir = stray_folder([0, 1]);
        let confidence = [0, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 0];
        let path = dir.path().join("confidence/000001.png");
        image_file::write_labels(&path, DEPTH_SIZE.0, DEPTH_SIZE.1, &confidence).unwrap();
        let frames = stray_frames(&dir).unwrap();
        assert_eq!(frames[0].depth.invalid_share(), 0.0, "it has no picture of confidence");
        let depth = &frames[1].depth;
        for (u, v, expected) in [(0, 0, None), (1, 1, None), (2, 0, Some(1.0)), (7, 5, None)] {
            assert_eq!(depth.at(u, v), expected, "{u}, {v}");
        }
        image_file::write_labels(&path, 2, 2, &[2; 4]).unwrap();
        let told = stray_frames(&dir).unwrap_err().to_string();
        assert!(told.contains("confidence/000001.png") && told.contains("2x2"), "{told}");
    }

    #[test]
    fn coarse_depth_is_repeated_not_blended() {
        let finer = finer(&[1, 2, 3, 4], (2, 2), (4, 4));
        assert_eq!(finer, [1, 1, 2, 2, 1, 1, 2, 2, 3, 3, 4, 4, 3, 3, 4, 4]);
    }

    #[test]
    fn a_videos_size_is_told_by_its_principal_point() {
        let found =
            Intrinsics { cx: 957.3, cy: 722.0, fx: 1450.0, fy: 1450.0, ..Default::default() };
        assert_eq!(video_size(&found, (640, 480)), (1920, 1440));
        let found = Intrinsics { cx: 321.0, ..found };
        assert_eq!(video_size(&found, (640, 480)), (640, 480));
    }
}
