//! Scores of tracks while a joint is propagated from frame to frame: how often each track was an
//! inlier, and over which configurations it was seen.

use super::estimate::JointEstimate;
use super::tracks_in_part_frame::TracksInFrame;

/// Scores of the tracks of a view, by row.
pub struct TrackScores {
    /// By row: true if the track has a point on the part.
    pub located: Vec<bool>,
    inliers: Vec<usize>,
    outliers: Vec<usize>,
    /// Smallest configuration at which the track was seen.
    low: Vec<f64>,
    /// Largest configuration at which the track was seen.
    high: Vec<f64>,
}

impl TrackScores {
    /// Scores of a joint's members over the frames in which its configuration is known.
    pub fn new(view: &TracksInFrame, joint: &JointEstimate, cut: f64) -> Self {
        let n = view.len();
        let mut scores = Self {
            located: vec![false; n],
            inliers: vec![0; n],
            outliers: vec![0; n],
            low: vec![f64::INFINITY; n],
            high: vec![f64::NEG_INFINITY; n],
        };
        let motions = joint.motions();
        for &t in &joint.members {
            scores.located[t] = true;
            let cost = joint.cost_of(&motions, view, t, cut);
            scores.inliers[t] = cost.inliers;
            scores.outliers[t] = cost.observations - cost.inliers;
            for (f, _) in view.life(t).filter(|(f, _)| joint.known[*f]) {
                scores.widen(t, joint.q[f]);
            }
        }
        scores
    }

    /// Counts an observation of track `t` at configuration `q`, as an inlier or an outlier.
    pub fn count(&mut self, t: usize, q: f64, is_inlier: bool) {
        if is_inlier {
            self.inliers[t] += 1;
        } else {
            self.outliers[t] += 1;
        }
        self.widen(t, q);
    }

    fn widen(&mut self, t: usize, q: f64) {
        self.low[t] = self.low[t].min(q);
        self.high[t] = self.high[t].max(q);
    }

    /// True if a track was an inlier at least four times and in more than three quarters of its
    /// observations, and moved by more than a centimetre.
    pub fn is_trusted(&self, joint: &JointEstimate, t: usize) -> bool {
        self.is_right(t) && (self.high[t] - self.low[t]) * joint.dof.lever(&joint.points[t]) > 0.01
    }

    fn is_right(&self, t: usize) -> bool {
        self.inliers[t] >= 4 && self.inliers[t] > 3 * self.outliers[t]
    }

    /// Weight of a track's vote, 0 to 1.
    pub fn weight(&self, is_trusted: bool, t: usize) -> f64 {
        if is_trusted {
            1.0
        } else if self.is_right(t) {
            0.15
        } else if self.inliers[t] + self.outliers[t] < 4 {
            0.1
        } else {
            0.02
        }
    }

    /// Gives candidates that are seen for the first time their points on the part, from their
    /// places in `frame`, whose configuration is `q`.
    pub fn admit_new_tracks(
        &mut self,
        view: &TracksInFrame,
        joint: &mut JointEstimate,
        candidates: &[usize],
        frame: usize,
        q: f64,
    ) {
        for &t in candidates {
            if let (false, Some(s)) = (self.located[t], view.at(t, frame)) {
                joint.points[t] = joint.dof.move_point(-q, &s.point);
                self.located[t] = true;
                self.widen(t, q);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn a_track_is_trusted_when_it_was_right_often_and_has_moved() {
        let slide = ScrewJoint::slide(Vector3::x(), Point3::origin());
        let view = seen_moving(&slide, &[Point3::new(0.0, 0.0, 1.0)], &[0.0; 9]);
        let mut joint = JointEstimate::new(slide, &view, 0);
        let mut scores = TrackScores::new(&view, &joint, 16.0);
        scores.admit_new_tracks(&view, &mut joint, &[0], 0, 0.0);
        assert!(scores.located[0] && !scores.is_trusted(&joint, 0));
        (0..4).for_each(|_| scores.count(0, 0.001, true));
        assert!(!scores.is_trusted(&joint, 0), "it has hardly moved");
        scores.count(0, 0.05, true);
        assert!(scores.is_trusted(&joint, 0));
        (0..2).for_each(|_| scores.count(0, 0.05, false));
        assert!(!scores.is_trusted(&joint, 0), "it is often wrong");
        assert!(scores.weight(true, 0) > scores.weight(false, 0));
    }
}
