//! Estimates the configuration of a joint in one frame by vote: tracks propose configurations, each
//! proposal is supported by the tracks that agree with it, and the best one is refined.
//!
//! In: observed tracks in the frame of the joint's parent and their points on the part, metres.
//! Out: the configuration, radians or metres, and the number of tracks that agree with it.
//! From: MSAC with samples of one track, then iteratively reweighted least squares.

use super::bundle_adjustment::weight;
use super::estimate::JointEstimate;
use super::screw_joint::ScrewMotion;
use super::tracks_in_part_frame::TracksInFrame;
use crate::learn::ego_motion::BaseObservation;
use nalgebra::Point3;

/// Tracks that vote, with their weights.
pub struct Voters<'v> {
    /// Tracks in the frame of the joint's parent.
    pub view: &'v TracksInFrame,
    /// Rows of the tracks that vote.
    pub tracks: &'v [usize],
    /// Weight of each track that votes.
    pub weights: &'v [f64],
}

/// A configuration and its support.
#[derive(Debug, Clone, Copy)]
pub struct Outcome {
    /// Configuration, radians or metres.
    pub q: f64,
    /// Number of tracks within the cut before the last refinement of `q`.
    pub agreeing: usize,
}

/// Point of a track on the part, its observation in the frame, and the weight of its vote.
type Ballot<'v> = (&'v Point3<f64>, &'v BaseObservation, f64);

/// Share of the total weight from which the guess is taken without other proposals.
const SETTLED: f64 = 0.6;
/// Approximate number of tracks that propose a configuration. Every (n / this)-th of n tracks proposes,
/// so that there are always fewer than twice as many proposals.
const MAX_PROPOSALS: usize = 60;

/// Configuration of `frame` that has most support; `guess` is tried first. A track agrees if its
/// squared Mahalanobis distance is below `cut`.
pub fn vote(
    joint: &JointEstimate,
    voters: &Voters,
    frame: usize,
    guess: Option<f64>,
    cut: f64,
) -> Outcome {
    let Voters { view, tracks, weights } = voters;
    let voters: Vec<Ballot> = tracks
        .iter()
        .zip(*weights)
        .filter_map(|(&t, &w)| Some((&joint.points[t], view.at(t, frame)?, w)))
        .collect();
    let blocks: Vec<SimdBlock> = voters.chunks(LANES).map(SimdBlock::of).collect();
    let support = |q: f64| {
        let (score, agreeing) = support(&blocks, &joint.dof.at(q), cut);
        (score, Outcome { q, agreeing })
    };
    let mut best = support(guess.unwrap_or(0.0));
    let total: f64 = voters.iter().map(|(_, _, w)| w).sum();
    if guess.is_none() || best.0 < SETTLED * total {
        let stride = (voters.len() / MAX_PROPOSALS).max(1);
        for (p, s, _) in voters.iter().step_by(stride) {
            let proposal = support(joint.dof.configuration(p, &s.point));
            if proposal.0 > best.0 {
                best = proposal;
            }
        }
    }
    let Outcome { q, agreeing } = best.1;
    Outcome { q: refined(joint, &voters, q, cut), agreeing }
}

/// Refines a configuration by three steps of reweighted least squares.
fn refined(joint: &JointEstimate, voters: &[Ballot], mut q: f64, cut: f64) -> f64 {
    for _ in 0..3 {
        let (mut numerator, mut denominator) = (0.0, 0.0);
        let at = joint.dof.at(q);
        for (p, s, w) in voters {
            let moved = at.transform(p);
            let w = w * weight(s.distance_sq(&moved), cut);
            if w > 0.0 {
                let direction = s.precision.times(&joint.dof.velocity(&moved));
                numerator -= w * direction.dot(&(moved - s.point));
                denominator += w * direction.dot(&joint.dof.velocity(&moved));
            }
        }
        if denominator > 0.0 {
            q += numerator / (denominator + 1e-9);
        }
    }
    q
}

/// Number of voters that are computed side by side (SIMD).
const LANES: usize = 8;
/// One quantity of all voters of a block.
type Lane = [f64; LANES];

/// A block of voters in one frame, stored by quantity. An empty lane has NaN as its observed point
/// and agrees with nothing.
struct SimdBlock {
    /// Points on the part.
    point: [Lane; 3],
    /// Observed points, in the frame of the joint's parent.
    place: [Lane; 3],
    /// Unit directions of the rays along which the points are observed.
    ray: [Lane; 3],
    /// Inverse variances across the rays.
    across: Lane,
    /// Inverse variances along the rays less those across them.
    excess: Lane,
    weight: Lane,
}

impl SimdBlock {
    fn of(voters: &[Ballot]) -> Self {
        let zeros = [0.0; LANES];
        let mut block = Self {
            point: [zeros; 3],
            place: [[f64::NAN; LANES]; 3],
            ray: [zeros; 3],
            across: zeros,
            excess: zeros,
            weight: zeros,
        };
        for (i, (point, seen, weight)) in voters.iter().enumerate() {
            for r in 0..3 {
                block.point[r][i] = point[r];
                block.place[r][i] = seen.point[r];
                block.ray[r][i] = f64::from(seen.precision.ray[r]);
            }
            block.across[i] = f64::from(seen.precision.across);
            block.excess[i] = f64::from(seen.precision.excess);
            block.weight[i] = *weight;
        }
        block
    }

    /// Points on the part after a joint's motion.
    #[inline(always)]
    fn moved(&self, motion: &ScrewMotion) -> [Lane; 3] {
        let [x, y, z] = motion.rotation.data.0;
        let shift = motion.shift.data.0[0];
        let mut moved = [[0.0; LANES]; 3];
        for (r, row) in moved.iter_mut().enumerate() {
            for (i, m) in row.iter_mut().enumerate() {
                let [px, py, pz] = [self.point[0][i], self.point[1][i], self.point[2][i]];
                *m = x[r] * px + y[r] * py + z[r] * pz + shift[r];
            }
        }
        moved
    }
}

/// Support of a joint's motion (MSAC score, weighted), and the number of voters that agree with it.
#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn support(blocks: &[SimdBlock], motion: &ScrewMotion, cut: f64) -> (f64, usize) {
    let (mut score, mut agreeing) = (0.0, 0);
    for block in blocks {
        let error = difference(&block.moved(motion), &block.place);
        let (norm_sq, along) = (dot(&error, &error), dot(&block.ray, &error));
        let mut distance_sq = [0.0; LANES];
        for i in 0..LANES {
            distance_sq[i] = block.across[i] * norm_sq[i] + block.excess[i] * along[i] * along[i];
        }
        let mut scores = [0.0; LANES];
        for i in 0..LANES {
            let agrees = block.weight[i] * (1.0 - distance_sq[i] / cut);
            scores[i] = if distance_sq[i] < cut { agrees } else { 0.0 };
        }
        for i in 0..LANES {
            score += scores[i];
            agreeing += usize::from(distance_sq[i] < cut);
        }
    }
    (score, agreeing)
}

#[inline(always)]
fn difference(a: &[Lane; 3], b: &[Lane; 3]) -> [Lane; 3] {
    let mut difference = [[0.0; LANES]; 3];
    for r in 0..3 {
        for i in 0..LANES {
            difference[r][i] = a[r][i] - b[r][i];
        }
    }
    difference
}

#[inline(always)]
fn dot(a: &[Lane; 3], b: &[Lane; 3]) -> Lane {
    let mut dot = [0.0; LANES];
    for i in 0..LANES {
        dot[i] = a[0][i] * b[0][i] + a[1][i] * b[1][i] + a[2][i] * b[2][i];
    }
    dot
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn most_agree_whatever_the_others_say(
            hinge: bool,
            pitch in prop::option::of(0.02..0.1_f64),
            q in -1.0..1.0_f64,
            guess in prop::option::of(-1.0..1.0_f64),
            outliers in 0..6_usize,
        ) {
            let axis = Vector3::new(0.1, 1.0, -0.2).normalize();
            let origin = Point3::new(0.05, 0.0, 1.3);
            let dof = ScrewJoint { hinge, axis, origin, pitch: pitch.filter(|_| hinge) };
            let places: Vec<Point3<f64>> = (0..21)
                .map(f64::from)
                .map(|i| Point3::new(0.2 + 0.02 * i, 0.3 * (i * 1.3).sin(), 1.2 + 0.02 * i))
                .collect();
            let view = seen_moving(&dof, &places, &[0.0, q]);
            let mut joint = JointEstimate::new(dof, &view, 0);
            joint.points = places;
            for (i, point) in joint.points.iter_mut().enumerate().take(outliers) {
                *point += Vector3::new(0.3, 0.1 * i as f64, -0.2);
            }
            let tracks: Vec<usize> = (0..21).collect();
            let voters = Voters { view: &view, tracks: &tracks, weights: &[1.0; 21] };
            let outcome = vote(&joint, &voters, 1, guess, 16.0);
            prop_assert!((outcome.q - q).abs() < 0.01, "{} instead of {q}", outcome.q);
            prop_assert!((21 - outliers..=21).contains(&outcome.agreeing));
        }
    }
}
