//! Configuration of the joint search. `linkage config dump` prints the doc comments of the fields
//! of `JointSearchConfig`.

use crate::explained_config::explained_config;

/// Settings of one search.
#[derive(Debug, Clone, Copy)]
pub struct SearchSettings<'c> {
    /// Limits and switches of the search.
    pub joints: &'c JointSearchConfig,
    /// Seed of all random sampling.
    pub seed: u64,
}

explained_config! {
    /// Limits and switches of the joint search. All are ours, measured on rendered recordings.
    pub struct JointSearchConfig {
        /// Most hypotheses of motion that are grown in one round, for each part in whose frame joints
        /// are searched for. Set by the ablation.
        pub max_hypotheses: usize = 12,
        /// Frames for which a track of an object rests at the start or at the end of its life; 0:
        /// rest is no evidence. Set by the ablation.
        pub rest_frames: usize = 8,
        /// Largest share (0 to 1) of the observed points of a joint's part that violate free space.
        /// Set by the ablation.
        pub max_through: f64 = 0.22,
        /// Largest share (0 to 1) of the points of a joint's part that may be missing in frames in
        /// which its configuration is not known, unless all other evidence is strong. Set by the
        /// ablation.
        pub max_unobserved: f64 = 0.6,
        /// Largest share (0 to 1) of the observations of a joint's tracks that lie in frames in which
        /// its configuration is not known, unless all other evidence is strong. Set by the ablation.
        pub max_uncovered: f64 = 0.3,
        /// Joints are also searched for in the frames of parts that move. Set by the ablation.
        pub chains: bool = true,
        /// Hinges that advance as they turn (screws) are distinguished from those that do not. Set by
        /// the ablation.
        pub screws: bool = true,
        /// Segments of time in which one joint was seen are merged. Set by the ablation.
        pub merge: bool = true,
        /// Outlier tracks, each of which the depth images contradict, are removed from a joint. Set by
        /// the ablation.
        pub remove_outliers: bool = true,
    }
}
