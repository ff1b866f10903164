//! DBSCAN (Ester et al. 1996) over given neighbourhoods.

/// Clusters of points: `neighbours[i]` lists the points within epsilon of `i`, without `i`. A core
/// point has at least `min_neighbours` of them; a border point joins the first core that reaches
/// it; all other points are noise, in no cluster.
pub fn dbscan(neighbours: &[Vec<usize>], min_neighbours: usize) -> Vec<Vec<usize>> {
    let mut taken = vec![false; neighbours.len()];
    let is_core = |i: usize| neighbours[i].len() >= min_neighbours;
    let mut clusters = Vec::new();
    for seed in 0..neighbours.len() {
        if taken[seed] || !is_core(seed) {
            continue;
        }
        taken[seed] = true;
        let mut members = vec![seed];
        let mut next = 0;
        while next < members.len() {
            let point = members[next];
            next += 1;
            if !is_core(point) {
                continue;
            }
            for &other in &neighbours[point] {
                if !taken[other] {
                    taken[other] = true;
                    members.push(other);
                }
            }
        }
        clusters.push(members);
    }
    clusters
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_chains_and_a_loner_are_two_clusters() {
        let neighbours =
            vec![vec![1, 2], vec![0, 2], vec![0, 1], vec![4, 5], vec![3, 5], vec![3, 4], vec![]];
        assert_eq!(dbscan(&neighbours, 2), vec![vec![0, 1, 2], vec![3, 4, 5]]);
    }
}
