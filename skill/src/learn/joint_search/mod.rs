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

use super::ego_motion::EgoMotion;
use super::keyframes::Keyframes;
use super::learned_joint::LearnedJoint;
use super::tracking::TrackSet;
use crate::config::SkillConfig;
use crate::object::model::Joint;
pub use config::JointsConfig;
use search::Search;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tracks_in_part_frame::TracksInFrame;
pub use warm_start::WarmStart;

/// The frames of a demonstration, or those of it that there are by now.
#[derive(Clone, Copy)]
pub struct Watched<'s> {
    /// Tracks.
    pub set: &'s TrackSet,
    /// The same from the base.
    pub base: &'s EgoMotion,
    /// Whole frames.
    pub keyframes: &'s Keyframes,
    /// Configuration.
    pub config: &'s SkillConfig,
}

impl Watched<'_> {
    /// Finds the joints of a demonstration, whose first frames were searched `earlier`.
    pub fn joints(&self, earlier: &WarmStart) -> Vec<LearnedJoint> {
        let view = self.view();
        let rejected: WarmStart;
        let mut search = Search::new(*self, &view, earlier, None);
        search.run();
        if search.joints.is_empty() && earlier.frames > 0 {
            rejected = search.remember().without_joints();
            search = Search::new(*self, &view, &rejected, None);
            search.run();
        }
        search.polish();
        search.learned()
    }

    /// Searches the first frames of a demonstration, so that the rest is found sooner, and tells
    /// what it believes by then, if asked to. When `cancelled`, what is found is of no use.
    pub fn remember(
        &self,
        earlier: &WarmStart,
        cancelled: &AtomicBool,
        tell: Option<&dyn Fn(Vec<Joint>)>,
    ) -> WarmStart {
        let view = self.view();
        let mut search = Search::new(*self, &view, earlier, Some(cancelled));
        search.run();
        if search.is_cancelled() {
            return WarmStart::default();
        }
        if let Some(tell) = tell {
            tell(search.learned().into_iter().map(|l| l.joint).collect());
        }
        search.remember()
    }

    fn view(&self) -> Arc<TracksInFrame> {
        let tracks = &self.base.tracks;
        let moving = (0..tracks.len()).filter(|&t| tracks[t].moves).collect();
        Arc::new(TracksInFrame::from_base(self.base, moving))
    }
}
