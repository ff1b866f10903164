//! Result of a search over the first frames of a recording, kept for the next search over more
//! frames, so that little work is left after the last frame.
//!
//! In: joints and rejected hypotheses, with tracks as rows of a view.
//! Out: the joints and hypotheses with tracks as rows of the next search's views, which have other
//! tracks in other rows; in between tracks are kept by their identity. Frames and units do not
//! change.

use super::decision::max_segment_cost;
use super::estimate::JointEstimate;
use super::evidence::Evidence;
use super::motion_hypotheses::{COVERED, Hypothesis};
use super::propagation::MAX_LOST;
use super::tracks_in_part_frame::TracksInFrame;
use super::type_selection;
use crate::learn::tracking::{TrackId, TrackSet};
use crate::math::rigid::line_angle;
use crate::math::robust::overlap;
use nalgebra::Point3;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Probability from which the type of a joint is certain.
const CERTAIN: f64 = 0.99;
/// Share of a cached joint's tracks that its counterpart must exceed.
const SAME_JOINT: f64 = 0.5;
/// Largest angle between the axes of a cached joint and its counterpart, radians.
const SAME_AXIS: f64 = 0.2;

/// Joints and rejected hypotheses of an earlier search. Rejected candidates are not carried on,
/// because over many searches any hand would come to look like a joint; their hypotheses are kept
/// only so that they are not grown again.
#[derive(Debug, Clone, Default)]
pub struct WarmStart {
    /// Number of frames that were searched.
    pub frames: usize,
    /// Rank of the strongest motion hypothesis.
    pub best_rank: f64,
    joints: Vec<CachedJoint>,
    /// Rejected hypotheses in the base frame.
    rejected: Vec<RejectedHypothesis<TrackId>>,
}

/// A rejected motion hypothesis: its tracks, by row in a view or by identity, and the first and
/// last frame that it or its candidate covers.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedHypothesis<T = usize> {
    tracks: Vec<T>,
    first: usize,
    last: usize,
    /// Number of frames that were searched when the hypothesis was rejected.
    frames: usize,
    /// True if more frames cannot change the rejection: the candidate was lost before the last
    /// frame, or it fitted too poorly.
    for_good: bool,
}

impl RejectedHypothesis {
    /// The rejected hypothesis `h`; `grown` is the candidate that was grown from it, if any.
    pub fn new(h: &Hypothesis, grown: Option<&JointEstimate>, view: &TracksInFrame) -> Self {
        let known = grown.map(JointEstimate::known_frames).unwrap_or_default();
        let first = known.first().map_or(h.from, |f| h.from.min(*f));
        let last = known.last().map_or(h.to, |f| h.to.max(*f));
        let is_lost = last + MAX_LOST < view.frames;
        let is_poor = grown.is_some_and(|j| j.cost > max_segment_cost());
        let tracks = h.tracks.clone();
        Self { tracks, first, last, frames: view.frames, for_good: is_lost || is_poor }
    }

    /// True if the rejection is final, or if at most a quarter of the tracks moved since, so that
    /// nothing more is known.
    fn still_holds(&self, view: &TracksInFrame) -> bool {
        let moved = |t: &&usize| view.moved_since(**t, self.frames - 1);
        self.for_good || 4 * self.tracks.iter().filter(moved).count() <= self.tracks.len()
    }

    /// True if `h` would grow to the rejected candidate: its window lies within the frames of the
    /// rejection, and most of its tracks are among the rejected ones.
    pub fn covers(&self, h: &Hypothesis) -> bool {
        self.first <= h.from && h.to <= self.last && overlap(&h.tracks, &self.tracks) > COVERED
    }
}

impl<T: Copy> RejectedHypothesis<T> {
    /// Renames the tracks; tracks for which `name` returns nothing are dropped.
    fn renamed<U>(&self, name: impl Fn(T) -> Option<U>) -> RejectedHypothesis<U> {
        let Self { ref tracks, first, last, frames, for_good } = *self;
        let tracks = tracks.iter().copied().filter_map(name).collect();
        RejectedHypothesis { tracks, first, last, frames, for_good }
    }
}

/// A joint whose tracks are kept by identity, not by the rows of a view.
#[derive(Debug, Clone)]
struct CachedJoint {
    joint: JointEstimate,
    /// Tracks of the joint, with their points on the part at configuration 0, metres.
    members: Vec<(TrackId, Point3<f64>)>,
    /// True if the type of the joint is certain.
    is_certain: bool,
}

impl CachedJoint {
    fn new(joint: &JointEstimate, is_certain: bool, view: &TracksInFrame, set: &TrackSet) -> Self {
        let id = |t: usize| set.tracks[view.track_numbers[t]].id;
        let members = joint.members.iter().map(|&t| (id(t), joint.points[t])).collect();
        let bare = JointEstimate {
            points: Vec::new(),
            members: Vec::new(),
            seed: Vec::new(),
            ..joint.clone()
        };
        Self { joint: bare, members, is_certain }
    }

    fn in_view(&self, view: &TracksInFrame, rows: &HashMap<TrackId, usize>) -> JointEstimate {
        let mut joint = self.joint.clone();
        joint.points = vec![Point3::origin(); view.len()];
        for (id, point) in &self.members {
            if let Some(&row) = rows.get(id) {
                joint.points[row] = *point;
                joint.members.push(row);
            }
        }
        joint.q.resize(view.frames, 0.0);
        joint.known.resize(view.frames, false);
        joint.filled.resize(view.frames, 0.0);
        let mut configuration_from_depth = joint.evidence.configuration_from_depth;
        configuration_from_depth.resize(view.frames, f64::NAN);
        joint.evidence = Evidence { configuration_from_depth, ..joint.evidence };
        joint
    }
}

impl WarmStart {
    /// Makes the warm start from the result of a search. In the next search a joint whose type is
    /// not certain yet competes with newly grown candidates, because a short motion may have been
    /// taken for the wrong type.
    pub fn of<'d>(
        set: &TrackSet,
        view_from: impl Fn(Option<usize>) -> Arc<TracksInFrame>,
        joints: &[JointEstimate],
        rejected: impl Iterator<Item = &'d RejectedHypothesis>,
        best_rank: f64,
    ) -> Self {
        let view = view_from(None);
        let id = |row: usize| Some(set.tracks[view.track_numbers[row]].id);
        let cached = |j: &JointEstimate| {
            let probabilities = type_selection::type_probabilities(j, &view_from(j.parent));
            CachedJoint::new(j, probabilities.values().any(|p| *p >= CERTAIN), &view, set)
        };
        Self {
            frames: view.frames,
            best_rank,
            joints: joints.iter().map(cached).collect(),
            rejected: rejected.map(|d| d.renamed(id)).collect(),
        }
    }

    /// Only the rejected hypotheses, for a search that starts without joints.
    pub fn without_joints(&self) -> Self {
        Self { rejected: self.rejected.clone(), ..Self::default() }
    }

    /// Rejected hypotheses that still hold, with their tracks as rows of the base's view.
    pub fn rejected_in(&self, view: &TracksInFrame, set: &TrackSet) -> Vec<RejectedHypothesis> {
        let rows = rows_by_id(view, set);
        self.rejected
            .iter()
            .map(|d| d.renamed(|id| rows.get(&id).copied()))
            .filter(|d| d.still_holds(view))
            .collect()
    }

    /// First frame from which windows of time are new in the frame of a part: 0 if the type of a
    /// joint there is not certain.
    pub fn since(&self, parent: Option<usize>) -> usize {
        let is_open = |r: &CachedJoint| r.joint.parent == parent && !r.is_certain;
        if self.joints.iter().any(is_open) { 0 } else { self.frames }
    }

    /// Joints in the frame of a part, which was number `parent` of the earlier search, in a view of
    /// more frames; each with true if its type is certain.
    pub fn joints_of(
        &self,
        parent: Option<usize>,
        view: &TracksInFrame,
        set: &TrackSet,
    ) -> Vec<(JointEstimate, bool)> {
        let rows = rows_by_id(view, set);
        self.joints
            .iter()
            .filter(|r| r.joint.parent == parent)
            .map(|r| (r.in_view(view, &rows), r.is_certain))
            .collect()
    }

    /// Number of the joint of the earlier search that corresponds to `joint`, if there is one.
    pub fn counterpart(
        &self,
        joint: &JointEstimate,
        view: &TracksInFrame,
        set: &TrackSet,
    ) -> Option<usize> {
        let ids: HashSet<TrackId> =
            joint.members.iter().map(|&t| set.tracks[view.track_numbers[t]].id).collect();
        self.joints.iter().position(|r| {
            let shared = r.members.iter().filter(|(id, _)| ids.contains(id)).count();
            shared as f64 > SAME_JOINT * r.members.len() as f64
                && r.joint.dof.hinge == joint.dof.hinge
                && line_angle(&r.joint.dof.axis, &joint.dof.axis) < SAME_AXIS
        })
    }
}

fn rows_by_id(view: &TracksInFrame, set: &TrackSet) -> HashMap<TrackId, usize> {
    view.track_numbers.iter().enumerate().map(|(row, &t)| (set.tracks[t].id, row)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use crate::learn::tracking::Track;
    use crate::math::rigid::Pose;
    use nalgebra::Vector3;

    const HINGE: ScrewJoint = ScrewJoint {
        hinge: true,
        axis: Vector3::new(0.0, 1.0, 0.0),
        origin: Point3::new(0.0, 0.0, 1.5),
        pitch: None,
    };

    fn view(frames: usize) -> Arc<TracksInFrame> {
        view_until(frames, frames)
    }

    /// View of a part that turns until frame `stop` and then rests.
    fn view_until(stop: usize, frames: usize) -> Arc<TracksInFrame> {
        let q: Vec<f64> = (0..frames).map(|f| 0.03 * f.min(stop) as f64).collect();
        let places: Vec<Point3<f64>> =
            (0..8).map(|i| Point3::new(0.1 + 0.05 * f64::from(i), 0.1, 1.5)).collect();
        Arc::new(seen_moving(&HINGE, &places, &q))
    }

    /// Track set of the eight tracks of the view.
    fn tracks() -> TrackSet {
        let track = |id| Track { id: TrackId(id), first_frame: 0, observations: Vec::new() };
        TrackSet { frame_utimes: Vec::new(), tracks: (0..8).map(track).collect() }
    }

    #[test]
    fn a_joint_is_called_back_with_its_tracks_when_more_frames_have_come() {
        let early = view(20);
        let mut door = JointEstimate::new(HINGE, &early, 0);
        door.members = vec![1, 4, 6];
        door.points[4] = Point3::new(0.3, 0.1, 1.5);
        door.known = vec![true; 20];
        let warm_start = WarmStart::of(&tracks(), |_| Arc::clone(&early), &[door], [].iter(), 7.0);
        let joints = warm_start.joints_of(None, &view(30), &tracks());
        let (door, _) = &joints[0];
        assert_eq!(door.members, [1, 4, 6]);
        assert_eq!(door.points[4], Point3::new(0.3, 0.1, 1.5));
        assert_eq!(door.known_frames(), (0..20).collect::<Vec<_>>());
        assert_eq!(door.q.len(), 30);
    }

    #[test]
    fn windows_are_searched_again_where_the_type_is_not_certain() {
        let early = view(20);
        let still = JointEstimate::new(HINGE, &early, 0);
        let of = |joints: &[JointEstimate]| {
            WarmStart::of(&tracks(), |_| Arc::clone(&early), joints, [].iter(), 7.0)
        };
        assert_eq!(of(&[still]).since(None), 0);
        assert_eq!(of(&[]).since(None), 20);
    }

    /// Rejected hypotheses that still hold now, of one that was rejected after 40 frames: it had been
    /// followed until frame `last`.
    fn rejected(last: usize, now: &TracksInFrame) -> Vec<RejectedHypothesis> {
        let early = view(40);
        let mut hand = JointEstimate::new(HINGE, &early, 0);
        hand.known = (0..40).map(|f| (5..=last).contains(&f)).collect();
        hand.cost = 3.0;
        let rejected = RejectedHypothesis::new(&hypothesis(6, 12), Some(&hand), &early);
        let of_early =
            WarmStart::of(&tracks(), |_| Arc::clone(&early), &[], [rejected].iter(), 7.0);
        of_early.rejected_in(now, &tracks())
    }

    fn hypothesis(from: usize, to: usize) -> Hypothesis {
        Hypothesis { from, to, motion: Pose::identity(), tracks: vec![1, 2, 3, 4], rank: 1.0 }
    }

    #[test]
    fn what_was_lost_before_the_last_frame_is_not_asked_about_those_frames_again() {
        let rejected = rejected(20, &view(60));
        assert!(rejected[0].covers(&hypothesis(8, 14)));
        assert!(!rejected[0].covers(&hypothesis(30, 42)), "it may be a joint later");
    }

    #[test]
    fn what_was_seen_to_the_last_frame_is_asked_again_if_it_has_moved_since() {
        assert_eq!(rejected(39, &view(60)), []);
        assert_eq!(rejected(39, &view_until(39, 60)).len(), 1);
    }
}
