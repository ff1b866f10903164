//! Propagates a joint from the frames of known configuration to all others, forwards and backwards:
//! the tracks vote for the configuration of the next frame, tracks that are seen for the first time
//! get their point on the part, and every few frames the joint is refined.
//!
//! In: a joint that is known in some frames, and candidate tracks in the frame of its parent,
//! metres.
//! Out: the joint in that frame, known in more frames; radians or metres.

use super::bundle_adjustment::{OUTLIER_CUT, locate_points, refine};
use super::configuration_vote::{Voters, vote};
use super::estimate::JointEstimate;
use super::track_scores::TrackScores;
use super::tracks_in_part_frame::TracksInFrame;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Largest number of consecutive frames without a configuration; after more, propagation stops.
pub const MAX_LOST: usize = 12;
/// Smallest number of frames between two refinements.
const REFINE_EVERY: usize = 8;
/// Divisor of the number of known frames that gives the smallest number of frames between two
/// refinements: the more frames are known, the less a few more add.
const REFINE_SHARE: usize = 6;
/// Number of bundle adjustment steps in a refinement.
const GROWTH_STEPS: usize = 2;
/// Largest number of tracks in a refinement.
const REFINE_TRACKS: usize = 80;

/// State of a joint that is propagated through the recording.
struct Propagation<'p> {
    view: &'p TracksInFrame,
    candidates: &'p [usize],
    joint: JointEstimate,
    scores: TrackScores,
    rng: ChaCha8Rng,
}

/// Propagates a joint to all frames that it can reach by the tracks `candidates`.
pub fn propagate(
    view: &TracksInFrame,
    joint: JointEstimate,
    candidates: &[usize],
) -> JointEstimate {
    let known = joint.known_frames();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else { return joint };
    let scores = TrackScores::new(view, &joint, OUTLIER_CUT);
    let rng = ChaCha8Rng::seed_from_u64(first as u64);
    let mut propagation = Propagation { view, candidates, joint, scores, rng };
    propagation.through(first..view.frames);
    propagation.through((0..last + 1).rev());
    propagation.joint
}

impl Propagation<'_> {
    fn through(&mut self, frames: impl Iterator<Item = usize>) {
        let mut q = 0.0;
        let (mut lost, mut since_refined) = (0, 0);
        for f in frames {
            if !self.view.usable[f] {
                continue;
            }
            if self.joint.known[f] {
                q = self.joint.q[f];
                lost = 0;
                self.admit_new_tracks(f, q);
                continue;
            }
            match self.configuration(f, q) {
                Some(found) => {
                    q = found;
                    lost = 0;
                    self.joint.q[f] = q;
                    self.joint.known[f] = true;
                    self.admit_new_tracks(f, q);
                }
                None => lost += 1,
            }
            if lost > MAX_LOST {
                return;
            }
            since_refined += 1;
            let known = self.joint.known_frames();
            if since_refined >= REFINE_EVERY.max(known.len() / REFINE_SHARE) {
                since_refined = 0;
                self.refine(f);
                if let Some(near) = known.into_iter().min_by_key(|k| k.abs_diff(f)) {
                    q = self.joint.q[near];
                }
            }
        }
    }

    fn admit_new_tracks(&mut self, frame: usize, q: f64) {
        let Self { view, candidates, joint, scores, .. } = self;
        scores.admit_new_tracks(view, joint, candidates, frame, q);
    }

    /// Configuration of a frame near `guess`, if enough tracks vote for it; each track is then
    /// counted as an inlier or an outlier.
    fn configuration(&mut self, frame: usize, guess: f64) -> Option<f64> {
        let Self { view, joint, scores, .. } = self;
        let seen = |t: &usize| scores.located[*t] && view.at(*t, frame).is_some();
        let alive: Vec<usize> = self.candidates.iter().copied().filter(seen).collect();
        if alive.is_empty() {
            return None;
        }
        let trusted: Vec<bool> = alive.iter().map(|&t| scores.is_trusted(joint, t)).collect();
        let weights: Vec<f64> =
            alive.iter().zip(&trusted).map(|(&t, &trusted)| scores.weight(trusted, t)).collect();
        let cut = 2.0 * OUTLIER_CUT;
        let voters = Voters { view, tracks: &alive, weights: &weights };
        let q = vote(joint, &voters, frame, Some(guess), cut).q;
        let is_inlier = |&t: &usize| {
            let place = joint.dof.move_point(q, &joint.points[t]);
            view.at(t, frame).is_some_and(|s| s.distance_sq(&place) < cut)
        };
        let agrees: Vec<bool> = alive.iter().map(is_inlier).collect();
        if !is_convincing(&trusted, &weights, &agrees) {
            return None;
        }
        for (&t, &agrees) in alive.iter().zip(&agrees) {
            scores.count(t, q, agrees);
        }
        Some(q)
    }

    /// Refines the joint on trusted tracks, and updates the points of all located tracks that are
    /// seen in `frame`.
    fn refine(&mut self, frame: usize) {
        let Self { view, candidates, joint, scores, rng } = self;
        let located: Vec<usize> =
            candidates.iter().copied().filter(|&t| scores.located[t]).collect();
        let mut trusted: Vec<usize> =
            located.iter().copied().filter(|&t| scores.is_trusted(joint, t)).collect();
        if trusted.len() < 4 {
            return;
        }
        if trusted.len() > REFINE_TRACKS {
            trusted.shuffle(rng);
            trusted.truncate(REFINE_TRACKS);
        }
        refine(joint, view, &trusted, OUTLIER_CUT, GROWTH_STEPS);
        let alive: Vec<usize> =
            located.into_iter().filter(|&t| view.at(t, frame).is_some()).collect();
        locate_points(joint, view, &alive, 4.0 * OUTLIER_CUT);
    }
}

/// True if enough of the trusted tracks agree with a configuration or, where few are trusted,
/// enough of all tracks.
fn is_convincing(trusted: &[bool], weights: &[f64], agrees: &[bool]) -> bool {
    let trusted_count = trusted.iter().filter(|t| **t).count();
    let trusted_agreeing = trusted.iter().zip(agrees).filter(|(t, a)| **t && **a).count();
    let agreeing = agrees.iter().filter(|a| **a).count();
    let weight_agreeing: f64 =
        weights.iter().zip(agrees).filter(|(_, a)| **a).map(|(w, _)| w).sum();
    (trusted_agreeing >= 3 && trusted_agreeing as f64 >= 0.35 * trusted_count as f64)
        || (trusted_agreeing >= 2 && trusted_count <= 3)
        || (trusted_count < 3
            && agreeing >= 5
            && weight_agreeing >= 0.6 * weights.iter().sum::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn a_slide_that_is_known_in_a_few_frames_is_found_in_all() {
        let slide = ScrewJoint::slide(Vector3::x(), Point3::new(0.0, 0.0, 1.0));
        let q: Vec<f64> = (0..60).map(|f| 0.006 * f64::from(f)).collect();
        let places: Vec<Point3<f64>> =
            (0..12).map(|i| Point3::new(0.0, 0.03 * f64::from(i), 1.0)).collect();
        let view = seen_moving(&slide, &places, &q);
        let mut joint = JointEstimate::new(slide, &view, 20);
        joint.points.clone_from(&places);
        joint.members = (0..12).collect();
        joint.q[20..30].copy_from_slice(&q[20..30]);
        joint.known[20..30].fill(true);
        let candidates: Vec<usize> = (0..12).collect();
        let found = propagate(&view, joint, &candidates);
        assert!(found.known.iter().all(|k| *k));
        let moved = found.q[59] - found.q[0];
        assert!((moved - q[59]).abs() < 0.01, "{moved}");
    }
}
