//! Why a motion cannot be computed, as a sentence with the joint, and with where it is and is to go,
//! radians or metres.

/// A trajectory that cannot be computed.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum TrajectoryError {
    /// A value is not finite.
    #[error("{joint} from {from} to {to}: both must be finite")]
    NotFinite {
        /// The joint.
        joint: String,
        /// Start.
        from: f64,
        /// End.
        to: f64,
    },
    /// No motion under the limits was found.
    #[error("{joint} from {from} to {to}: no trajectory under the rig's limits ({reason})")]
    Unsolved {
        /// The joint.
        joint: String,
        /// Start.
        from: f64,
        /// End.
        to: f64,
        /// Why.
        reason: String,
    },
}
