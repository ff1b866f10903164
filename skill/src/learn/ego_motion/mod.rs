//! Estimates the motion of the camera relative to the base: the rigid, static scene that most of
//! the image shows. It is estimated first, so that a moving camera is handled by construction and
//! all else is seen in one static frame.
//!
//! In: the features of each frame that have depth, in the camera frame, metres.
//! Out: `camera_from_base` for each frame, and all tracks in the base frame, which is the camera
//! frame of the first frame.
//! From: registration to a map of points by RANSAC (MSAC score) and reweighted least squares. The
//! map point of a track is the running mean of its places in the base frame. Map points of moving
//! parts and of the person are wrong, but have little weight. Where most features move, the pose by the other
//! features, or the pose of the frame before, is taken if the surface of the first frame supports it more.

mod first_surface;
mod fixed_camera;
mod observation;

use super::tracking::{Track, TrackId, TrackSet};
use crate::math::ransac::{Correspondence, RansacOptions, ransac_rigid};
use crate::math::rigid::Pose;
use crate::math::robust::median_point;
use first_surface::FirstSurface;
use fixed_camera::FixedCamera;
use linkage_frames::RgbdFrame;
use linkage_frames::depth::DepthSensor;
use nalgebra::Point3;
pub use observation::BaseObservation;
#[cfg(test)]
pub use observation::Information;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// Number of RANSAC samples per frame.
const RANSAC_ITERATIONS: usize = 30;
/// Largest number of points that determine the pose of a frame; of more, some are drawn at random.
const MAX_POINTS: usize = 900;
/// Smallest extent of a moving track's smoothed path, metres. Ours.
pub const MIN_EXTENT_M: f64 = 0.015;
/// Smallest extent of a moving track's smoothed path, in standard deviations of its noise. Ours.
pub const MIN_EXTENT_SIGMAS: f64 = 4.0;

/// A track in the base frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrackInBase {
    /// Identity of the track.
    pub id: TrackId,
    /// Frame of the first of `points`.
    pub first_frame: usize,
    /// Observation in the base frame, one for each frame; `None` without depth.
    pub points: Vec<Option<BaseObservation>>,
    /// True if the path is longer than noise explains.
    pub moves: bool,
}

impl TrackInBase {
    /// The observation in a frame, if there is one.
    pub fn at(&self, frame: usize) -> Option<&BaseObservation> {
        self.points.get(frame.checked_sub(self.first_frame)?)?.as_ref()
    }

    /// Number of the frame after the last of `points`.
    pub fn end_frame(&self) -> usize {
        self.first_frame + self.points.len()
    }

    /// Observations, each with its frame.
    #[cfg(feature = "paper")]
    pub fn seen(&self) -> impl Iterator<Item = (usize, &BaseObservation)> {
        let first = self.first_frame;
        self.points.iter().enumerate().filter_map(move |(i, p)| Some((first + i, p.as_ref()?)))
    }
}

/// Motion of the camera, and every track in the base frame.
#[derive(Debug, Clone, Default)]
pub struct EgoMotion {
    /// Pose of the base in the camera, for each frame; identity in the first.
    pub camera_from_base: Vec<Pose>,
    /// Tracks in the base frame, as many as the tracks that they were made from, in the same order;
    /// those that have ended are shared with the motion that this one extends.
    pub tracks: Vec<Arc<TrackInBase>>,
    /// Number of tracks that do not move in the base frame.
    pub static_count: usize,
}

struct MapPoint {
    mean_in_base: Point3<f64>,
    count: f64,
    agreed: f64,
    disagreed: f64,
}

/// Registers frames to the base as they arrive.
pub struct EgoMotionEstimator {
    rng: ChaCha8Rng,
    /// Map point of each track, by the number of the track.
    map: Vec<Option<MapPoint>>,
    camera_from_base: Vec<Pose>,
    first_surface: FirstSurface,
    fixed_camera: FixedCamera,
}

impl EgoMotionEstimator {
    /// Creates an estimator without frames.
    pub fn new(seed: u64) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed),
            map: Vec::new(),
            camera_from_base: Vec::new(),
            first_surface: FirstSurface::default(),
            fixed_camera: FixedCamera::default(),
        }
    }

    /// Registers the next frame. `lifted` holds the features of the frame that have depth: the
    /// numbers of their tracks, and their places in the camera frame, metres.
    pub fn push(&mut self, lifted: &[(usize, Point3<f64>)], frame: &RgbdFrame) {
        let sensor = frame.camera.depth_sensor;
        let is_fixed = self.fixed_camera.push(lifted, frame);
        let pose = match self.camera_from_base.last().copied() {
            Some(before) if !is_fixed => self.register(lifted, frame, &before),
            _ => Pose::identity(),
        };
        if self.first_surface.is_little() {
            self.first_surface = FirstSurface::of(frame, &pose);
        }
        self.camera_from_base.push(pose);
        for (track, in_camera) in lifted {
            if self.map.len() <= *track {
                self.map.resize_with(track + 1, || None);
            }
            let in_base = pose.inverse_transform_point(in_camera);
            match &mut self.map[*track] {
                None => self.map[*track] = Some(MapPoint::new(in_base)),
                Some(mapped) => {
                    mapped.update(in_base, 3.0 * sensor.feature_sigma(in_camera.z));
                }
            }
        }
    }

    /// Pose that most features follow, or another one that the first frame's surface supports clearly more: the pose
    /// that the other features follow, or that of the frame `before`.
    fn register(
        &mut self,
        lifted: &[(usize, Point3<f64>)],
        frame: &RgbdFrame,
        before: &Pose,
    ) -> Pose {
        let mut pairs = self.pairs(lifted, frame.camera.depth_sensor);
        if pairs.len() > MAX_POINTS {
            pairs.shuffle(&mut self.rng);
            pairs.truncate(MAX_POINTS);
        }
        let options = RansacOptions { cut: 3.0, iterations: RANSAC_ITERATIONS, locality: None };
        let Some(most) = ransac_rigid(&pairs, &options, Some(before), &mut self.rng) else {
            return *before;
        };
        let mut follows_most = vec![false; pairs.len()];
        most.inliers.iter().for_each(|&i| follows_most[i] = true);
        let others: Vec<Correspondence> =
            (0..pairs.len()).filter(|&i| !follows_most[i]).map(|i| pairs[i]).collect();
        // A generator of its own: the samples of later frames do not depend on the number of other features.
        let mut rng = ChaCha8Rng::seed_from_u64(self.camera_from_base.len() as u64);
        let by_others = ransac_rigid(&others, &options, Some(before), &mut rng);
        let mut poses = vec![most.motion];
        poses.extend(by_others.map(|found| found.motion));
        poses.push(*before);
        let best = self.first_surface.best_of(frame, &poses);
        if best > 0 {
            tracing::debug!(best, frame = self.camera_from_base.len(), "most features move");
        }
        poses[best]
    }

    /// Features that have a map point, from the map to the camera.
    fn pairs(&self, lifted: &[(usize, Point3<f64>)], sensor: DepthSensor) -> Vec<Correspondence> {
        let mapped = |track: usize| self.map.get(track)?.as_ref();
        let pair = |(track, in_camera): &(usize, Point3<f64>)| {
            let mapped = mapped(*track)?;
            let proven = mapped.agreed > 4.0 * mapped.disagreed + 4.0;
            Some(Correspondence {
                from: mapped.mean_in_base,
                to: *in_camera,
                sigma: sensor.feature_sigma(in_camera.z),
                weight: if proven { 1.0 } else { 0.1 },
            })
        };
        lifted.iter().filter_map(pair).collect()
    }

    /// Removes the frames that are not marked, and the map points of tracks without a new number.
    pub fn keep_frames(&mut self, marks: &[bool], numbers: &[Option<usize>]) {
        let mut marked = marks.iter();
        self.camera_from_base.retain(|_| *marked.next().unwrap_or(&true));
        let mut number = numbers.iter();
        self.map.retain(|_| number.next().is_some_and(Option::is_some));
        self.fixed_camera.keep_tracks(numbers);
    }

    /// Pose of the base in the camera, for each frame so far.
    pub fn camera_from_base(&self) -> &[Pose] {
        &self.camera_from_base
    }
}

impl EgoMotion {
    /// Extends the motion by the frames that were seen since. `set` holds the tracks of this
    /// motion, or some of them, and later ones; `camera_from_base` holds the poses of all frames.
    /// Observations that are in the base frame already are reused.
    pub fn extended(
        &self,
        set: &TrackSet,
        camera_from_base: Vec<Pose>,
        sensor: DepthSensor,
    ) -> Self {
        let before: HashMap<TrackId, &Arc<TrackInBase>> =
            self.tracks.iter().map(|t| (t.id, t)).collect();
        let tracks: Vec<Arc<TrackInBase>> = set
            .tracks
            .par_iter()
            .map(|track| match before.get(&track.id) {
                Some(known) if known.points.len() == track.observations.len() => Arc::clone(known),
                Some(known) => Arc::new(into_base(track, &known.points, &camera_from_base, sensor)),
                None => Arc::new(into_base(track, &[], &camera_from_base, sensor)),
            })
            .collect();
        let static_count = tracks.iter().filter(|t| !t.moves).count();
        Self { camera_from_base, tracks, static_count }
    }
}

impl MapPoint {
    fn new(in_base: Point3<f64>) -> Self {
        Self { mean_in_base: in_base, count: 1.0, agreed: 0.0, disagreed: 0.0 }
    }

    fn update(&mut self, in_base: Point3<f64>, reach: f64) {
        if (in_base - self.mean_in_base).norm() < reach {
            self.agreed += 1.0;
            self.count = (self.count + 1.0).min(60.0);
            self.mean_in_base += (in_base - self.mean_in_base) / self.count;
        } else {
            self.disagreed += 1.0;
        }
    }
}

/// The track in the base frame; `known` are its first points, which are in the base frame already.
fn into_base(
    track: &Track,
    known: &[Option<BaseObservation>],
    camera_from_base: &[Pose],
    sensor: DepthSensor,
) -> TrackInBase {
    let mut points = Vec::with_capacity(track.observations.len());
    points.extend_from_slice(known);
    let since = track.observations.iter().enumerate().skip(known.len());
    points.extend(since.map(|(i, seen)| {
        let camera_from_base = &camera_from_base[track.first_frame + i];
        Some(BaseObservation::by_camera(&seen.point_in_camera?, camera_from_base, sensor))
    }));
    let moves = extent_exceeds_noise(&points);
    TrackInBase { id: track.id, first_frame: track.first_frame, points, moves }
}

fn extent_exceeds_noise(points: &[Option<BaseObservation>]) -> bool {
    let path: Vec<(Point3<f64>, f64)> =
        points.iter().flatten().map(|p| (p.point, p.sigma())).collect();
    path_moves(&path, MIN_EXTENT_M, MIN_EXTENT_SIGMAS)
}

/// True if a path of (place, standard deviation) is longer than noise explains: its extent exceeds
/// `least_m` metres and `sigmas` times the median deviation. The depth noise at any one place is
/// partly fixed pattern, so whole paths are smoothed before they are measured.
pub fn path_moves(path: &[(Point3<f64>, f64)], least_m: f64, sigmas: f64) -> bool {
    if path.len() < 5 {
        return false;
    }
    let places: Vec<Point3<f64>> = path.iter().map(|p| p.0).collect();
    let smoothed: Vec<Point3<f64>> = (0..places.len())
        .step_by(2)
        .filter_map(|i| median_point(&places[i.saturating_sub(2)..(i + 3).min(places.len())]))
        .collect();
    let Some(centre) = median_point(&smoothed) else { return false };
    let extent = smoothed
        .iter()
        .map(|p| (p - smoothed[0]).norm().max((p - centre).norm()))
        .fold(0.0, f64::max);
    let mut noise: Vec<f64> = path.iter().map(|p| p.1).collect();
    let sigma = crate::math::robust::median(&mut noise).unwrap_or(0.0);
    extent > least_m.max(sigmas * sigma)
}

/// Number of observations (place, standard deviation) before the first two in succession that lie
/// away from the start; a single outlier is not counted.
pub fn rest_length(path: impl Iterator<Item = (Point3<f64>, f64)>) -> usize {
    let mut sum = nalgebra::Vector3::zeros();
    let (mut averaged, mut rested, mut strays) = (0.0, 0, 0);
    for (point, sigma) in path {
        if averaged >= 3.0 && (point.coords - sum / averaged).norm() > (3.0 * sigma).max(0.006) {
            strays += 1;
            if strays >= 2 {
                break;
            }
            continue;
        }
        strays = 0;
        rested += 1;
        if averaged < 20.0 {
            sum += point.coords;
            averaged += 1.0;
        }
    }
    rested
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::tracking::Observation;
    use nalgebra::{Point2, Vector3};

    const FRAMES: usize = 40;

    /// A camera that is carried along.
    fn pose(frame: usize) -> Pose {
        Pose::new(Vector3::x() * 0.001 * frame as f64, Vector3::y() * 0.01)
    }

    /// A point that stays, one that goes, and one that ends early; seen until a frame.
    fn tracks(until: usize) -> TrackSet {
        let track = |id: usize, end: usize, speed: f64| {
            let at = |f: usize| Point3::new(0.1 * id as f64, speed * f as f64, 1.2);
            let seen = |f| Observation {
                pixel: Point2::origin(),
                point_in_camera: Some(pose(f) * at(f)),
                normal_in_camera: None,
            };
            Track {
                id: TrackId(id),
                first_frame: 0,
                observations: (0..end.min(until)).map(seen).collect(),
            }
        };
        TrackSet {
            frame_utimes: (0..until as i64).collect(),
            tracks: vec![track(2, FRAMES, 0.0), track(5, FRAMES, 0.004), track(7, 12, 0.01)],
        }
    }

    #[test]
    fn what_is_extended_is_what_would_have_been_seen_at_once() {
        let poses = |until: usize| (0..until).map(pose).collect::<Vec<_>>();
        let none = EgoMotion::default();
        let early = none.extended(&tracks(15), poses(15), DepthSensor::default());
        let extended = early.extended(&tracks(FRAMES), poses(FRAMES), DepthSensor::default());
        let at_once = none.extended(&tracks(FRAMES), poses(FRAMES), DepthSensor::default());
        assert_eq!(extended.tracks, at_once.tracks);
        assert_eq!(
            extended.tracks.iter().map(|t| t.moves).collect::<Vec<_>>(),
            [false, true, true]
        );
        assert!(Arc::ptr_eq(&extended.tracks[2], &early.tracks[2]), "it had ended");
    }

    #[test]
    fn the_camera_stands_still_though_most_features_turn_with_a_door() {
        use crate::test_data::{board, seen};
        let hinge = Point3::new(-0.3, 0.0, 1.5);
        let turned = |f: usize| {
            let turn = nalgebra::UnitQuaternion::from_scaled_axis(
                0.03 * f.saturating_sub(5) as f64 * Vector3::y(),
            );
            Pose::rotation_wrt_point(turn, hinge)
        };
        let on_door =
            |i: usize| Point3::new(0.05 * (i % 10) as f64 - 0.25, 0.05 * (i / 10) as f64, 1.5);
        let on_wall =
            |i: usize| Point3::new(0.2 * (i % 5) as f64 - 0.5, 0.3 * (i / 5) as f64 - 0.4, 2.5);
        let mut estimator = EgoMotionEstimator::new(1);
        for f in 0..20 {
            let door = (0..60).map(|i| (i, turned(f) * on_door(i)));
            let wall = (0..20).map(|i| (60 + i, on_wall(i)));
            let lifted: Vec<(usize, Point3<f64>)> = door.chain(wall).collect();
            estimator.push(&lifted, &seen(f as i64, board(0.3, 1.5, 2.5)));
        }
        let last = estimator.camera_from_base().last().unwrap();
        assert!(last.rotation.angle() < 0.01 && last.translation.vector.norm() < 0.02, "{last}");
    }
}
