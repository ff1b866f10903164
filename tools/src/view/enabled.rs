//! An open view: messages go into a file, to connected viewers, or both.

use super::cloud::{Dot, cloud};
use super::convert::{nanoseconds, pose, timestamp};
use super::door::{Door, hidden_address};
use super::file::{CheckedFile, Fault, Unfinished};
use super::frame_names::{self, CAMERA};
use super::pictures;
use super::readings::{readings, states};
use super::scene;
use super::shown::{Configuration, Shown, with_frames_of_their_own};
use super::topics::Topics;
use super::wanted::Wanted;
use crate::console::say;
use crate::outcome::Outcome;
use crate::report::{deviations_by_frame, part_colour, summary};
use anyhow::{Context as _, anyhow};
use foxglove::messages::log::Level;
use foxglove::messages::{FrameTransforms, Log, PoseInFrame};
use foxglove::{Context, McapWriteOptions, McapWriterHandle, WebSocketServerHandle};
use linkage_driver::RgbdFrame;
use linkage_skill::object::{Appearance, StoredObject};
use linkage_skill::recognise::Recognition;
use linkage_skill::{Demonstration, Joint, ObjectModel, Pose, pose_from_array};
use nalgebra::Point3;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Messages that wait for a viewer; when more come, the oldest are dropped.
const BACKLOG: usize = 64;
/// Size of a chunk of the file, bytes.
const CHUNK_BYTES: u64 = 16 << 20;
/// Objects of a frame that are shown, the best first.
const MOST_OBJECTS: usize = 16;
/// One of this many frames of a demonstration shows the parts at their target.
const GHOST_EVERY: usize = 15;
/// Opacity of a part that is not there yet, of 255.
const GHOST: u8 = 110;
/// Colour of what is followed and of no part.
const OF_NO_PART: [u8; 3] = [160, 160, 160];

/// Where messages go.
pub struct View {
    pub(super) topics: Topics,
    file: Option<OpenFile>,
    server: Option<Server>,
    _context: Arc<Context>,
}

/// The server of viewers, and the address at which they find it.
struct Server {
    handle: WebSocketServerHandle,
    _door: Door,
}

struct OpenFile {
    path: PathBuf,
    writer: McapWriterHandle<CheckedFile>,
    fault: Fault,
    unfinished: Unfinished,
}

impl View {
    /// Opens what is wanted; `None` where nothing is.
    pub fn open(wanted: &Wanted) -> Outcome<Option<Self>> {
        if wanted.mcap.is_none() && wanted.address.is_none() {
            return Ok(None);
        }
        let context = Context::new();
        let file = wanted.mcap.as_deref().map(|path| create(&context, path)).transpose()?;
        let server = wanted.address.as_deref().map(|at| listen(&context, at)).transpose()?;
        Ok(Some(Self { topics: Topics::new(&context), file, server, _context: context }))
    }

    /// Shows a frame.
    pub fn frame(&self, frame: &RgbdFrame) {
        let (topics, at) = (&self.topics, nanoseconds(frame.utime));
        if topics.color.has_sinks() {
            match pictures::color(frame) {
                Ok(color) => topics.color.log_with_time(&color, at),
                Err(reason) => tracing::warn!("a frame is not shown: {reason}"),
            }
        }
        if topics.depth.has_sinks() {
            topics.depth.log_with_time(&pictures::depth(frame), at);
        }
        topics.calibration.log_with_time(&pictures::calibration(frame.utime, &frame.camera), at);
        let upright = vec![pictures::upright_from_camera(frame.utime)];
        topics.upright.log_with_time(&FrameTransforms { transforms: upright }, at);
    }

    /// Shows what was learned in each frame of its demonstration. `appearance`: what was learned from
    /// this demonstration alone.
    pub fn demonstration(&self, seen: &Demonstration, appearance: Option<&Appearance>) {
        let model = &seen.model;
        let deviations: Vec<_> =
            model.joints.iter().map(|j| deviations_by_frame(seen, appearance, j)).collect();
        for (index, &utime) in seen.frame_utimes.iter().enumerate() {
            let poses = seen.camera_from_part.iter().map(|t| t.get(index).copied().flatten());
            let mut shown = Shown::learned(model, poses.collect(), appearance);
            let known = |(joint, by_frame): (&Joint, &Vec<Option<f64>>)| {
                let q = configuration_in_frame(joint, utime)?;
                Some(Configuration { q, deviation: by_frame.get(index).copied().flatten() })
            };
            shown.configurations = model.joints.iter().zip(&deviations).map(known).collect();
            let tracks = seen.tracks.tracks.iter().zip(&seen.track_parts);
            let dots = tracks.filter_map(|(t, part)| Some((*part, t.at(index)?.point_in_camera?)));
            self.tracks(utime, dots);
            self.objects(utime, std::slice::from_ref(&shown));
            if index % GHOST_EVERY == 0
                && let Some(appearance) = appearance
            {
                self.ghost_at_open(utime, model, appearance);
            }
        }
        let last = seen.frame_utimes.last().copied().unwrap_or_default();
        summary(model).lines().for_each(|line| self.say(last, false, line));
        for refused in &seen.rejections {
            let (kind, reason) = (refused.kind.name(), &refused.reason);
            self.say(last, false, &format!("refused a candidate, {kind}: {reason}"));
        }
    }

    /// Shows what was recognised in a frame, and the parts at the ends of their ranges.
    pub fn recognition(&self, utime: i64, found: &Recognition, objects: &[StoredObject]) {
        self.recognised(utime, found, |name| objects.iter().find(|o| o.model.object == name));
        let best = found.matches.first();
        if let Some(object) = best.and_then(|m| objects.iter().find(|o| o.model.object == m.object))
        {
            self.ghost_at_open(utime, &object.model, &object.appearance);
        }
    }

    /// Says something at a time.
    pub fn say(&self, utime: i64, is_warning: bool, text: &str) {
        let level = if is_warning { Level::Warning } else { Level::Info };
        let line = Log {
            timestamp: Some(timestamp(utime)),
            level: level.into(),
            message: text.to_owned(),
            name: "linkage".to_owned(),
            ..Log::default()
        };
        self.topics.log.log_with_time(&line, nanoseconds(utime));
    }

    /// Finishes the file and disconnects the viewers.
    pub fn close(self) -> Outcome {
        if let Some(server) = self.server {
            // Viewers that are slow are not waited for.
            drop(server.handle.stop());
        }
        let Some(OpenFile { path, writer, fault, unfinished }) = self.file else {
            return Ok(());
        };
        let closed = writer.close().map(drop);
        // A service that filled the disk leaves what it wrote.
        unfinished.finish();
        if let Some(fault) = fault.take() {
            return Err(anyhow!("{}: cannot be written: {fault}", path.display()).into());
        }
        closed.with_context(|| format!("{}: cannot be written", path.display()))?;
        Ok(())
    }

    /// Shows what was recognised.
    pub(super) fn recognised<'o>(
        &self,
        utime: i64,
        found: &Recognition,
        object: impl Fn(&str) -> Option<&'o StoredObject>,
    ) {
        let at = nanoseconds(utime);
        let known = found.matches.iter().take(MOST_OBJECTS);
        let known: Vec<_> = known.filter_map(|m| Some((m, object(&m.object)?))).collect();
        let shown = known.iter().map(|(m, o)| Shown::recognised(&o.model, m, Some(&o.appearance)));
        let shown = with_frames_of_their_own(shown.collect());
        let dots = known.iter().zip(&shown).flat_map(|((_, object), shown)| {
            surface(&object.appearance, &shown.camera_from_part, 255)
        });
        self.topics.surface.log_with_time(&cloud(utime, CAMERA, dots), at);
        self.objects(utime, &shown);
        let best = found.matches.first().and_then(|m| pose_from_array(&m.camera_from_object));
        if let Some(camera_from_object) = best {
            let message = PoseInFrame {
                timestamp: Some(timestamp(utime)),
                frame_id: CAMERA.to_owned(),
                pose: Some(pose(&camera_from_object)),
            };
            self.topics.pose.log_with_time(&message, at);
        }
    }

    /// Shows places that are followed, with their parts where these are known.
    pub(super) fn tracks(
        &self,
        utime: i64,
        places: impl IntoIterator<Item = (Option<usize>, Point3<f64>)>,
    ) {
        let dots = places.into_iter().map(|(part, place)| {
            let [r, g, b] = part.map_or(OF_NO_PART, part_colour);
            (place, [r, g, b, 255])
        });
        self.topics.tracks.log_with_time(&cloud(utime, CAMERA, dots), nanoseconds(utime));
    }

    /// Shows where the parts of objects are, their joints, and how far these are.
    pub(super) fn objects(&self, utime: i64, shown: &[Shown]) {
        let (topics, at) = (&self.topics, nanoseconds(utime));
        let transforms = shown.iter().flat_map(|s| scene::transforms(utime, s)).collect();
        topics.transforms.log_with_time(&FrameTransforms { transforms }, at);
        topics.joints.log_with_time(&scene::joints(utime, shown), at);
        let readings = readings(shown);
        topics.states.log_with_time(&states(utime, &readings), at);
        topics.readings.log_with_time(&readings, at);
    }

    /// Shows moving parts somewhere else: `object_from_part` of each part that moves there.
    pub(super) fn ghost(
        &self,
        utime: i64,
        object: &str,
        appearance: &Appearance,
        object_from_part: &[Option<Pose>],
    ) {
        let dots = surface(appearance, object_from_part, GHOST);
        let frame = frame_names::of_object(object);
        self.topics.ghost.log_with_time(&cloud(utime, &frame, dots), nanoseconds(utime));
    }

    /// The same, at the ends of the ranges that are farthest from where demonstrations began.
    fn ghost_at_open(&self, utime: i64, model: &ObjectModel, appearance: &Appearance) {
        let farthest = |joint: &Joint| {
            let [low, high] = joint.range;
            if high.abs() >= low.abs() { high } else { low }
        };
        let open: Vec<f64> = model.joints.iter().map(farthest).collect();
        let mut motions: Vec<_> = model.part_motions(&open).into_iter().map(Some).collect();
        if let Some(base) = motions.first_mut() {
            *base = None;
        }
        self.ghost(utime, &model.object, appearance, &motions);
    }
}

/// The learned surface of parts, each moved by its pose; those without one are left out.
fn surface<'a>(
    appearance: &'a Appearance,
    frame_from_part: &'a [Option<Pose>],
    opacity: u8,
) -> impl Iterator<Item = Dot> + 'a {
    appearance.surfels.iter().filter_map(move |s| {
        let pose = frame_from_part.get(usize::from(s.part))?.as_ref()?;
        let [r, g, b] = part_colour(usize::from(s.part));
        Some((pose * Point3::from(s.point.map(f64::from)), [r, g, b, opacity]))
    })
}

/// The configuration that a joint was seen at in a frame.
fn configuration_in_frame(joint: &Joint, utime: i64) -> Option<f64> {
    // Model times are seconds: half a microsecond is lost on the way.
    let stamp = |[t, _]: &[f64; 2]| (t * 1e6).round() as i64;
    let next = joint.configuration.partition_point(|c| stamp(c) < utime);
    joint.configuration.get(next).filter(|c| stamp(c) == utime).map(|c| c[1])
}

/// Begins a new file.
fn create(context: &Arc<Context>, path: &Path) -> Outcome<OpenFile> {
    let named = || path.display().to_string();
    let file = File::create_new(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::AlreadyExists => {
            anyhow!("{}: exists already; name another file or remove it", named())
        }
        _ => anyhow::Error::new(e).context(format!("{}: cannot be made", named())),
    })?;
    let (fault, unfinished) = (Fault::default(), Unfinished::new(path));
    // Few large chunks: an index of each is kept in memory until the file ends.
    let options = McapWriteOptions::new().chunk_size(Some(CHUNK_BYTES));
    let writer = context.mcap_writer_with_options(options);
    let writer = writer.create(CheckedFile::new(file, fault.clone()));
    let writer = writer.with_context(|| format!("{}: cannot be written", named()))?;
    Ok(OpenFile { path: path.to_owned(), writer, fault, unfinished })
}

/// Waits for viewers.
fn listen(context: &Arc<Context>, address: &str) -> Outcome<Server> {
    let (host, port) = host_and_port(address)?;
    let taken =
        || format!("--view {address}: cannot listen there; is the port taken? name another one");
    let (door, listener) = Door::open(host, port).with_context(taken)?;
    let inside = hidden_address();
    let server = context.websocket_server().name("linkage").message_backlog_size(BACKLOG);
    let handle = server.bind(inside.to_string(), 0).start_blocking().with_context(taken)?;
    door.lead_to(listener, (inside, handle.port()).into(), host);
    let host = if host.contains(':') { format!("[{host}]") } else { host.to_owned() };
    say(format!("a viewer finds ws://{host}:{}", door.address().port()));
    Ok(Server { handle, _door: door })
}

/// `HOST:PORT` in two pieces; an IPv6 address stands in brackets.
fn host_and_port(address: &str) -> anyhow::Result<(&str, u16)> {
    let wrong = || anyhow!("--view {address}: give HOST:PORT, such as 127.0.0.1:8765");
    let (host, port) = address.rsplit_once(':').ok_or_else(wrong)?;
    let host = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
    let port = port.parse().map_err(|_| wrong())?;
    if host.is_empty() { Err(wrong()) } else { Ok((host, port)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera};

    #[test]
    fn an_address_is_a_host_and_a_port() {
        assert_eq!(host_and_port("127.0.0.1:8765").unwrap(), ("127.0.0.1", 8765));
        assert_eq!(host_and_port("[::1]:80").unwrap(), ("::1", 80));
        for wrong in ["8765", "localhost", ":8765", "host:", "host:70000"] {
            let said = host_and_port(wrong).unwrap_err().to_string();
            assert!(said.contains("HOST:PORT"), "{said}");
        }
    }

    #[test]
    fn a_file_that_exists_is_not_written_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("kept.mcap");
        std::fs::write(&path, "kept").unwrap();
        let wanted = Wanted { mcap: Some(path.clone()), address: None };
        let refused = View::open(&wanted).err().unwrap().cause.to_string();
        assert!(refused.contains("kept.mcap: exists already"), "{refused}");
        assert_eq!(std::fs::read_to_string(path).unwrap(), "kept");
    }

    #[test]
    fn what_a_view_has_written_is_a_recording_that_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("seen.mcap");
        let camera = PinholeCamera { width: 64, height: 48, ..PinholeCamera::kinect() };
        let camera = PinholeCamera { fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5, ..camera };
        let frame = |i: i64| {
            let (camera, count) = (Arc::new(camera.clone()), camera.width * camera.height);
            let raw: Vec<u16> = (0..count).map(|k| 1000 + k as u16).collect();
            let depth = DepthImage::from_raw(camera.width, camera.height, &raw, 1000.0).unwrap();
            let color = ColorImage::new(camera.width, camera.height, vec![90; 3 * count]).unwrap();
            RgbdFrame::new(1_700_000_000_000_000 + 33_333 * i, camera, color, depth).unwrap()
        };
        let written: Vec<RgbdFrame> = (0..4).map(frame).collect();
        let wanted = Wanted { mcap: Some(path.clone()), address: None };
        let view = View::open(&wanted).ok().flatten().unwrap();
        written.iter().for_each(|frame| view.frame(frame));
        view.say(written[3].utime, false, "that is all");
        view.close().ok().unwrap();
        let mut source = linkage_driver::open(&path.display().to_string()).unwrap();
        for frame in &written {
            let read = source.next_frame().unwrap().unwrap();
            assert_eq!(read.utime, frame.utime);
            assert_eq!(read.depth.to_raw(1000.0), frame.depth.to_raw(1000.0));
            let is_near = |(a, b): (&u8, &u8)| a.abs_diff(*b) <= 2;
            assert!(read.color.as_rgb().iter().zip(frame.color.as_rgb()).all(is_near));
            let units = PinholeCamera { depth_units_per_metre: 1000.0, ..camera.clone() };
            assert_eq!(*read.camera, units);
        }
        assert!(source.next_frame().unwrap().is_none());
    }

    #[test]
    fn a_configuration_is_that_of_its_very_frame() {
        use linkage_skill::object::JointGeometry;
        let line = JointGeometry::hinge(nalgebra::Vector3::y_axis(), Point3::origin());
        let configuration = vec![[1_700_000_000.033_333, 0.1], [1_700_000_000.1, 0.2]];
        let joint = Joint { configuration, ..Joint::of(&line) };
        assert_eq!(configuration_in_frame(&joint, 1_700_000_000_033_333), Some(0.1));
        assert_eq!(configuration_in_frame(&joint, 1_700_000_000_066_667), None);
        assert_eq!(configuration_in_frame(&joint, 1_700_000_000_100_000), Some(0.2));
    }
}
