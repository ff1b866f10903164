//! Our way of learning: joints of one degree of freedom with a shared configuration q(t),
//! fitted directly to the tracks. Suspected in short windows of time, a joint grows over the
//! recording and gathers its tracks; poses, tree and covariance follow from it.
//!
//! Unlike the paper's order (cluster first, poses next, models last) nothing is decided
//! before a joint has shown that it explains its tracks.

mod accept;
mod adjust;
mod config;
mod consensus;
mod dof;
mod grow;
mod grown;
mod hypothesis;
mod kinds;
mod memory;
mod merge;
mod outcome;
mod pitch;
mod rehang;
mod search;
#[cfg(test)]
mod specimen;
mod suspicion;
mod view;

use crate::base::BaseMotion;
use crate::config::SkillConfig;
use crate::keyframes::Keyframes;
use crate::model::Joint;
use crate::structure::LearnedJoint;
use crate::track::TrackSet;
pub use config::JointsConfig;
pub use memory::Memory;
use search::Search;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use view::View;

/// The frames of a demonstration, or those of it that there are by now.
#[derive(Clone, Copy)]
pub struct Watched<'s> {
    /// Tracks.
    pub set: &'s TrackSet,
    /// The same from the base.
    pub base: &'s BaseMotion,
    /// Whole frames.
    pub keyframes: &'s Keyframes,
    /// Configuration.
    pub config: &'s SkillConfig,
}

impl Watched<'_> {
    /// Finds the joints of a demonstration, whose first frames were searched `earlier`.
    pub fn joints(&self, earlier: &Memory) -> Vec<LearnedJoint> {
        let view = self.view();
        let dismissed: Memory;
        let mut search = Search::new(*self, &view, earlier, None);
        search.run();
        if search.joints.is_empty() && earlier.frames > 0 {
            dismissed = search.remember().without_joints();
            search = Search::new(*self, &view, &dismissed, None);
            search.run();
        }
        search.polish();
        search.learned()
    }

    /// Searches the first frames of a demonstration, so that the rest is found sooner, and tells
    /// what it believes by then, if asked to. When `cancelled`, what is found is of no use.
    pub fn remember(
        &self,
        earlier: &Memory,
        cancelled: &AtomicBool,
        tell: Option<&dyn Fn(Vec<Joint>)>,
    ) -> Memory {
        let view = self.view();
        let mut search = Search::new(*self, &view, earlier, Some(cancelled));
        search.run();
        if search.is_cancelled() {
            return Memory::default();
        }
        if let Some(tell) = tell {
            tell(search.learned().into_iter().map(|l| l.joint).collect());
        }
        search.remember()
    }

    fn view(&self) -> Arc<View> {
        let tracks = &self.base.tracks;
        let moving = (0..tracks.len()).filter(|&t| tracks[t].moves).collect();
        Arc::new(View::from_base(self.base, moving))
    }
}
