//! A joint hypothesis with all that it has gathered.

use super::screw_joint::{ScrewJoint, ScrewMotion};
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::rigid::Pose;
use nalgebra::Point3;

/// A joint, its configuration over time, and the tracks that follow it.
#[derive(Debug, Clone)]
pub struct JointEstimate {
    /// The joint, in its parent's frame.
    pub dof: ScrewJoint,
    /// Configuration by frame; meaningful where `known`.
    pub q: Vec<f64>,
    /// Frames with a configuration.
    pub known: Vec<bool>,
    /// Configuration by frame, interpolated between known ones.
    pub filled: Vec<f64>,
    /// Part point of each track of the view, at configuration 0.
    pub points: Vec<Point3<f64>>,
    /// Tracks of the hypothesis that it grew from.
    pub seed: Vec<usize>,
    /// Tracks that follow it.
    pub members: Vec<usize>,
    /// The frame whose configuration is pinned: q has no zero of its own.
    pub anchor: usize,
    /// How much better it explains its tracks than standing still does.
    pub gain: f64,
    /// Cost an observation.
    pub cost: f64,
    /// Least and greatest configuration, strays left out.
    pub range: [f64; 2],
    /// Share of its points that were seen through.
    pub through: f64,
    /// Share of its points that would be seen through if it stood half its range aside: points
    /// on a wall agree with the pictures wherever they are.
    pub tells: f64,
    /// Share of its points not found in frames of unknown configuration.
    pub hidden: f64,
    /// Share of q's variance that the parent's q explains; negative: the parent rests.
    pub coupling: f64,
    /// Share of its members' observations in frames of unknown configuration: what moves on
    /// where the joint does not explain it is a hand.
    pub unruly: f64,
    /// Configuration at keyframes from depth alone, NaN elsewhere.
    pub scanned: Vec<f64>,
    /// Index of the parent joint; `None` for the base.
    pub parent: Option<usize>,
    /// Frames in which the depth pictures contradict it.
    pub contradicted: Vec<usize>,
}

impl JointEstimate {
    /// A joint that nothing follows yet.
    pub fn new(dof: ScrewJoint, view: &TracksInFrame, anchor: usize) -> Self {
        Self {
            dof,
            q: vec![0.0; view.frames],
            known: vec![false; view.frames],
            filled: vec![0.0; view.frames],
            points: vec![Point3::origin(); view.len()],
            seed: Vec::new(),
            members: Vec::new(),
            anchor,
            gain: f64::NEG_INFINITY,
            cost: f64::INFINITY,
            range: [0.0, 0.0],
            through: 0.0,
            tells: 0.0,
            hidden: 0.0,
            coupling: 0.0,
            unruly: 0.0,
            scanned: vec![f64::NAN; view.frames],
            parent: None,
            contradicted: Vec::new(),
        }
    }

    /// Frames with a known configuration, ascending.
    pub fn known_frames(&self) -> Vec<usize> {
        (0..self.known.len()).filter(|&f| self.known[f]).collect()
    }

    /// Length of the range.
    pub fn span(&self) -> f64 {
        self.range[1] - self.range[0]
    }

    /// Fills `filled` by interpolation and `range` by the 1st and 99th percentile.
    pub fn summarise(&mut self) {
        let frames = self.known_frames();
        if frames.is_empty() {
            return;
        }
        for f in 0..self.q.len() {
            let after = frames.partition_point(|&k| k < f);
            self.filled[f] = match (after.checked_sub(1), frames.get(after)) {
                (_, Some(&b)) if b == f => self.q[f],
                (Some(a), Some(&b)) => {
                    let a = frames[a];
                    let share = (f - a) as f64 / (b - a) as f64;
                    self.q[a] + share * (self.q[b] - self.q[a])
                }
                (Some(a), None) => self.q[frames[a]],
                (None, Some(&b)) => self.q[b],
                (None, None) => 0.0,
            };
        }
        let mut sorted: Vec<f64> = frames.iter().map(|&f| self.q[f]).collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len() - 1;
        let stray = last / 100;
        self.range = [sorted[stray], sorted[last - stray]];
    }

    /// What the joint does in each frame; meaningful where `known`.
    pub fn motions(&self) -> Vec<ScrewMotion> {
        self.q.iter().map(|&q| self.dof.at(q)).collect()
    }

    /// Truncated cost, observations and inliers of a track under the joint, whose `motions` are
    /// given.
    pub fn cost_of(
        &self,
        motions: &[ScrewMotion],
        view: &TracksInFrame,
        track: usize,
        cut: f64,
    ) -> TrackCost {
        let mut cost = TrackCost::default();
        for (f, s) in view.life(track).filter(|(f, _)| self.known[*f]) {
            let r = s.distance_sq(&motions[f].transform(&self.points[track]));
            cost.sum += r.min(cut);
            cost.observations += 1;
            cost.inliers += usize::from(r < cut);
        }
        cost
    }

    /// What `unruly` is now.
    pub fn unruly_share(&self, view: &TracksInFrame) -> f64 {
        let (mut all, mut unruly) = (0_usize, 0_usize);
        for (f, _) in self.members.iter().flat_map(|&t| view.life(t)) {
            all += 1;
            unruly += usize::from(!self.known[f]);
        }
        unruly as f64 / all.max(1) as f64
    }

    /// Length that a track's point travels over the frames in which it is seen.
    pub fn travel(&self, view: &TracksInFrame, track: usize) -> f64 {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (f, _) in view.life(track).filter(|(f, _)| self.known[*f]) {
            low = low.min(self.q[f]);
            high = high.max(self.q[f]);
        }
        if high < low { 0.0 } else { (high - low) * self.dof.lever(&self.points[track]) }
    }
}

/// How a track fares under a joint.
#[derive(Debug, Clone, Copy, Default)]
pub struct TrackCost {
    /// Sum of truncated squared Mahalanobis distances.
    pub sum: f64,
    /// Observations.
    pub observations: usize,
    /// Those within the cut.
    pub inliers: usize,
}

/// Part motions in the base since the first frame, by joint and frame.
pub fn base_from_part(joints: &[JointEstimate], index: usize, frame: usize) -> Pose {
    let joint = &joints[index];
    let own = joint.dof.geometry().motion(joint.filled[frame]);
    match joint.parent {
        None => own,
        Some(p) => base_from_part(joints, p, frame) * own,
    }
}
