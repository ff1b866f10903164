//! Where joints are suspected: rigid motions over short windows of time, shared by tracks
//! near one another.

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
    /// First frame.
    pub from: usize,
    /// Last frame.
    pub to: usize,
    /// Takes points at `from` to points at `to`.
    pub motion: Pose,
    /// Tracks that follow it.
    pub tracks: Vec<usize>,
    /// Evidence: tracks times displacement in sigmas, times the squared share that rests
    /// before or after (object parts rest, hands do not).
    pub rank: f64,
}

impl Hypothesis {
    /// A joint moves most of its tracks as they were seen to move in its window. Being among
    /// a joint's members does not suffice: a poor joint takes in whatever is near.
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

    /// Most of its tracks stand still in a view.
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

/// Standard deviations within which two places are one.
const SAME_PLACE_SIGMAS: f64 = 3.0;
/// Windows, in frames.
const WINDOWS: [usize; 3] = [6, 12, 24];
/// Motions looked for in one window.
const MODES: usize = 3;

/// All hypotheses of windows that end after `since`, strongest first.
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
        .flat_map_iter(|&(a, b)| in_window(view, candidates, &resting, a, b, seed))
        .collect();
    found.sort_by(|x, y| y.rank.total_cmp(&x.rank));
    found
}

fn in_window(
    view: &TracksInFrame,
    candidates: &[usize],
    resting: &[bool],
    from: usize,
    to: usize,
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
        let pairs: Vec<Correspondence> = left
            .iter()
            .filter_map(|&t| {
                let (a, b) = (view.at(t, from)?, view.at(t, to)?);
                Some(Correspondence { from: a.point, to: b.point, sigma: b.sigma(), weight: 1.0 })
            })
            .collect();
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
