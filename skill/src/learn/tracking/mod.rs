//! Spatio-temporal feature tracking (paper, section III-A): corners are found at several
//! scales, predicted by optical flow, checked by flow failure detection and by their
//! description, reinforced by fresh detections, replaced where none are left, and lifted to
//! 3-D with position and normal.

mod corners;
mod depth_lift;
mod descriptor;
mod flow;
mod lucas_kanade;
mod surf;
mod thin;
mod tracker;

pub use depth_lift::{DepthLift, Lifter};
pub use descriptor::{DescriptorKind, Descriptors, describe};
pub use flow::{FlowMethod, Picture, Prediction};
pub use surf::{Surf, SurfPoint};
pub use thin::telling_frames;
pub use tracker::Tracker;

use crate::math::rigid::Pose;
use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Values of the tracking stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackConfig {
    /// Features kept alive. The paper's, III-A: up to 1500.
    pub max_features: usize,
    /// Corner quality relative to the best corner. The paper's, III-A: 0.04. Ours is lower
    /// and spread over cells, so that the strongest texture does not take all places.
    pub quality: f64,
    /// Pyramid levels on which corners are sought. The paper's: "multiple image scales".
    pub scales: usize,
    /// Free radius round a feature, in pixels: the detection mask.
    pub spacing_px: f64,
    /// At most this many features in a cell of 32 x 32 pixels; 0: no limit (paper).
    pub max_per_cell: usize,
    /// New features are sought every so many frames. Ours: 2, new surfaces get tracks at once.
    pub detect_every: usize,
    /// Flow that predicts features. The paper's: Farneback.
    pub flow: FlowMethod,
    /// Largest forward-backward error in pixels (Kalal et al. 2010). Original code: 1.0.
    pub max_forward_backward_px: f64,
    /// Descriptor that verifies a feature at its predicted place.
    pub descriptor: DescriptorKind,
    /// Largest distance between unit descriptors of one feature. Ours.
    pub max_descriptor_distance: f64,
    /// A fresh corner within this distance of a prediction replaces it, in pixels; 0: off.
    pub reinforce_px: f64,
    /// How depth is read at a feature.
    pub lift: DepthLift,
    /// Fewest observations of a track that takes part in learning. Original code: 5.
    pub min_length: usize,
    /// Most frames of a demonstration that are kept: bounds memory, with 2000 features to 0.9 GB.
    /// A longer one goes on; of its frames those in which little moves are forgotten.
    pub max_frames: usize,
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self {
            max_features: 2000,
            quality: 0.002,
            scales: 1,
            spacing_px: 6.0,
            max_per_cell: 12,
            detect_every: 2,
            flow: FlowMethod::LucasKanade,
            max_forward_backward_px: 0.6,
            descriptor: DescriptorKind::None,
            max_descriptor_distance: 0.45,
            reinforce_px: 0.0,
            lift: DepthLift::RobustMean,
            min_length: 6,
            max_frames: 1500,
        }
    }
}

/// What was seen of a feature in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Place in the picture, pixels.
    pub pixel: Point2<f32>,
    /// Place in the camera frame, metres; `None` where depth has no reading or an edge.
    pub point_in_camera: Option<Point3<f64>>,
    /// Unit surface normal in the camera frame, towards the camera.
    pub normal_in_camera: Option<Vector3<f64>>,
}

/// A feature followed through consecutive frames.
#[derive(Debug, Clone)]
pub struct Track {
    /// Number in order of birth; stays when other tracks are dropped.
    pub id: usize,
    /// Index of its first frame.
    pub first_frame: usize,
    /// One observation a frame from there on.
    pub observations: Vec<Observation>,
}

impl Track {
    /// What was seen in a frame; `None` before the track's birth and after its end.
    pub fn at(&self, frame: usize) -> Option<&Observation> {
        self.observations.get(frame.checked_sub(self.first_frame)?)
    }

    /// Frame after the last.
    pub fn end_frame(&self) -> usize {
        self.first_frame + self.observations.len()
    }

    /// Lifted in at least `min_length` frames.
    pub fn is_long(&self, min_length: usize) -> bool {
        self.lifted().nth(min_length.saturating_sub(1)).is_some()
    }

    /// Frames in which the track has a place in 3-D.
    pub fn lifted(&self) -> impl Iterator<Item = (usize, Point3<f64>)> + '_ {
        self.observations
            .iter()
            .enumerate()
            .filter_map(|(i, o)| Some((self.first_frame + i, o.point_in_camera?)))
    }
}

/// All tracks of a recording.
#[derive(Debug, Clone, Default)]
pub struct TrackSet {
    /// Time of each frame, microseconds.
    pub frame_utimes: Vec<i64>,
    /// The tracks, in order of their birth.
    pub tracks: Vec<Track>,
}

impl TrackSet {
    /// Frames seen.
    pub fn frames(&self) -> usize {
        self.frame_utimes.len()
    }

    /// `[t, q]` of configurations in frames: seconds and configuration.
    pub fn timed(&self, frames: &[usize], configuration: &[f64]) -> Vec<[f64; 2]> {
        frames
            .iter()
            .zip(configuration)
            .map(|(&f, &q)| [self.frame_utimes[f] as f64 * 1e-6, q])
            .collect()
    }

    /// Keeps tracks that were lifted in at least `min_length` frames.
    pub fn retain_long(&mut self, min_length: usize) {
        self.tracks.retain(|t| t.is_long(min_length));
    }
}

/// A pose for each frame in which one is known.
pub type Trajectory = Vec<Option<Pose>>;
