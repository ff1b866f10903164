//! Our way of learning: joints of one degree of freedom with a shared configuration q(t),
//! fitted directly to the tracks. Suspected in short windows of time, a joint grows over the
//! recording and gathers its tracks; poses, tree and covariance follow from it.
//!
//! Unlike the paper's order (cluster first, poses next, models last) nothing is decided
//! before a joint has shown that it explains its tracks.

mod bundle_adjustment;
mod candidates;
pub(crate) mod config;
mod configuration_vote;
mod estimate;
mod grow;
mod helical_pitch;
mod merge_segments;
mod motion_hypotheses;
mod reparent;
mod screw_joint;
mod search;
#[cfg(test)]
mod test_data;
mod to_model;
mod tracks_in_part_frame;
mod type_selection;
mod verification;
mod warm_start;

use super::learned_joint::LearnedJoints;
use super::recording::Recording;
use crate::object::model::Joint;
pub use config::{JointSearchConfig, SearchSettings};
use search::Search;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tracks_in_part_frame::TracksInFrame;
pub use warm_start::WarmStart;

/// Finds the joints of a demonstration, whose first frames were searched `earlier`.
pub fn learn(
    recording: &Recording,
    earlier: &WarmStart,
    settings: &SearchSettings,
) -> LearnedJoints {
    let view = view(recording);
    let rejected: WarmStart;
    let mut search = Search::new(recording, *settings, &view, earlier, None);
    search.run();
    if search.joints.is_empty() && earlier.frames > 0 {
        rejected = search.remember().without_joints();
        search = Search::new(recording, *settings, &view, &rejected, None);
        search.run();
    }
    search.polish();
    LearnedJoints { joints: search.learned(), rejections: Vec::new() }
}

/// Searches the first frames of a demonstration, so that the rest is found sooner. Returns its
/// joints, too, if it `reports_joints`. A `cancelled` search ends soon and finds nothing.
pub fn search_ahead(
    recording: &Recording,
    earlier: &WarmStart,
    settings: &SearchSettings,
    cancelled: &AtomicBool,
    reports_joints: bool,
) -> (WarmStart, Option<Vec<Joint>>) {
    let view = view(recording);
    let mut search = Search::new(recording, *settings, &view, earlier, Some(cancelled));
    search.run();
    if search.is_cancelled() {
        return (WarmStart::default(), None);
    }
    let joints = || search.learned().into_iter().map(|learned| learned.joint).collect();
    (search.remember(), reports_joints.then(joints))
}

fn view(recording: &Recording) -> Arc<TracksInFrame> {
    let tracks = &recording.ego_motion.tracks;
    let moving = (0..tracks.len()).filter(|&t| tracks[t].moves).collect();
    Arc::new(TracksInFrame::from_base(&recording.ego_motion, moving))
}
