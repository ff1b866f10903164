//! The kinematic tree: the minimum spanning tree of all links, weighted by BIC (paper,
//! Eq. 8; Sturm et al. 2011, section 4).

/// A candidate link between two parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// One part.
    pub a: usize,
    /// The other.
    pub b: usize,
    /// Cost, the link's BIC.
    pub cost: f64,
}

/// Prim's algorithm from part 0, the base: `(parent, child, link)` in the order in which
/// parts join. Parts without any link to the tree are left out.
pub fn spanning_tree(parts: usize, links: &[Link]) -> Vec<(usize, usize, usize)> {
    let mut joined = vec![false; parts];
    if parts > 0 {
        joined[0] = true;
    }
    let mut tree = Vec::new();
    loop {
        let next = links
            .iter()
            .enumerate()
            .filter(|(_, l)| joined[l.a] != joined[l.b])
            .min_by(|(_, x), (_, y)| x.cost.total_cmp(&y.cost));
        let Some((index, link)) = next else { return tree };
        let (parent, child) = if joined[link.a] { (link.a, link.b) } else { (link.b, link.a) };
        joined[child] = true;
        tree.push((parent, child, index));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cheapest_links_form_the_tree() {
        let link = |a, b, cost| Link { a, b, cost };
        let links = [link(0, 1, -50.0), link(0, 2, -10.0), link(1, 2, -40.0)];
        assert_eq!(spanning_tree(3, &links), vec![(0, 1, 0), (1, 2, 2)]);
    }

    #[test]
    fn a_part_that_nothing_links_stays_out() {
        assert_eq!(spanning_tree(2, &[]), vec![]);
    }
}
