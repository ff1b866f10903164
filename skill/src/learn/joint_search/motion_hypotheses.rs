//! Motion hypotheses: rigid motions over short windows of time that neighbouring tracks share. Each
//! may be a part that a joint moves, or a hand.
//!
//! In: the tracks in the frame of a part, metres. Out: hypotheses in that frame, the strongest
//! first.
//! From: sequential RANSAC with local samples.

use super::config::JointSearchConfig;
use super::estimate::JointEstimate;
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::ransac::{Correspondence, RansacOptions, ransac_rigid};
use crate::math::rigid::Pose;
use nalgebra::Point3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// A rigid motion of some tracks between two frames.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// First frame of the window.
    pub from: usize,
    /// Last frame of the window.
    pub to: usize,
    /// Rigid motion that takes points at frame `from` to points at frame `to`, metres.
    pub motion: Pose,
    /// Tracks that follow the motion.
    pub tracks: Vec<usize>,
    /// Strength: number of tracks times their displacement in standard deviations, times the
    /// squared share of them that rest before or after. Parts of objects rest, hands do not.
    pub rank: f64,
}

impl Hypothesis {
    /// True if a joint moves most of the tracks as they were observed to move in the window: the
    /// error is at most `max_share` of the displacement. Membership in the joint does not suffice,
    /// because a poor joint gathers whatever is near.
    pub fn is_explained_by(
        &self,
        joint: &JointEstimate,
        view: &TracksInFrame,
        max_share: f64,
    ) -> bool {
        let mut known = (self.from..=self.to).filter(|&f| joint.known[f]);
        let (Some(first), Some(last)) = (known.next(), known.next_back()) else { return false };
        let (at_first, at_last) = (joint.dof.at(joint.q[first]), joint.dof.at(joint.q[last]));
        let carried = |p: &Point3<f64>| at_last.transform(&at_first.inverse_transform(p));
        2 * (last - first) >= self.to - self.from
            && self.most_tracks(|t| {
                let (Some(a), Some(b)) = (view.at(t, first), view.at(t, last)) else {
                    return false;
                };
                let error = (carried(&a.point) - b.point).norm();
                error < SAME_PLACE_SIGMAS * b.sigma()
                    && error < max_share * (b.point - a.point).norm()
            })
    }

    /// True if most of the tracks stand still in `view` from the first to the last frame of the
    /// window.
    pub fn is_still_in(&self, view: &TracksInFrame) -> bool {
        self.most_tracks(|t| {
            let (Some(a), Some(b)) = (view.at(t, self.from), view.at(t, self.to)) else {
                return false;
            };
            (a.point - b.point).norm() < SAME_PLACE_SIGMAS * b.sigma()
        })
    }

    fn most_tracks(&self, is_so: impl Fn(usize) -> bool) -> bool {
        let count = self.tracks.iter().filter(|&&t| is_so(t)).count();
        10 * count > 6 * self.tracks.len()
    }
}

/// Share of a hypothesis's tracks in another hypothesis from which it adds nothing.
pub const COVERED: f64 = 0.6;
/// Number of standard deviations within which two places are taken as the same.
const SAME_PLACE_SIGMAS: f64 = 3.0;
/// Lengths of the windows, frames.
const WINDOWS: [usize; 3] = [6, 12, 24];
/// Largest number of motions that are searched in one window.
const MODES: usize = 3;

/// All hypotheses of windows that end in frame `since` or later, the strongest first.
pub fn hypotheses(
    view: &TracksInFrame,
    candidates: &[usize],
    since: usize,
    config: &JointSearchConfig,
    seed: u64,
) -> Vec<Hypothesis> {
    let resting: Vec<bool> = (0..view.len())
        .map(|t| view.rest_lengths(t).iter().any(|&n| n >= config.rest_frames))
        .collect();
    let windows: Vec<(usize, usize)> = WINDOWS
        .iter()
        .flat_map(|&w| {
            (0..view.frames.saturating_sub(w)).step_by((w / 3).max(3)).map(move |a| (a, a + w))
        })
        .filter(|&(a, b)| b >= since && view.usable[a] && view.usable[b])
        .collect();
    let mut found: Vec<Hypothesis> = windows
        .par_iter()
        .flat_map_iter(|&window| in_window(view, candidates, &resting, window, seed))
        .collect();
    found.sort_by(|x, y| y.rank.total_cmp(&x.rank));
    found
}

/// Rigid motions between two frames, found one after the other in the tracks that are left.
fn in_window(
    view: &TracksInFrame,
    candidates: &[usize],
    resting: &[bool],
    (from, to): (usize, usize),
    seed: u64,
) -> Vec<Hypothesis> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ ((from as u64) << 20) ^ ((to as u64) << 40));
    let mut left: Vec<usize> = candidates
        .iter()
        .copied()
        .filter(|&t| {
            let (Some(a), Some(b)) = (view.at(t, from), view.at(t, to)) else { return false };
            b.is_away_from(&a.point)
        })
        .collect();
    let mut found = Vec::new();
    for _ in 0..MODES {
        if left.len() < 4 {
            break;
        }
        let pairs = view.correspondences(&left, from, to);
        let options = RansacOptions { cut: 1.5, iterations: 80, locality: Some(0.3) };
        let Some(motion) = ransac_rigid(&pairs, &options, None, &mut rng) else { break };
        if motion.inliers.len() < 4 {
            break;
        }
        let tracks: Vec<usize> = motion.inliers.iter().map(|&i| left[i]).collect();
        let n = tracks.len() as f64;
        let mean = |f: &dyn Fn(&Correspondence) -> f64| {
            motion.inliers.iter().map(|&i| f(&pairs[i])).sum::<f64>() / n
        };
        let displacement = mean(&|p| (p.to - p.from).norm()).min(0.15);
        let share = tracks.iter().filter(|&&t| resting[t]).count() as f64 / n;
        let rank = n * displacement / mean(&|p| p.sigma) * (share * share + 0.02);
        left.retain(|t| !tracks.contains(t));
        found.push(Hypothesis { from, to, motion: motion.motion, tracks, rank });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::Vector3;

    /// Ten points on a drawer that rests, opens in 30 frames and rests.
    fn drawer() -> (ScrewJoint, Vec<f64>, TracksInFrame) {
        let slide = ScrewJoint::slide(Vector3::z(), Point3::origin());
        let q: Vec<f64> = (0..60_i32).map(|f| 0.01 * f64::from(f.clamp(15, 45) - 15)).collect();
        let places: Vec<Point3<f64>> =
            (0..10).map(|i| Point3::new(0.03 * f64::from(i), 0.1, 1.5)).collect();
        let view = seen_moving(&slide, &places, &q);
        (slide, q, view)
    }

    #[test]
    fn the_strongest_hypothesis_of_a_drawer_is_most_of_it_as_it_opens() {
        let (_, q, view) = drawer();
        let all: Vec<usize> = (0..10).collect();
        let found = hypotheses(&view, &all, 0, &JointSearchConfig::default(), 1);
        let best = &found[0];
        assert!(best.tracks.len() >= 8, "{:?}", best.tracks);
        let middle = Point3::new(0.135, 0.1, 1.5 + q[best.from]);
        let way = (best.motion * middle - middle).z;
        assert!((way - (q[best.to] - q[best.from])).abs() < 0.005, "{way}");
        assert!(!best.is_still_in(&view));
        let early = hypotheses(&view, &all, 50, &JointSearchConfig::default(), 1);
        assert!(early.iter().all(|h| h.to >= 50));
    }

    #[test]
    fn a_joint_explains_the_hypothesis_of_its_own_motion_only() {
        let (slide, q, view) = drawer();
        let all: Vec<usize> = (0..10).collect();
        let found = hypotheses(&view, &all, 0, &JointSearchConfig::default(), 1);
        let mut joint = JointEstimate::new(slide, &view, 0);
        (joint.q, joint.known) = (q, vec![true; 60]);
        assert!(found[0].is_explained_by(&joint, &view, 0.5));
        joint.q.iter_mut().for_each(|q| *q = -*q);
        assert!(!found[0].is_explained_by(&joint, &view, 0.5));
    }
}
