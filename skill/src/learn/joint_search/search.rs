//! The search: hypotheses are grown, the joint of most gain is adopted, and what it leaves is
//! searched again, from the base and from each part that moves.

use super::config::SearchSettings;
use super::estimate::JointEstimate;
use super::merge_segments::LineMatch;
use super::tracks_in_part_frame::TracksInFrame;
use super::verification::FreeSpaceCheck;
use super::warm_start::{RejectedHypothesis, WarmStart};
use super::{bundle_adjustment, grow, merge_segments, to_model, verification};
use crate::learn::learned_joint::LearnedJoint;
use crate::learn::recording::Recording;
use crate::math::robust::overlap;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A search of one recording.
pub struct Search<'s> {
    recording: &'s Recording,
    /// The view from the base,
    view: Arc<TracksInFrame>,
    /// and that from each joint's part.
    views: Vec<Arc<TracksInFrame>>,
    pub(super) witness: FreeSpaceCheck<'s>,
    pub(super) config: SearchSettings<'s>,
    pub(super) earlier: &'s WarmStart,
    cancelled: Option<&'s AtomicBool>,
    /// Joints that were adopted, parents first.
    pub joints: Vec<JointEstimate>,
    /// Rank of the strongest hypothesis so far.
    pub(super) best_rank: f64,
    /// What is left is sought in all windows, those of the earlier search too.
    pub(super) looks_back: bool,
    /// What earlier searches grew and did not believe,
    pub(super) dismissed_before: Vec<RejectedHypothesis>,
    /// and what this one did.
    pub(super) rejected: Vec<RejectedHypothesis>,
    /// Parts in whose frames not all of the earlier search's joints are joints still.
    pub(super) invalidated: Vec<Option<usize>>,
}

impl<'s> Search<'s> {
    /// A search that has found nothing; `cancelled` ends it soon.
    pub fn new(
        recording: &'s Recording,
        config: SearchSettings<'s>,
        view: &Arc<TracksInFrame>,
        earlier: &'s WarmStart,
        cancelled: Option<&'s AtomicBool>,
    ) -> Self {
        let witness = FreeSpaceCheck {
            base: &recording.ego_motion,
            keyframes: &recording.keyframes,
            config: config.joints,
        };
        Self {
            recording,
            view: Arc::clone(view),
            views: Vec::new(),
            witness,
            config,
            earlier,
            cancelled,
            joints: Vec::new(),
            best_rank: earlier.best_rank,
            looks_back: earlier.frames == 0,
            dismissed_before: earlier.dismissed_in(view, &recording.tracks),
            rejected: Vec::new(),
            invalidated: Vec::new(),
        }
    }

    /// Adopts joints until none is left.
    pub fn run(&mut self) {
        self.adopt_all();
        if self.config.joints.chains && !self.is_cancelled() {
            self.rehang();
        }
    }

    fn adopt_all(&mut self) {
        let config = self.config.joints;
        let mut rest: Vec<usize> = (0..self.view.len()).collect();
        // What one round grew, the next need not grow again.
        let mut grown = self.reuse(&mut rest);
        for round in 0..config.rounds {
            if self.is_cancelled() {
                return;
            }
            let parents = if config.chains { self.joints.len() } else { 0 };
            let known =
                |parent| (parent, grown.iter().filter(|j| j.parent == parent).cloned().collect());
            let frames = std::iter::once(None).chain((0..parents).map(Some)).map(known).collect();
            let mut candidates = self.in_frames(frames, &rest, round);
            let mut best = self.best_of(&candidates);
            if best.is_none() && !self.looks_back && self.may_look_back() {
                self.looks_back = true;
                candidates = self.in_frames(vec![(None, candidates)], &rest, round);
                best = self.best_of(&candidates);
            }
            let Some(best) = best else { return };
            let best = self.merged_with_its_stretches(best, &candidates, &rest);
            let explained = self.explained(&best, &rest);
            let adopted = self.adopt(best, &rest);
            rest.retain(|t| !explained.contains(t));
            candidates
                .retain(|j| overlap(&j.members, &explained) < 0.3 && j.parent != Some(adopted));
            grown = candidates;
        }
    }

    /// Carries the earlier search's joints on to the present. Those that are beyond doubt are
    /// adopted; the others are to compete with what else can be grown, and so are those that are
    /// lost while what was adopted moves.
    fn reuse(&mut self, rest: &mut Vec<usize>) -> Vec<JointEstimate> {
        let mut doubtful: Vec<JointEstimate> = Vec::new();
        let mut parents = vec![None];
        let mut visited = 0;
        while let Some(&parent) = parents.get(visited) {
            visited += 1;
            let Some(previous_id) = self.previous_id(parent) else { continue };
            let view = self.view_from(parent);
            let candidates = self.movers(parent, &view, rest);
            if candidates.len() < 4 {
                continue;
            }
            let (mut sound, mut others) = (Vec::new(), Vec::new());
            let recalled = self.recalled(previous_id, parent, &view, &candidates);
            if self.is_cancelled() {
                return Vec::new();
            }
            for (joint, was_certain) in recalled {
                let beyond_doubt = was_certain && self.goes_on(&joint);
                if beyond_doubt { &mut sound } else { &mut others }.push(joint);
            }
            while let Some(best) = self.best_among(sound.iter().collect()) {
                let explained = self.explained(&best, rest);
                rest.retain(|t| !explained.contains(t));
                let apart = |j: &JointEstimate| overlap(&j.members, &explained) < 0.3;
                sound.retain(|j| j.dof != best.dof && apart(j));
                others.retain(apart);
                doubtful.retain(apart);
                let adopted = self.adopt(best, rest);
                let (lost, found): (Vec<JointEstimate>, Vec<JointEstimate>) =
                    sound.into_iter().partition(|j| self.is_lost_beside(j, adopted));
                sound = found;
                others.extend(lost);
                if !parents.contains(&Some(adopted)) {
                    parents.push(Some(adopted));
                }
            }
            if !others.iter().all(|j| self.witness.accepts(j)) {
                self.invalidated.push(parent);
            }
            doubtful.append(&mut others);
            doubtful.append(&mut sound);
        }
        doubtful
    }

    /// Searches ahead look back from time to time, so that little is left to ask at the end.
    fn may_look_back(&self) -> bool {
        self.is_the_end() || self.view.frames.is_multiple_of(LOOK_BACK_EVERY)
    }

    /// All frames have come: nobody cancels it.
    pub(super) fn is_the_end(&self) -> bool {
        self.cancelled.is_none()
    }

    /// A joint of the earlier search does in the frames since what it did before. While more
    /// frames come it may do so less well: what moves on its part is only just beginning to.
    fn goes_on(&self, joint: &JointEstimate) -> bool {
        let new = &joint.known[self.earlier.frames..];
        let followed = new.iter().filter(|k| **k).count();
        let is_borne = || {
            !self.is_the_end()
                && self.witness.tolerates(joint)
                && joint.unruly <= self.config.joints.max_unruly
        };
        10 * followed >= 9 * new.len() && (self.witness.accepts(joint) || is_borne())
    }

    pub(super) fn is_cancelled(&self) -> bool {
        self.cancelled.is_some_and(|c| c.load(Ordering::Relaxed))
    }

    /// The view from a part.
    pub(super) fn view_from(&self, parent: Option<usize>) -> Arc<TracksInFrame> {
        parent.map_or_else(|| Arc::clone(&self.view), |p| Arc::clone(&self.views[p]))
    }

    /// What a part was in the earlier search; `None`: not known to it.
    pub(super) fn previous_id(&self, parent: Option<usize>) -> Option<Option<usize>> {
        match parent {
            None => (self.earlier.frames > 0).then_some(None),
            Some(p) => self
                .earlier
                .counterpart(&self.joints[p], &self.view, &self.recording.tracks)
                .map(Some),
        }
    }

    /// The earlier search's joints in the frame of a part, carried on to the present, and whether
    /// their types were certain.
    fn recalled(
        &self,
        previous_id: Option<usize>,
        parent: Option<usize>,
        view: &TracksInFrame,
        candidates: &[usize],
    ) -> Vec<(JointEstimate, bool)> {
        let mut joints = self.earlier.recalled(previous_id, view, &self.recording.tracks);
        joints.par_iter_mut().filter(|_| !self.is_cancelled()).for_each(|(joint, was_certain)| {
            joint.parent = parent;
            let config = self.config.joints;
            *joint = grow::grow(view, joint.clone(), *was_certain, candidates, config);
            self.question(view, joint, candidates);
            self.report("recalled", joint);
        });
        joints
    }

    /// Those of `rest` that move as seen from a part.
    pub(super) fn movers(
        &self,
        parent: Option<usize>,
        view: &TracksInFrame,
        rest: &[usize],
    ) -> Vec<usize> {
        let base = self.config.ego_motion;
        let moves = |&t: &usize| view.moves(t, base.min_extent_m, base.min_extent_sigmas);
        rest.iter().copied().filter(|t| parent.is_none() || moves(t)).collect()
    }

    /// Refines what it found on all frames, parents first.
    pub fn polish(&mut self) {
        let mut generation = self.carried_by(|parent| parent.is_none());
        while !generation.is_empty() {
            let polished: Vec<JointEstimate> = generation
                .par_iter()
                .map(|&i| {
                    let joint = self.joints[i].clone();
                    let view = self.view_from(joint.parent);
                    grow::polish(&view, joint, self.config.joints)
                })
                .collect();
            for (&i, joint) in generation.iter().zip(polished) {
                let view = self.view_from(joint.parent);
                if !self.carried_by(|parent| parent == Some(i)).is_empty() {
                    self.views[i] = Arc::new(view.seen_from(&joint));
                }
                self.joints[i] = joint;
            }
            generation = self.carried_by(|parent| parent.is_some_and(|p| generation.contains(&p)));
        }
    }

    /// Joints whose parents are such.
    fn carried_by(&self, is_such: impl Fn(Option<usize>) -> bool) -> Vec<usize> {
        (0..self.joints.len()).filter(|&i| is_such(self.joints[i].parent)).collect()
    }

    /// What it found, as a model tells it.
    pub fn learned(&self) -> Vec<LearnedJoint> {
        let view_from = |parent| self.view_from(parent);
        to_model::to_learned(self.recording, view_from, &self.joints, self.config.joints)
    }

    /// What it found, for a search over more frames.
    pub fn remember(&self) -> WarmStart {
        WarmStart::of(
            &self.recording.tracks,
            |parent| self.view_from(parent),
            &self.joints,
            self.dismissed_before.iter().chain(&self.rejected),
            self.best_rank,
            self.config.joints,
        )
    }

    pub(super) fn report(&self, how: &str, joint: &JointEstimate) {
        tracing::debug!(
            how,
            parent = joint.parent.map_or(0, |p| p + 1),
            kind = joint.dof.geometry().kind.name(),
            axis = format!("{:.2?}", joint.dof.axis.as_slice()),
            origin = format!("{:.2?}", joint.dof.origin.coords.as_slice()),
            gain = joint.gain as i64,
            members = joint.members.len(),
            span = format!("{:.2}", joint.span()),
            cost = format!("{:.2}", joint.cost),
            frames = joint.known_frames().len(),
            through = format!("{:.2}", joint.through),
            hidden = format!("{:.2}", joint.hidden),
            tells = format!("{:.2}", joint.tells),
            coupling = format!("{:.2}", joint.coupling),
            unruly = format!("{:.2}", joint.unruly),
            accepted = self.witness.accepts(joint),
            "joint"
        );
    }

    /// Confronts a joint with the depth pictures; takes back configurations that they
    /// contradict.
    pub(super) fn question(
        &self,
        view: &TracksInFrame,
        joint: &mut JointEstimate,
        candidates: &[usize],
    ) {
        if self.is_cancelled() {
            return;
        }
        joint.coupling = self.coupling(joint, joint.parent);
        if !self.witness.is_worth_asking(joint) {
            return;
        }
        joint.unruly = joint.unruly_share(view);
        if joint.unruly > grow::HOPELESSLY_UNRULY {
            self.witness.examine(joint, &self.joints);
            return;
        }
        self.dismiss_strangers(view, joint);
        self.witness.examine(joint, &self.joints);
        if !joint.contradicted.is_empty() && joint.through < 0.95 {
            let before = joint.clone();
            for f in joint.contradicted.clone() {
                joint.known[f] = false;
            }
            if joint.known_frames().len() >= 10 {
                grow::finish(view, joint, candidates, self.config.joints, 2);
                self.dismiss_strangers(view, joint);
                self.witness.examine(joint, &self.joints);
            }
            if joint.members.len() < 4 {
                *joint = before;
            }
        }
        joint.unruly = joint.unruly_share(view);
        joint.coupling = self.coupling(joint, joint.parent);
    }

    /// Share of a joint's configuration that is a function of its parent's.
    pub(super) fn coupling(&self, joint: &JointEstimate, parent: Option<usize>) -> f64 {
        parent.map_or(0.0, |p| verification::coupling(joint, &self.joints[p]))
    }

    /// Takes out what only held the part, and lets the rest settle: strangers drew the line.
    fn dismiss_strangers(&self, view: &TracksInFrame, joint: &mut JointEstimate) {
        if !self.config.joints.dismiss_strangers {
            return;
        }
        let before = joint.members.len();
        self.witness.dismiss_strangers(joint, &self.joints);
        if joint.members.len() < before {
            let own = joint.members.clone();
            grow::finish(view, joint, &own, self.config.joints, 2);
        }
    }

    /// The accepted joint of most gain.
    fn best_of(&self, candidates: &[JointEstimate]) -> Option<JointEstimate> {
        self.best_among(candidates.iter().filter(|j| self.witness.accepts(j)).collect())
    }

    /// The joint of most gain; one of the base is preferred to one of a part that explains the
    /// same tracks.
    fn best_among(&self, believed: Vec<&JointEstimate>) -> Option<JointEstimate> {
        let known = |j: &JointEstimate| j.known_frames().len() as f64;
        let same_tracks = |a: &JointEstimate, b: &JointEstimate| {
            overlap(&a.members, &b.members) > 0.35 || overlap(&b.members, &a.members) > 0.6
        };
        // Where a joint of the base is lost for long, its part hangs on one that moved then.
        let shadowed = |j: &JointEstimate| {
            believed.iter().filter(|o| o.parent.is_some() != j.parent.is_some()).any(|o| {
                let enough = if j.parent.is_some() { BASE_SUFFICES } else { 1.0 / BASE_SUFFICES };
                same_tracks(j, o) && known(o) > enough * known(j)
            })
        };
        believed
            .iter()
            .filter(|j| !shadowed(j) && !self.is_an_appendage(j))
            .map(|j| (self.gain_over_base(j), *j))
            .filter(|(gain, j)| *gain > self.witness.least_gain(j))
            .max_by(|(a, _), (b, _)| a.total_cmp(b))
            .map(|(_, j)| j.clone())
    }

    /// It does what an accepted joint does, and the pictures hardly bear it out: a holding hand.
    /// Or the pictures show it on that joint's part wherever that goes. Or it is next to nothing
    /// beside one that it follows, or whose line it turns about: corners that a part's rim makes
    /// with what is behind it.
    fn is_an_appendage(&self, joint: &JointEstimate) -> bool {
        let seen = verification::is_found_everywhere(joint);
        self.joints.iter().enumerate().any(|(i, o)| {
            let little = joint.gain < MIN_STANDING * o.gain;
            let twin = || {
                joint.dof.hinge
                    && joint.parent == o.parent
                    && merge_segments::shares_line(o, joint, 1.0)
            };
            (!seen || little) && verification::follows(joint, o) > MAX_FOLLOWING
                || little && twin()
                || joint.gain < o.gain && self.witness.is_on(joint, i, &self.joints)
        })
    }

    /// Gain in one currency: cost against standing still in the base.
    fn gain_over_base(&self, joint: &JointEstimate) -> f64 {
        if joint.parent.is_none() {
            return joint.gain;
        }
        let cut = self.config.joints.cut;
        let view = self.view_from(joint.parent);
        let motions = joint.motions();
        let saved: f64 = joint
            .members
            .iter()
            .map(|&t| {
                self.view.static_cost(t, &joint.known, cut)
                    - joint.cost_of(&motions, &view, t, cut).sum
            })
            .sum();
        let known = joint.known_frames().len();
        0.9 * (saved / 5.0 - self.config.joints.frame_penalty * (known + 5) as f64)
    }

    fn merged_with_its_stretches(
        &self,
        mut best: JointEstimate,
        candidates: &[JointEstimate],
        rest: &[usize],
    ) -> JointEstimate {
        if !self.config.joints.merge {
            return best;
        }
        let mut others: Vec<&JointEstimate> = candidates
            .iter()
            .filter(|j| j.parent == best.parent && self.witness.tolerates(j))
            .collect();
        others.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let view = self.view_from(best.parent);
        for other in others {
            if !merge_segments::adds_frames(&best, other) {
                continue;
            }
            let Some(line_match) = merge_segments::line_match(&best, other) else { continue };
            if overlap(&other.members, &best.members) < 0.7 {
                best = self.try_merge(&view, &best, other, line_match, rest).unwrap_or(best);
            }
        }
        best
    }

    fn try_merge(
        &self,
        view: &TracksInFrame,
        a: &JointEstimate,
        b: &JointEstimate,
        line_match: LineMatch,
        rest: &[usize],
    ) -> Option<JointEstimate> {
        let config = self.config.joints;
        let mut candidates = rest.to_vec();
        candidates.extend(a.members.iter().chain(&b.members));
        candidates.sort_unstable();
        candidates.dedup();
        let mut merged = merge_segments::merged(view, a, b, &candidates, config)?;
        self.dismiss_strangers(view, &mut merged);
        self.witness.examine(&mut merged, &self.joints);
        merged.coupling = a.coupling;
        merged.unruly = merged.unruly_share(view);
        let better = merged.gain
            > a.gain.max(b.gain) + line_match.required_gain() * a.gain.min(b.gain)
            && merged.cost < config.max_cost + 0.6
            && merged.through < config.max_through + 0.03;
        tracing::debug!(gain = merged.gain as i64, before = a.gain as i64, better, "merge");
        better.then_some(merged)
    }

    /// Adds a joint, or makes it part of one that is there already. Returns its number.
    fn adopt(&mut self, joint: JointEstimate, rest: &[usize]) -> usize {
        let kin: Vec<(usize, LineMatch)> = (0..self.joints.len())
            .filter(|_| self.config.joints.merge)
            .filter_map(|i| Some((i, merge_segments::line_match(&self.joints[i], &joint)?)))
            .collect();
        let view = self.view_from(joint.parent);
        for &(i, line_match) in kin.iter().filter(|(i, _)| self.joints[*i].parent == joint.parent) {
            if let Some(merged) = self.try_merge(&view, &self.joints[i], &joint, line_match, rest) {
                self.joints[i] = merged;
                self.look_from(i);
                return i;
            }
        }
        // What cannot be merged with its twin is not a joint beside it.
        if let Some((i, _)) = kin.iter().find(|(_, line_match)| *line_match == LineMatch::Same) {
            return *i;
        }
        self.joints.push(joint);
        self.look_from(self.joints.len() - 1);
        self.joints.len() - 1
    }

    /// Renews the views from a joint's part and from what may hang on it: parents come first.
    pub(super) fn look_from(&mut self, joint: usize) {
        self.views.truncate(joint);
        for j in joint..self.joints.len() {
            let view = self.view_from(self.joints[j].parent).seen_from(&self.joints[j]);
            self.views.push(Arc::new(view));
        }
    }

    /// Tracks that a joint explains, short ones too: they drop out.
    fn explained(&self, joint: &JointEstimate, rest: &[usize]) -> Vec<usize> {
        let cut = self.config.joints.cut;
        let view = self.view_from(joint.parent);
        let mut located = joint.clone();
        bundle_adjustment::locate_points(&mut located, &view, rest, 4.0 * cut);
        let motions = located.motions();
        rest.par_iter()
            .copied()
            .filter(|&t| {
                let cost = located.cost_of(&motions, &view, t, 2.0 * cut);
                let life = self.view.life(t).count();
                cost.observations > 0 && cost.inliers as f64 > 0.8 * life as f64
            })
            .collect()
    }
}

/// Frames after which a search ahead looks back.
const LOOK_BACK_EVERY: usize = 60;
/// Share of a configuration that may be a function of another joint's.
const MAX_FOLLOWING: f64 = 0.95;
/// Share of another joint's gain from which doing what it does is no dependence.
const MIN_STANDING: f64 = 0.05;
/// Share of a chained joint's frames from which a joint of the base explains as much.
const BASE_SUFFICES: f64 = 0.8;
