//! State of the search of one recording: its input, the joints found so far, and the tracks in the
//! frame of each joint's part. Most steps of the search only read it; those that add or move joints
//! change it.

use super::bundle_adjustment::{OUTLIER_CUT, locate_points};
use super::config::{JointSearchConfig, SearchSettings};
use super::correlation::correlation_with_parent;
use super::estimate::JointEstimate;
use super::free_space_check::FreeSpaceCheck;
use super::tracks_in_part_frame::TracksInFrame;
use super::warm_start::{RejectedHypothesis, WarmStart};
use crate::learn::ego_motion::{MIN_EXTENT_M, MIN_EXTENT_SIGMAS};
use crate::learn::learned_joint::RejectedCandidate;
use crate::learn::recording::Recording;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Smallest number of moving tracks in which joints are searched.
pub const MIN_MOVING: usize = 4;
/// A background search scans all windows again when the number of its frames is a multiple of this.
const RESCAN_EVERY: usize = 60;

/// State of the search of one recording.
pub struct SearchState<'s> {
    /// Recording that is searched.
    pub recording: &'s Recording,
    /// Settings of the search.
    pub settings: SearchSettings<'s>,
    /// Result of a search over fewer frames.
    pub earlier: &'s WarmStart,
    cancelled: Option<&'s AtomicBool>,
    /// Moving tracks in the base frame.
    pub base_view: Arc<TracksInFrame>,
    /// Moving tracks in the frame of each joint's part, by joint.
    part_views: Vec<Arc<TracksInFrame>>,
    /// Adopted joints, parents first.
    pub joints: Vec<JointEstimate>,
    /// Rank of the strongest motion hypothesis so far.
    pub best_rank: f64,
    /// True if hypotheses of all windows are grown, not only those of frames that are new since the
    /// earlier search.
    pub rescans: bool,
    /// Hypotheses that earlier searches rejected, as far as the rejection still holds.
    pub rejected_before: Vec<RejectedHypothesis>,
    /// Hypotheses that this search grew and rejected.
    pub rejected: Vec<RejectedHypothesis>,
    /// Parts in whose frames at least one joint of the earlier search is not accepted any more.
    pub invalidated: Vec<Option<usize>>,
    /// Rejected candidates of the last round, with their reasons.
    pub rejections: Vec<RejectedCandidate>,
}

impl<'s> SearchState<'s> {
    /// A search without results. `cancelled` stops it early; it is `None` for the search after the
    /// last frame.
    pub fn new(
        recording: &'s Recording,
        settings: SearchSettings<'s>,
        moving: &Arc<TracksInFrame>,
        earlier: &'s WarmStart,
        cancelled: Option<&'s AtomicBool>,
    ) -> Self {
        Self {
            recording,
            settings,
            earlier,
            cancelled,
            base_view: Arc::clone(moving),
            part_views: Vec::new(),
            joints: Vec::new(),
            best_rank: earlier.best_rank,
            rescans: earlier.frames == 0,
            rejected_before: earlier.rejected_in(moving, &recording.tracks),
            rejected: Vec::new(),
            invalidated: Vec::new(),
            rejections: Vec::new(),
        }
    }

    /// Configuration of the search.
    pub fn config(&self) -> &'s JointSearchConfig {
        self.settings.joints
    }

    /// Free-space check against the keyframes of the recording.
    pub fn free_space(&self) -> FreeSpaceCheck<'s> {
        FreeSpaceCheck { recording: self.recording }
    }

    /// True if the search was cancelled, so that its result is not used.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.is_some_and(|c| c.load(Ordering::Relaxed))
    }

    /// True for the search after the last frame, which cannot be cancelled.
    pub fn is_the_end(&self) -> bool {
        self.cancelled.is_none()
    }

    /// True if all windows must be scanned again. Background searches do so at intervals, so that
    /// little is left for the last search.
    pub fn is_rescan_due(&self) -> bool {
        !self.rescans && (self.is_the_end() || self.base_view.frames.is_multiple_of(RESCAN_EVERY))
    }

    /// Moving tracks in the frame of a part; `None` is the base.
    pub fn view_from(&self, parent: Option<usize>) -> Arc<TracksInFrame> {
        parent.map_or_else(|| Arc::clone(&self.base_view), |p| Arc::clone(&self.part_views[p]))
    }

    /// Recomputes the tracks in the frames of a joint's part and of all later parts, which may be
    /// attached to it.
    pub fn renew_views(&mut self, joint: usize) {
        self.part_views.truncate(joint);
        for j in joint..self.joints.len() {
            let view = self.view_from(self.joints[j].parent);
            self.part_views.push(Arc::new(self.joints[j].tracks_in_part_frame(&view)));
        }
    }

    /// Replaces a joint by its refined version. The tracks in the frame of its part are recomputed
    /// if joints are attached to that part.
    pub fn replace_refined(&mut self, index: usize, joint: JointEstimate) {
        let view = self.view_from(joint.parent);
        if !self.joints_with(|parent| parent == Some(index)).is_empty() {
            self.part_views[index] = Arc::new(joint.tracks_in_part_frame(&view));
        }
        self.joints[index] = joint;
    }

    /// Numbers of the joints whose parent fulfils the condition `is_such`.
    pub fn joints_with(&self, is_such: impl Fn(Option<usize>) -> bool) -> Vec<usize> {
        (0..self.joints.len()).filter(|&i| is_such(self.joints[i].parent)).collect()
    }

    /// Number of a part in the earlier search: `Some(None)` is the base, `None` a part that it did
    /// not know.
    pub fn previous_id(&self, parent: Option<usize>) -> Option<Option<usize>> {
        let tracks = &self.recording.tracks;
        match parent {
            None => (self.earlier.frames > 0).then_some(None),
            Some(p) => self.earlier.counterpart(&self.joints[p], &self.base_view, tracks).map(Some),
        }
    }

    /// Unexplained tracks that move in the frame of a part; for the base all of them.
    pub fn moving_tracks(
        &self,
        parent: Option<usize>,
        view: &TracksInFrame,
        unexplained: &[usize],
    ) -> Vec<usize> {
        let moves = |&t: &usize| view.moves(t, MIN_EXTENT_M, MIN_EXTENT_SIGMAS);
        unexplained.iter().copied().filter(|t| parent.is_none() || moves(t)).collect()
    }

    /// Share of a joint's configuration that is a function of its parent's (negative where the
    /// parent rests); 0 for a joint of the base.
    pub fn parent_correlation(&self, joint: &JointEstimate, parent: Option<usize>) -> f64 {
        parent.map_or(0.0, |p| correlation_with_parent(joint, &self.joints[p]))
    }

    /// Unexplained tracks that a joint explains, including tracks too short to be members.
    pub fn explained_tracks(&self, joint: &JointEstimate, unexplained: &[usize]) -> Vec<usize> {
        let view = self.view_from(joint.parent);
        let mut located = joint.clone();
        locate_points(&mut located, &view, unexplained, 4.0 * OUTLIER_CUT);
        let motions = located.motions();
        unexplained
            .par_iter()
            .copied()
            .filter(|&t| {
                let cost = located.cost_of(&motions, &view, t, 2.0 * OUTLIER_CUT);
                let life = self.base_view.life(t).count();
                cost.observations > 0 && cost.inliers as f64 > 0.8 * life as f64
            })
            .collect()
    }

    /// Result of the search, for a search over more frames.
    pub fn to_warm_start(&self) -> WarmStart {
        WarmStart::of(
            &self.recording.tracks,
            |parent| self.view_from(parent),
            &self.joints,
            self.rejected_before.iter().chain(&self.rejected),
            self.best_rank,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::{
        FRAMES, ON_FRONT, drawer, drawer_recording, front, front_paths, recording_of, with_search,
    };
    use nalgebra::Point3;

    /// The drawer's tracks, and five that rest beside it.
    fn with_resting() -> Recording {
        let rest = |i: usize| vec![Point3::new(0.4 + 0.02 * i as f64, 0.0, 1.4); FRAMES];
        recording_of(front_paths().into_iter().chain((0..5).map(rest)).collect(), front)
    }

    fn looking<T>(recording: &Recording, look: impl FnOnce(&mut SearchState) -> T) -> T {
        with_search(recording, &JointSearchConfig::default(), &WarmStart::default(), look)
    }

    #[test]
    fn what_is_on_a_part_rests_as_seen_from_it_and_what_rests_moves() {
        let all: Vec<usize> = (0..ON_FRONT + 5).collect();
        looking(&with_resting(), |search| {
            search.joints.push(drawer(&search.base_view, |_| true));
            search.renew_views(0);
            let view = search.view_from(Some(0));
            let moving = search.moving_tracks(Some(0), &view, &all);
            assert_eq!(moving, (ON_FRONT..ON_FRONT + 5).collect::<Vec<_>>());
            let base = search.view_from(None);
            assert_eq!(
                search.moving_tracks(None, &base, &all),
                all,
                "nothing is left out on the base"
            );
        });
    }

    #[test]
    fn a_joint_explains_the_tracks_that_go_with_it() {
        let all: Vec<usize> = (0..ON_FRONT + 5).collect();
        looking(&with_resting(), |search| {
            let mut of_some = drawer(&search.base_view, |_| true);
            of_some.members.truncate(10);
            let explained = search.explained_tracks(&of_some, &all);
            assert_eq!(explained, (0..ON_FRONT).collect::<Vec<_>>());
            let unknown = drawer(&search.base_view, |_| false);
            assert!(search.explained_tracks(&unknown, &all).is_empty());
        });
    }

    #[test]
    fn joints_are_told_by_their_parents() {
        looking(&drawer_recording(front), |search| {
            let of = |parent| JointEstimate { parent, ..drawer(&search.base_view, |_| true) };
            let joints = vec![of(None), of(Some(0)), of(None)];
            search.joints = joints;
            assert_eq!(search.joints_with(|parent| parent.is_none()), [0, 2]);
            assert_eq!(search.joints_with(|parent| parent == Some(0)), [1]);
            assert_eq!(search.parent_correlation(&search.joints[0], None), 0.0);
            let mirrored = search.parent_correlation(&search.joints[1], Some(0));
            assert!((mirrored - 1.0).abs() < 1e-6, "{mirrored}");
        });
    }

    #[test]
    fn a_refined_joint_renews_the_view_from_its_part_where_others_hang_on_it() {
        looking(&drawer_recording(front), |search| {
            let joint = drawer(&search.base_view, |_| true);
            let child = JointEstimate { parent: Some(0), ..joint.clone() };
            search.joints = vec![joint.clone(), child];
            search.renew_views(0);
            let before = search.view_from(Some(0));
            search.replace_refined(1, search.joints[1].clone());
            assert!(Arc::ptr_eq(&before, &search.view_from(Some(0))), "nothing hangs on the child");
            let stopped = JointEstimate { filled: vec![0.0; FRAMES], ..joint };
            search.replace_refined(0, stopped);
            assert!(search.view_from(Some(0)).moves(0, MIN_EXTENT_M, MIN_EXTENT_SIGMAS));
        });
    }

    #[test]
    fn the_last_search_is_not_cancelled_and_one_ahead_is_as_soon_as_it_is_told() {
        let recording = drawer_recording(front);
        looking(&recording, |search| assert!(search.is_the_end() && !search.is_cancelled()));
        let (joints, nothing) = (JointSearchConfig::default(), WarmStart::default());
        let settings = SearchSettings { joints: &joints, seed: 1 };
        let view = Arc::new(TracksInFrame::moving(&recording.ego_motion));
        let stop = AtomicBool::new(false);
        let ahead = SearchState::new(&recording, settings, &view, &nothing, Some(&stop));
        assert!(!ahead.is_the_end() && !ahead.is_cancelled());
        stop.store(true, Ordering::Relaxed);
        assert!(ahead.is_cancelled());
    }

    #[test]
    fn without_an_earlier_search_all_windows_are_new_and_no_part_was_known() {
        let recording = drawer_recording(front);
        let found = looking(&recording, |search| {
            assert!(search.rescans && !search.is_rescan_due());
            assert_eq!(search.previous_id(None), None);
            search.joints.push(drawer(&search.base_view, |_| true));
            search.renew_views(0);
            search.to_warm_start()
        });
        with_search(&recording, &JointSearchConfig::default(), &found, |search| {
            assert!(!search.rescans && search.is_rescan_due());
            assert_eq!(search.previous_id(None), Some(None));
            search.joints.push(drawer(&search.base_view, |_| true));
            assert_eq!(search.previous_id(Some(0)), Some(Some(0)));
        });
    }
}
