//! What is suspected in the frames of parts, and what it grows to.

use super::estimate::JointEstimate;
use super::motion_hypotheses;
use super::motion_hypotheses::Hypothesis;
use super::search::Search;
use super::tracks_in_part_frame::TracksInFrame;
use super::warm_start::RejectedHypothesis;
use super::{grow, verification};
use crate::math::robust::overlap;
use rayon::prelude::*;
use std::sync::Arc;

/// Hypotheses grown when a search ahead looks back,
const LOOKS_BACK_AHEAD: usize = 4;
/// and at the end, which somebody waits for.
const LOOKS_BACK_AT_END: usize = 2;
/// Hypotheses grown side by side.
const BATCH: usize = 2;
/// Share of its motion that a sound joint may leave of a hypothesis that it explains,
const SOUND_SHARE: f64 = 0.5;
/// and one that is not believed.
const POOR_SHARE: f64 = 0.25;
/// Share of a hypothesis's tracks from which it says nothing new.
pub const COVERED: f64 = 0.6;
/// Share of tracks in common from which two growths are the same.
const SAME: f64 = 0.9;

/// What is suspected in the frame of a part.
struct FrameCandidates {
    /// `None`: of the base.
    parent: Option<usize>,
    view: Arc<TracksInFrame>,
    /// Tracks that move in it.
    candidates: Vec<usize>,
    /// The strongest first.
    hypotheses: Vec<Hypothesis>,
}

impl Search<'_> {
    /// Joints in the frames of parts: those that are known in each, and what else can be grown.
    pub(super) fn in_frames(
        &mut self,
        known: Vec<(Option<usize>, Vec<JointEstimate>)>,
        rest: &[usize],
        round: usize,
    ) -> Vec<JointEstimate> {
        let mut frames: Vec<(FrameCandidates, Vec<JointEstimate>)> = known
            .into_par_iter()
            .filter_map(|(parent, known)| Some((self.suspicions(parent, rest, round)?, known)))
            .collect();
        for (suspicions, _) in &mut frames {
            self.invalidated.retain(|p| *p != suspicions.parent);
            let hypotheses = &mut suspicions.hypotheses;
            self.best_rank = hypotheses.first().map_or(0.0, |h| h.rank).max(self.best_rank);
            let least_rank = self.config.joints.min_rank_share * self.best_rank;
            hypotheses.retain(|h| h.rank >= least_rank);
        }
        let found: Vec<(Vec<JointEstimate>, Vec<RejectedHypothesis>)> =
            frames.into_par_iter().map(|(s, known)| self.grown_in(&s, known)).collect();
        let mut joints = Vec::new();
        for (grown, mut rejected) in found {
            joints.extend(grown);
            self.rejected.append(&mut rejected);
        }
        joints
    }

    /// `None` where too little moves.
    fn suspicions(
        &self,
        parent: Option<usize>,
        rest: &[usize],
        round: usize,
    ) -> Option<FrameCandidates> {
        let config = self.config.joints;
        let view = self.view_from(parent);
        let candidates = self.movers(parent, &view, rest);
        if candidates.len() < 4 {
            return None;
        }
        let since = match self.previous_id(parent) {
            Some(previous_id) if !self.looks_back && !self.invalidated.contains(&parent) => {
                self.earlier.since(previous_id)
            }
            _ => 0,
        };
        let seed = self.config.seed.wrapping_add(round as u64);
        let hypotheses = motion_hypotheses::hypotheses(&view, &candidates, since, config, seed);
        Some(FrameCandidates { parent, view, candidates, hypotheses })
    }

    /// What is `known` and what the suspicions grow to, and those of them that are not believed.
    fn grown_in(
        &self,
        suspicions: &FrameCandidates,
        known: Vec<JointEstimate>,
    ) -> (Vec<JointEstimate>, Vec<RejectedHypothesis>) {
        let FrameCandidates { parent, view, hypotheses, .. } = suspicions;
        let config = self.config.joints;
        let mut queue = hypotheses.iter().filter(|h| self.tells(h, *parent, view));
        let mut limit = match (self.looks_back && self.earlier.frames > 0, self.is_the_end()) {
            (false, _) => config.max_hypotheses,
            (true, false) => LOOKS_BACK_AHEAD,
            (true, true) => LOOKS_BACK_AT_END,
        };
        let mut tried: Vec<&[usize]> = Vec::new();
        let (mut grown, mut rejected) = (known, Vec::new());
        loop {
            let mut batch: Vec<&Hypothesis> = Vec::new();
            while batch.len() < BATCH.min(limit) {
                let Some(h) = queue.next() else { break };
                if self.is_new(h, *parent, view, &grown)
                    && !tried.iter().any(|t| overlap(&h.tracks, t) > COVERED)
                {
                    tried.push(&h.tracks);
                    let was_dismissed =
                        parent.is_none() && self.dismissed_before.iter().any(|d| d.covers(h));
                    if !was_dismissed {
                        batch.push(h);
                    }
                }
            }
            if batch.is_empty() || self.is_cancelled() {
                return (grown, rejected);
            }
            limit -= batch.len();
            let more: Vec<Option<JointEstimate>> =
                batch.par_iter().map(|h| self.grown_from(h, suspicions)).collect();
            for (h, joint) in batch.iter().zip(&more) {
                if parent.is_none() && !joint.as_ref().is_some_and(|j| self.witness.accepts(j)) {
                    rejected.push(RejectedHypothesis::new(h, joint.as_ref(), view, config));
                }
            }
            grown.extend(more.into_iter().flatten());
        }
    }

    /// What a hypothesis grows to; `None` where nothing follows it.
    fn grown_from(&self, h: &Hypothesis, suspicions: &FrameCandidates) -> Option<JointEstimate> {
        if self.is_cancelled() {
            return None;
        }
        let FrameCandidates { parent, view, candidates, .. } = suspicions;
        let is_hopeless = |j: &JointEstimate| {
            self.is_cancelled()
                || !verification::ALLOWED_CORRELATION.contains(&self.coupling(j, *parent))
        };
        let config = self.config.joints;
        let mut joint = grow::grow_hypothesis(view, h, candidates, config, is_hopeless)?;
        joint.parent = *parent;
        joint.seed.clone_from(&h.tracks);
        self.question(view, &mut joint, candidates);
        self.report("grown", &joint);
        Some(joint)
    }

    /// While a part rests, what moves on it and what moves on its parent are the same. What stands
    /// still beside the part mirrors its joint.
    fn tells(&self, h: &Hypothesis, part: Option<usize>, view: &TracksInFrame) -> bool {
        part.map(|p| &self.joints[p]).is_none_or(|joint| {
            !h.is_still_in(&self.view_from(joint.parent))
                && verification::moves_beside(joint, view, &h.tracks)
        })
    }

    /// Neither what was adopted nor what is grown tells already what a hypothesis would grow to.
    fn is_new(
        &self,
        h: &Hypothesis,
        parent: Option<usize>,
        view: &TracksInFrame,
        grown: &[JointEstimate],
    ) -> bool {
        let mut adopted = self.joints.iter().filter(|j| j.parent == parent);
        if adopted.any(|j| h.is_explained_by(j, view, SOUND_SHARE)) {
            return false;
        }
        !grown.iter().any(|g| {
            // What a hypothesis shares with a sound joint would draw it there again.
            let sound = self.witness.accepts(g) || g.coupling > verification::MAX_CORRELATION;
            let shared = overlap(&h.tracks, &g.members);
            shared > COVERED && (sound || is_found_again(g, grown))
                || sound && shared > 0.5 * COVERED
                || overlap(&h.tracks, &g.seed) > COVERED
                || h.is_explained_by(g, view, if sound { SOUND_SHARE } else { POOR_SHARE })
        })
    }
}

/// Another hypothesis grew to the same already: a person who walks by is suspected in every
/// window.
fn is_found_again(joint: &JointEstimate, grown: &[JointEstimate]) -> bool {
    grown.iter().any(|o| !std::ptr::eq(o, joint) && same_tracks(o, joint))
}

fn same_tracks(a: &JointEstimate, b: &JointEstimate) -> bool {
    overlap(&a.members, &b.members) > SAME && overlap(&b.members, &a.members) > SAME
}
