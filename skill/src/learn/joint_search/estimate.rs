//! State of one joint during the search: its line, its configuration by frame, the tracks that
//! follow it, and the result of the last verification.
//!
//! Lines and points are in the frame of the joint's parent (the base frame if it has none), metres;
//! configurations are in radians for hinges and in metres for slides.

use super::evidence::Evidence;
use super::screw_joint::{ScrewJoint, ScrewMotion};
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::rigid::{Pose, matrix_pose};
use nalgebra::{IsometryMatrix3, Point3};

/// A joint with its configuration over time and the tracks that follow it.
#[derive(Debug, Clone)]
pub struct JointEstimate {
    /// Type and line of the joint, in its parent's frame.
    pub dof: ScrewJoint,
    /// Configuration by frame, radians or metres; valid only where `known`.
    pub q: Vec<f64>,
    /// By frame: true if the configuration was estimated.
    pub known: Vec<bool>,
    /// Configuration by frame, interpolated linearly between known frames and constant beyond them.
    pub filled: Vec<f64>,
    /// Point on the part for each track of the view, at configuration 0, in the parent's frame,
    /// metres.
    pub points: Vec<Point3<f64>>,
    /// Tracks of the motion hypothesis from which the joint was grown.
    pub seed: Vec<usize>,
    /// Tracks that follow the joint, by row in the view.
    pub members: Vec<usize>,
    /// Frame whose configuration bundle adjustment holds fixed, because the zero of q is free.
    pub anchor: usize,
    /// Cost of the members at rest less their cost under the joint, scaled, less a penalty for each
    /// known frame (see `association`). No unit.
    pub gain: f64,
    /// Mean truncated squared Mahalanobis distance of the members' observations.
    pub cost: f64,
    /// 1st and 99th percentile of the known configurations, radians or metres.
    pub range: [f64; 2],
    /// Index of the parent joint; `None` for the base.
    pub parent: Option<usize>,
    /// Result of the last verification.
    pub evidence: Evidence,
}

impl JointEstimate {
    /// A joint without tracks and without known configurations.
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
            parent: None,
            evidence: Evidence::none(view.frames),
        }
    }

    /// Frames with a known configuration, ascending.
    pub fn known_frames(&self) -> Vec<usize> {
        (0..self.known.len()).filter(|&f| self.known[f]).collect()
    }

    /// Length of the range, radians or metres.
    pub fn span(&self) -> f64 {
        self.range[1] - self.range[0]
    }

    /// Fills `filled` by linear interpolation, and `range` by the 1st and 99th percentile.
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

    /// Motion of the part in each frame; valid only where `known`.
    pub fn motions(&self) -> Vec<ScrewMotion> {
        self.q.iter().map(|&q| self.dof.at(q)).collect()
    }

    /// Truncated cost, observations and inliers of a track under the joint. `motions` are
    /// [`Self::motions`]; an inlier has a squared Mahalanobis distance below `cut`.
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

    /// Share of the members' observations, 0 to 1, in frames of unknown configuration.
    pub fn uncovered_ratio(&self, view: &TracksInFrame) -> f64 {
        let (mut all, mut uncovered) = (0_usize, 0_usize);
        for (f, _) in self.members.iter().flat_map(|&t| view.life(t)) {
            all += 1;
            uncovered += usize::from(!self.known[f]);
        }
        uncovered as f64 / all.max(1) as f64
    }

    /// Share of the joint's points, over all frames, that depth images do not show, 0 to 1.
    pub fn missing_share(&self, evidence: &Evidence) -> f64 {
        evidence.unobserved_ratio * (1.0 - self.coverage())
    }

    /// Share of the frames, 0 to 1, in which the configuration is known.
    pub fn coverage(&self) -> f64 {
        self.known_frames().len() as f64 / self.known.len() as f64
    }

    /// The tracks of `view`, which is in the parent's frame, transformed into the frame of the
    /// joint's part.
    pub fn tracks_in_part_frame(&self, view: &TracksInFrame) -> TracksInFrame {
        let geometry = self.dof.geometry();
        let motion = |&q: &f64| matrix_pose(&geometry.motion(-q));
        let part_from_view: Vec<IsometryMatrix3<f64>> = self.filled.iter().map(motion).collect();
        view.carried(&part_from_view, &self.known)
    }

    /// Length of the path between the extreme configurations at which a track is seen, metres.
    pub fn travel(&self, view: &TracksInFrame, track: usize) -> f64 {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (f, _) in view.life(track).filter(|(f, _)| self.known[*f]) {
            low = low.min(self.q[f]);
            high = high.max(self.q[f]);
        }
        if high < low { 0.0 } else { (high - low) * self.dof.lever(&self.points[track]) }
    }
}

/// How well a joint explains one track.
#[derive(Debug, Clone, Copy, Default)]
pub struct TrackCost {
    /// Sum of truncated squared Mahalanobis distances.
    pub sum: f64,
    /// Number of observations in frames of known configuration.
    pub observations: usize,
    /// Number of observations within the cut.
    pub inliers: usize,
}

/// Motion of a joint's part in the base frame: from configuration 0 of all joints to their
/// configurations at `frame`.
pub fn base_from_part(joints: &[JointEstimate], index: usize, frame: usize) -> Pose {
    let joint = &joints[index];
    let own = joint.dof.geometry().motion(joint.filled[frame]);
    match joint.parent {
        None => own,
        Some(p) => base_from_part(joints, p, frame) * own,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::Vector3;

    #[test]
    fn unknown_configurations_are_interpolated_and_outliers_leave_the_range() {
        let slide = ScrewJoint::slide(Vector3::x(), Point3::origin());
        let view = seen_moving(&slide, &[Point3::new(0.0, 0.0, 1.0)], &[0.0; 201]);
        let mut joint = JointEstimate::new(slide, &view, 0);
        joint.q = (0..201).map(|f| 0.001 * f64::from(f)).collect();
        joint.q[100] = 9.0;
        joint.known = (0..201).map(|f| f != 50).collect();
        joint.summarise();
        assert!((joint.filled[50] - 0.05).abs() < 1e-12);
        assert!(joint.span() < 0.21, "{}", joint.span());
        assert_eq!(joint.coverage(), 200.0 / 201.0);
    }

    #[test]
    fn tracks_rest_in_the_frame_of_their_part() {
        let slide = ScrewJoint::slide(Vector3::x(), Point3::origin());
        let q: Vec<f64> = (0..30).map(|f| 0.01 * f64::from(f)).collect();
        let view = seen_moving(&slide, &[Point3::new(0.0, 0.0, 1.0)], &q);
        let mut joint = JointEstimate::new(slide, &view, 0);
        joint.q.clone_from(&q);
        joint.known = vec![true; 30];
        joint.summarise();
        assert!(view.moves(0, 0.015, 4.0));
        assert!(!joint.tracks_in_part_frame(&view).moves(0, 0.015, 4.0));
    }
}
