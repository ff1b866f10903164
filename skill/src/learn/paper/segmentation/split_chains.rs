//! DBSCAN joins two things by a chain of tracks between them. Where its members contradict
//! one another, a cluster is taken apart into groups that agree.

use super::Evidence;
use nalgebra::DMatrix;

/// Share of a group's evidence that must speak for a track to join it,
const JOINS: f64 = 0.8;
/// and below which a member leaves it again.
const LEAVES: f64 = 0.6;
const ROUNDS: usize = 12;

/// Groups of `members` (rows and columns of `evidence`) that agree, largest first found; tracks
/// that agree with no group are left out.
pub fn unchain(
    evidence: &DMatrix<Evidence>,
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

/// The group around the track that is similar to most others.
fn agreeing(evidence: &DMatrix<Evidence>, members: &[usize]) -> Vec<usize> {
    let similar = |a: usize| {
        members.iter().filter(|&&b| evidence[(a, b)] == Evidence::Similar).copied().collect()
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

/// Share of the evidence between a track and a group that says that they are one.
fn share_for(evidence: &DMatrix<Evidence>, a: usize, group: &[usize]) -> Option<f64> {
    let (mut with, mut against) = (0.0, 0.0);
    for &b in group {
        match evidence[(a, b)] {
            Evidence::Similar => with += 1.0,
            Evidence::Different => against += 1.0,
            Evidence::None => {}
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
            true => Evidence::None,
            false if things.iter().any(|t| t.contains(&a) && t.contains(&b)) => Evidence::Similar,
            false => Evidence::Different,
        });
        for (a, b) in [(5, 6), (5, 7), (4, 6)] {
            evidence[(a, b)] = Evidence::Similar;
            evidence[(b, a)] = Evidence::Similar;
        }
        let mut groups = unchain(&evidence, (0..12).collect(), 3);
        groups.sort();
        assert_eq!(groups, vec![(0..6).collect::<Vec<_>>(), (6..12).collect()]);
    }
}
