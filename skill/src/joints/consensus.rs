//! The configuration of one frame: each track proposes one, most agree on the answer.

use super::adjust::weight;
use super::grown::Grown;
use super::view::{Seen, View};
use nalgebra::Point3;

/// A configuration and how it was agreed on.
#[derive(Debug, Clone, Copy)]
pub struct Agreement {
    /// The configuration.
    pub q: f64,
    /// Tracks within the cut.
    pub agreeing: usize,
}

/// Share of all support from which a guess needs no rivals.
const SETTLED: f64 = 0.6;
/// Proposals that are tried, at the most.
const MAX_PROPOSALS: usize = 60;

/// The configuration of `frame` that most weight of `tracks` agrees on; `guess` is tried
/// first.
pub fn agree(
    joint: &Grown,
    view: &View,
    tracks: &[usize],
    weights: &[f64],
    frame: usize,
    guess: Option<f64>,
    cut: f64,
) -> Agreement {
    let voters: Vec<(&Point3<f64>, &Seen, f64)> = tracks
        .iter()
        .zip(weights)
        .filter_map(|(&t, &w)| Some((&joint.points[t], view.at(t, frame)?, w)))
        .collect();
    let support = |q: f64| {
        let (mut score, mut agreeing) = (0.0, 0);
        let at = joint.dof.at(q);
        for (p, s, w) in &voters {
            let r = s.distance_sq(&at.forth(p));
            if r < cut {
                score += w * (1.0 - r / cut);
                agreeing += 1;
            }
        }
        (score, Agreement { q, agreeing })
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
    let mut agreement = best.1;
    for _ in 0..3 {
        let (mut numerator, mut denominator) = (0.0, 0.0);
        let at = joint.dof.at(agreement.q);
        for (p, s, w) in &voters {
            let moved = at.forth(p);
            let w = w * weight(s.distance_sq(&moved), cut);
            if w > 0.0 {
                let direction = s.information * joint.dof.velocity(&moved);
                numerator -= w * direction.dot(&(moved - s.point));
                denominator += w * direction.dot(&joint.dof.velocity(&moved));
            }
        }
        if denominator > 0.0 {
            agreement.q += numerator / (denominator + 1e-9);
        }
    }
    agreement
}
