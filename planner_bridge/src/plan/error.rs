//! Why a plan is refused, as a sentence that is told to whoever asked for it.
//!
//! In: the target, the joint or the motion that is refused. Out: the sentence, with degrees and
//! centimetres where it tells how far something deviates.

use crate::trajectory::TrajectoryError;
use linkage_skill::predict::PredictError;

/// A prediction that cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The target or the joint.
    #[error(transparent)]
    Predict(#[from] PredictError),
    /// The motion in time.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// Another object moves.
    #[error("{object} moves; it comes to rest first")]
    OtherMoves {
        /// What moves.
        object: String,
    },
    /// What was learned is not sure enough for a robot.
    #[error("{joint} is not known well enough: {what}; demonstrate it again, over more of its way")]
    Uncertain {
        /// The joint.
        joint: String,
        /// What is not.
        what: String,
    },
    /// Where it is now was not seen well enough for a robot.
    #[error("the present configuration of {joint} is not known well enough: {what}")]
    Unclear {
        /// The joint.
        joint: String,
        /// What is not.
        what: String,
    },
    /// A grasp is given, and several parts move.
    #[error("{joints} joints move: name the one whose part the grasp is on")]
    WhoseGrasp {
        /// How many.
        joints: usize,
    },
}
