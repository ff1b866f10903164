//! Splits clusters in which DBSCAN joined two things by a chain of tracks between them: where the
//! members contradict one another, a cluster is divided into groups that agree.

use super::pair_evidence::PairEvidence;
use nalgebra::DMatrix;

/// Smallest share of a track's evidence that must support a group before the track joins it.
const JOINS: f64 = 0.8;
/// Smallest share of a member's evidence that must support its group; below it the member leaves.
const LEAVES: f64 = 0.6;
/// Largest number of rounds of joining and leaving.
const ROUNDS: usize = 12;

/// Groups of `members` (rows and columns of `evidence`) that agree, each of at least `smallest`
/// tracks, in the order in which they are found; tracks that agree with no group are left out.
pub fn split_chained_clusters(
    evidence: &DMatrix<PairEvidence>,
    mut members: Vec<usize>,
    smallest: usize,
) -> Vec<Vec<usize>> {
    let mut groups = Vec::new();
    while members.len() >= smallest {
        let group = agreeing(evidence, &members);
        if group.len() < smallest {
            break;
        }
        members.retain(|m| !group.contains(m));
        groups.push(group);
    }
    groups
}

/// The group that agrees with the track that is similar to the most others.
fn agreeing(evidence: &DMatrix<PairEvidence>, members: &[usize]) -> Vec<usize> {
    let similar = |a: usize| {
        members.iter().filter(|&&b| evidence[(a, b)] == PairEvidence::Similar).copied().collect()
    };
    let mut group: Vec<usize> =
        members.iter().map(|&a| similar(a)).max_by_key(Vec::len).unwrap_or_default();
    for _ in 0..ROUNDS {
        let next: Vec<usize> = members
            .iter()
            .copied()
            .filter(|&a| {
                let needed = if group.contains(&a) { LEAVES } else { JOINS };
                share_for(evidence, a, &group).is_some_and(|share| share >= needed)
            })
            .collect();
        if next == group {
            break;
        }
        group = next;
    }
    group
}

/// Share of the evidence between a track and a group that supports that they are one thing; `None`
/// if none does.
fn share_for(evidence: &DMatrix<PairEvidence>, a: usize, group: &[usize]) -> Option<f64> {
    let (mut with, mut against) = (0.0, 0.0);
    for &b in group {
        match evidence[(a, b)] {
            PairEvidence::Similar => with += 1.0,
            PairEvidence::Different => against += 1.0,
            PairEvidence::None => {}
        }
    }
    (with > 0.0).then(|| with / (with + against))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_things_joined_by_a_bridge_come_apart() {
        let things = [0..6, 6..12];
        let mut evidence = DMatrix::from_fn(12, 12, |a, b| match a == b {
            true => PairEvidence::None,
            false if things.iter().any(|t| t.contains(&a) && t.contains(&b)) => {
                PairEvidence::Similar
            }
            false => PairEvidence::Different,
        });
        for (a, b) in [(5, 6), (5, 7), (4, 6)] {
            evidence[(a, b)] = PairEvidence::Similar;
            evidence[(b, a)] = PairEvidence::Similar;
        }
        let mut groups = split_chained_clusters(&evidence, (0..12).collect(), 3);
        groups.sort();
        assert_eq!(groups, vec![(0..6).collect::<Vec<_>>(), (6..12).collect()]);
    }
}
