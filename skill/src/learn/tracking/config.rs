//! Configuration of the feature tracker (paper, section III-A).

use super::depth_lift::DepthLift;
use super::descriptor::DescriptorKind;
use super::flow::FlowMethod;
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
