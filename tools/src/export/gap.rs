//! Gaps between pieces of surface: places that no piece covers and that pieces surround.
//!
//! What was seen is kept as a limited number of pieces, drawn at random: in some places they lie
//! farther apart. A gap is no wider than the pieces round it are dense, so that an opening stays
//! open.

use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Widest angle round a place in a gap that holds no piece. Beside a straight edge it is half a turn.
const OPEN_RAD: f64 = 2.8;

/// True where some of the ways to pieces, in the plane of `normal`, lead in all directions.
pub fn is_surrounded(normal: &Vector3<f64>, ways: impl Iterator<Item = Vector3<f64>>) -> bool {
    let (u, v) = linkage_skill::internals::orthonormal_basis(normal);
    let mut angles: Vec<f64> = ways.map(|way| way.dot(&v).atan2(way.dot(&u))).collect();
    angles.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (angles.first(), angles.last()) else { return false };
    let across = first + TAU - last;
    angles.windows(2).map(|pair| pair[1] - pair[0]).fold(across, f64::max) < OPEN_RAD
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ways(degrees: &[f64]) -> impl Iterator<Item = Vector3<f64>> {
        degrees.iter().map(|d| {
            let (sin, cos) = d.to_radians().sin_cos();
            Vector3::new(cos, sin, 0.1)
        })
    }

    #[test]
    fn a_gap_is_surrounded_and_the_outside_of_an_edge_is_not() {
        let normal = Vector3::z();
        assert!(is_surrounded(&normal, ways(&[0.0, 100.0, 220.0])));
        assert!(!is_surrounded(&normal, ways(&[0.0, 30.0, 60.0, 90.0, 179.0])));
        assert!(!is_surrounded(&normal, ways(&[10.0])));
        assert!(!is_surrounded(&normal, ways(&[])));
    }
}
