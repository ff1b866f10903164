//! Recordings of Record3D, an app for phones with a depth sensor: a `.r3d` file, or the folder that it unpacks to.
//!
//! `metadata` describes the camera (JSON); `rgbd/17.jpg` is a colour picture, `rgbd/17.depth` its depth in metres and
//! `rgbd/17.conf` how sure that is. Depth has fewer pixels than colour and is registered to it. A `camera.toml` in the
//! folder counts more than `metadata`.

mod archive;
mod depth;
mod metadata;

pub use depth::{confidence, metres};
pub use metadata::{Metadata, parse as parse_metadata};

use crate::camera_file::read_camera_file;
use crate::error::{PictureFault, SourceError};
use crate::folders::finer;
use crate::jpeg;
use crate::statistics::SourceStatistics;
use crate::tum::{FramePair, TumRecording, rate_hz};
use archive::Archive;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::{DepthSensor, ScaleCheck};
use linkage_frames::frame::{DepthImage, RgbdFrame};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The file that describes the camera.
const METADATA: &str = "metadata";
/// The lowest confidence: such a reading is none.
const LOW_CONFIDENCE: u8 = 0;
/// Millimetres, in which a camera's depth is written where it is recorded anew.
const UNITS_PER_METRE: f64 = 1000.0;
/// Largest text of the description, bytes: a pose and intrinsics a frame, for an hour.
const MAX_METADATA_BYTES: u64 = 64 << 20;
/// Largest picture as it is stored, bytes.
const MAX_PICTURE_BYTES: u64 = 64 << 20;

/// Everything that a pair needs to become a frame.
struct Loader {
    /// What errors name.
    path: PathBuf,
    archive: Archive,
    camera: Arc<PinholeCamera>,
    depth_size: (usize, usize),
}

/// Opens a file or a folder. A camera that is given takes the place of the one that it describes.
///
/// # Errors
/// [`SourceError::Recording`] names the file that is missing or damaged.
pub fn open(path: &Path, given: Option<&PinholeCamera>) -> Result<TumRecording, SourceError> {
    let broken = |path: &Path, reason: String| {
        let path = path.display().to_string();
        SourceError::Recording { path, reason }
    };
    let archive = Archive::open(path).map_err(|reason| broken(path, reason))?;
    let file = path.join(METADATA);
    let text = archive.read(METADATA, MAX_METADATA_BYTES).map_err(|e| broken(&file, e))?;
    let metadata = metadata::parse(&text).map_err(|reason| broken(&file, reason))?;
    if let Some(rate_hz) = metadata.assumed_rate_hz() {
        let recording = path.display();
        tracing::warn!(%recording, "nothing tells the times of the frames: assumed are {rate_hz} a second");
    }
    let numbers = archive.frames();
    let Some(first) = numbers.first() else {
        return Err(broken(path, "holds no frame with colour and depth in rgbd/".to_owned()));
    };
    let name = color_name(*first);
    let first = path.join(&name);
    let picture = archive.read(&name, MAX_PICTURE_BYTES).map_err(|e| broken(&first, e))?;
    let size = jpeg::size(&picture).map_err(|e| broken(&first, e.to_string()))?;
    let own = path.join("camera.toml");
    let camera = match given {
        Some(camera) => camera.clone(),
        None if own.is_file() => read_camera_file(&own)?,
        None => camera(&metadata, size),
    };
    camera.check().map_err(|e| broken(&file, e.to_string()))?;
    let pairs = pairs(&numbers, &metadata).map_err(|reason| broken(&file, reason))?;
    let statistics = SourceStatistics {
        unpaired: (archive.pictures() - pairs.len()) as u64,
        rate_hz: rate_hz(&pairs),
        ..Default::default()
    };
    let scale = ScaleCheck::new(UNITS_PER_METRE, false);
    let (camera, depth_size) = (Arc::new(camera), metadata.depth_size);
    let loader = Loader { path: path.to_owned(), archive, camera, depth_size };
    let name = path.display().to_string();
    Ok(TumRecording::play(&name, pairs, statistics, scale, move |pair| loader.load(pair)))
}

fn color_name(number: u64) -> String {
    format!("rgbd/{number}.jpg")
}

fn depth_name(number: u64) -> String {
    format!("rgbd/{number}.depth")
}

/// The camera of colour pictures of this size.
fn camera(metadata: &Metadata, size: (usize, usize)) -> PinholeCamera {
    let intrinsics = metadata.intrinsics.scaled(metadata.color_size, size);
    PinholeCamera {
        width: size.0,
        height: size.1,
        fx: intrinsics.fx,
        fy: intrinsics.fy,
        cx: intrinsics.cx,
        cy: intrinsics.cy,
        depth_units_per_metre: UNITS_PER_METRE,
        distortion: [0.0; 8],
        // The LiDAR of a phone; the sensor of its front camera projects a pattern.
        depth_sensor: match metadata.is_front_camera {
            true => DepthSensor::StructuredLight,
            false => DepthSensor::TimeOfFlight,
        },
    }
}

/// The frames with their times; those that the description has no time for are left out.
fn pairs(numbers: &[u64], metadata: &Metadata) -> Result<Vec<FramePair>, String> {
    let timed = |number: &u64| {
        let utime = metadata.utime(*number)?;
        let [color, depth] = [color_name(*number), depth_name(*number)].map(PathBuf::from);
        Some(FramePair { utime, color, depth, gap_us: 0 })
    };
    let pairs: Vec<FramePair> = numbers.iter().filter_map(timed).collect();
    if pairs.is_empty() {
        return Err("gives no frame a time".to_owned());
    }
    if let Some(two) = pairs.windows(2).find(|two| two[1].utime <= two[0].utime) {
        return Err(format!("time runs backwards at {}", two[1].color.display()));
    }
    Ok(pairs)
}

impl Loader {
    /// Decodes one pair.
    fn load(&self, pair: &FramePair) -> Result<RgbdFrame, SourceError> {
        let in_path = |name: &Path| self.path.join(name).display().to_string();
        let unreadable = |name: &Path, reason: String| {
            let reason =
                format!("{reason}: record it again, or give the folder without this frame");
            SourceError::Recording { path: in_path(name), reason }
        };
        let read = |name: &Path| {
            let bytes = self.archive.read(&name.to_string_lossy(), MAX_PICTURE_BYTES);
            bytes.map_err(|reason| unreadable(name, reason))
        };
        let size = (self.camera.width, self.camera.height);
        let color = jpeg::decode(&read(&pair.color)?, size).map_err(|fault| match fault {
            PictureFault::Size(source) => SourceError::Frame { path: in_path(&pair.color), source },
            PictureFault::Damaged(reason) => unreadable(&pair.color, reason),
        })?;
        let damaged = |reason| unreadable(&pair.depth, reason);
        let mut metres = metres(&read(&pair.depth)?, self.depth_size).map_err(damaged)?;
        let beside = pair.depth.with_extension("conf");
        if self.archive.holds(&beside.to_string_lossy()) {
            let damaged = |reason| unreadable(&beside, reason);
            let confidence = confidence(&read(&beside)?, self.depth_size).map_err(damaged)?;
            let low = metres.iter_mut().zip(confidence).filter(|(_, c)| *c == LOW_CONFIDENCE);
            low.for_each(|(z, _)| *z = 0.0);
        }
        let metres = finer(&metres, self.depth_size, size);
        DepthImage::from_metres(size.0, size.1, metres)
            .and_then(|depth| RgbdFrame::new(pair.utime, Arc::clone(&self.camera), color, depth))
            .map_err(|source| SourceError::Frame { path: in_path(&pair.depth), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rgbd_source::RgbdSource;
    use linkage_frames::frame::ColorImage;
    use std::io::Write;
    use zip::write::SimpleFileOptions;

    const METADATA_TEXT: &str = r#"{"w":16,"h":24,"dw":4,"dh":6,"fps":60,
        "K":[20,0,0, 0,20,0, 7.5,11.5,1],"frameTimestamps":[0.0,0.05,0.1]}"#;

    /// What a file of these frames holds; all is a metre away, the first reading is unsure.
    fn entries(frames: &[u64]) -> Vec<(String, Vec<u8>)> {
        let color = ColorImage::new(16, 24, vec![90; 16 * 24 * 3]).unwrap();
        let color = jpeg::encode(&color, 90).unwrap();
        let packed = |bytes: &[u8]| {
            let mut packed = Vec::new();
            lzfse_rust::encode_bytes(bytes, &mut packed).unwrap();
            packed
        };
        let depth: Vec<u8> = (0..24).flat_map(|_| 1.0_f32.to_le_bytes()).collect();
        let mut sure = vec![2; 24];
        sure[0] = 0;
        let mut entries = vec![("metadata".to_owned(), METADATA_TEXT.as_bytes().to_vec())];
        for frame in frames {
            entries.push((color_name(*frame), color.clone()));
            entries.push((depth_name(*frame), packed(&depth)));
            entries.push((format!("rgbd/{frame}.conf"), packed(&sure)));
        }
        entries
    }

    fn zipped(dir: &Path, entries: &[(String, Vec<u8>)]) -> PathBuf {
        let path = dir.join("door.r3d");
        let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
        for (name, bytes) in entries {
            zip.start_file(name, SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap();
        path
    }

    fn unpacked(dir: &Path, entries: &[(String, Vec<u8>)]) -> PathBuf {
        let path = dir.join("door");
        std::fs::create_dir_all(path.join("rgbd")).unwrap();
        for (name, bytes) in entries {
            std::fs::write(path.join(name), bytes).unwrap();
        }
        path
    }

    fn frames(path: &Path) -> Result<Vec<RgbdFrame>, SourceError> {
        let mut source = open(path, None)?;
        std::iter::from_fn(|| source.next_frame().transpose()).collect()
    }

    #[test]
    fn a_file_and_its_folder_give_the_same_frames_at_their_times() {
        let dir = tempfile::tempdir().unwrap();
        let entries = entries(&[0, 1, 2]);
        let [of_file, of_folder] = [zipped(dir.path(), &entries), unpacked(dir.path(), &entries)]
            .map(|p| frames(&p).unwrap());
        let utimes = |frames: &[RgbdFrame]| frames.iter().map(|f| f.utime).collect::<Vec<_>>();
        assert_eq!(utimes(&of_file), [0, 50_000, 100_000]);
        assert_eq!(utimes(&of_folder), utimes(&of_file));
        for frame in of_file.iter().chain(&of_folder) {
            let camera = &frame.camera;
            assert_eq!([camera.fx, camera.fy, camera.cx, camera.cy], [20.0, 20.0, 7.5, 11.5]);
            assert_eq!(camera.depth_sensor, DepthSensor::TimeOfFlight);
            assert_eq!((frame.depth.width(), frame.depth.height()), (16, 24));
            assert_eq!(frame.depth.at(15, 23), Some(1.0));
            assert!(frame.depth.at(3, 3).is_none(), "what is unsure is no reading");
            assert_eq!(frame.depth.at(4, 3), Some(1.0));
        }
    }

    #[test]
    fn a_frame_without_depth_or_without_a_time_is_left_out_and_counted() {
        let dir = tempfile::tempdir().unwrap();
        let mut entries = entries(&[0, 1, 2, 3]);
        entries.retain(|(name, _)| name != "rgbd/1.depth");
        let source = open(&zipped(dir.path(), &entries), None).unwrap();
        assert_eq!((source.frame_count(), source.statistics().unpaired), (Some(2), 2));
    }

    #[test]
    fn what_is_missing_or_damaged_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let whole = entries(&[0, 1]);
        let said = |entries: &[(String, Vec<u8>)]| {
            frames(&zipped(dir.path(), entries)).unwrap_err().to_string()
        };
        let replaced = |name: &str, bytes: &[u8]| {
            let of = |entry: &(String, Vec<u8>)| match entry.0 == name {
                true => (name.to_owned(), bytes.to_vec()),
                false => entry.clone(),
            };
            said(&whole.iter().map(of).collect::<Vec<_>>())
        };
        assert!(said(&whole[1..]).contains("metadata"));
        assert!(said(&whole[..1]).contains("holds no frame"));
        assert!(replaced("metadata", b"{}").contains("metadata: "));
        for name in ["rgbd/1.jpg", "rgbd/1.depth", "rgbd/1.conf"] {
            assert!(replaced(name, b"nothing").contains(name), "{name}");
        }
        std::fs::write(dir.path().join("x.r3d"), "nothing").unwrap();
        let error = open(&dir.path().join("x.r3d"), None).err().unwrap().to_string();
        assert!(error.contains("x.r3d: "), "{error}");
    }

    #[test]
    fn pictures_of_another_size_than_described_have_scaled_intrinsics() {
        let metadata = metadata::parse(METADATA_TEXT.as_bytes()).unwrap();
        let camera = camera(&metadata, (32, 48));
        assert_eq!([camera.fx, camera.cx], [40.0, 15.5]);
    }
}
