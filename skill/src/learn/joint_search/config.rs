//! Configuration of the joint search.

use crate::explained_config::explained_config;

/// What a search is configured with.
#[derive(Debug, Clone, Copy)]
pub struct SearchSettings<'c> {
    /// The search itself.
    pub joints: &'c JointSearchConfig,
    /// Seed of all random sampling.
    pub seed: u64,
}

explained_config! {
    /// Values of the joint search. All ours, measured on rendered recordings.
    pub struct JointSearchConfig {
        /// Most hypotheses of motion that are grown in one round, for each part in whose frame joints
        /// are sought. Set by the ablation.
        pub max_hypotheses: usize = 12,
        /// Frames for which a track rests at the start or the end of its life if it is an object's; 0:
        /// rest is no evidence. Set by the ablation.
        pub rest_frames: usize = 8,
        /// Largest share (0 to 1) of a joint's points that depth pictures may see through. Set by the
        /// ablation.
        pub max_through: f64 = 0.22,
        /// Largest share (0 to 1) of its points that may be missing in frames of unknown
        /// configuration. Set by the ablation.
        pub max_hidden: f64 = 0.6,
        /// Largest share (0 to 1) of its tracks' observations in frames of unknown configuration. Set
        /// by the ablation.
        pub max_unruly: f64 = 0.3,
        /// Joints are also sought in the frames of parts that move. Set by the ablation.
        pub chains: bool = true,
        /// Hinges that advance as they turn (screws) are told from those that do not. Set by the
        /// ablation.
        pub screws: bool = true,
        /// Segments of time in which one joint was seen are merged. Set by the ablation.
        pub merge: bool = true,
        /// Outlier tracks, which the depth pictures contradict one by one, are taken out of a joint.
        /// Set by the ablation.
        pub dismiss_strangers: bool = true,
    }
}
