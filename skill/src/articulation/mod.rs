//! Articulation learning (paper, section III-D, after Sturm et al. 2011): which joint
//! explains how one part moves relative to another, and which tree of joints explains all.
//!
//! [`fit_models`] fits rigid, prismatic and revolute joints with an outlier component and
//! ranks them by BIC; a spanning tree keeps the links of least BIC.

mod circle;
mod columns;
mod consensus;
mod fit;
mod fitted_joint;
mod initial_states;
mod lost_poses;
mod maximisation;
mod model_selection;
pub(crate) mod pose_log;
mod pose_sample;
mod residuals;
mod rest_state;
#[cfg(feature = "paper")]
mod spanning_tree;
mod table;

pub use columns::Columns;
pub use fit::{FitError, fit_models, type_probabilities};
pub use fitted_joint::FittedJoint;
pub use pose_log::{LostLine, PoseLog, PoseLogError, read_pose_log};
pub use pose_sample::PoseSample;
#[cfg(feature = "paper")]
pub(crate) use residuals::POSITION_SIGMA_M;
#[cfg(feature = "paper")]
pub(crate) use spanning_tree::{Link, spanning_tree};
