//! Configuration of the feature tracker (paper, section III-A).

use super::depth_lift::DepthLift;
use super::descriptor::DescriptorKind;
use super::flow::FlowMethod;
use crate::explained_config::explained_config;

explained_config! {
    /// Values of the tracking stage.
    pub struct TrackConfig {
        /// Features kept alive. The paper's, III-A: up to 1500. Set by the profiles and the ablation.
        pub max_features: usize = 2000,
        /// Corner quality relative to the best corner (0 to 1). The paper's, III-A: 0.04. Ours is
        /// lower and spread over cells, so that the strongest texture does not take all places. Set by
        /// the profiles.
        pub quality: f64 = 0.002,
        /// Pyramid levels on which corners are sought. The paper's: "multiple image scales". Set by
        /// the profiles.
        pub scales: usize = 1,
        /// At most this many features in a cell of 32 x 32 pixels; 0: no limit (paper). Set by the
        /// profiles.
        pub max_per_cell: usize = 12,
        /// New features are sought every so many frames. Ours: 2, new surfaces get tracks at once. Set
        /// by the profiles.
        pub detect_every: usize = 2,
        /// Flow that predicts features: "lucas_kanade" or "farneback" (the paper's). Set by the
        /// profiles.
        pub flow: FlowMethod = FlowMethod::LucasKanade,
        /// Largest forward-backward error in pixels (Kalal et al. 2010). Original code: 1.0. Set by
        /// the profiles and the ablation.
        pub max_forward_backward_px: f64 = 0.6,
        /// Descriptor that verifies a feature at its predicted place: "none", "sift" or "surf" (the
        /// paper's). Set by the profiles and the ablation.
        pub descriptor: DescriptorKind = DescriptorKind::None,
        /// Distance within which a fresh corner moves a prediction half way to itself, pixels; 0: off.
        /// Set by the profiles.
        pub reinforce_px: f64 = 0.0,
        /// How depth is read at a feature: "robust_mean" (ours), or from the bilaterally filtered
        /// picture (the paper's, III-A), bilateral.sigma_s_px wide in pixels and bilateral.sigma_r_m
        /// in metres. Set by the profiles and the ablation.
        pub lift: DepthLift = DepthLift::RobustMean,
        /// Most frames of a demonstration that are kept: bounds memory, with 2000 features to 0.9 GB.
        /// A longer one goes on; of its frames those in which little moves are forgotten. Set where
        /// memory is scarce.
        pub max_frames: usize = 1500,
    }
}
