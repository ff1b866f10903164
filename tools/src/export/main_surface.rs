//! The main connected component of a surface.
//!
//! Some of what was seen of a part is not of it: a piece of the floor that the part moved over, a
//! sleeve. Such pieces lie apart from the rest. They do no harm to recognition, but a box around all
//! would be far too large.

use super::patch::Patch;
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Side of a cell; surface in cells that touch is connected, metres.
const CELL_M: f64 = 0.05;
/// Pieces of fewer patches than this share of the largest piece are left out.
const LEAST_SHARE: f64 = 0.2;

/// How many cells away a piece of the base may be from what it carries.
const BESIDE_CELLS: i64 = 2;
/// Fewest patches of such a piece.
const LEAST_BESIDE: usize = 15;

/// The patches of the largest piece, of others that are not much smaller, and of those that lie beside
/// what the part carries, `carried`: the case of a safe, which stands on a table that was seen too.
pub fn main_surface(patches: &[Patch], carried: &[Patch]) -> Vec<Patch> {
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (i, patch) in patches.iter().enumerate() {
        cells.entry(cell(&patch.place)).or_default().push(i);
    }
    let mut pieces = Vec::new();
    while let Some((first, members)) = cells.pop_first() {
        let (mut piece, mut front) = (members, vec![first]);
        while let Some([x, y, z]) = front.pop() {
            for i in 0..27 {
                let beside = [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1];
                if let Some(members) = cells.remove(&beside) {
                    piece.extend(members);
                    front.push(beside);
                }
            }
        }
        pieces.push(piece);
    }
    let largest = pieces.iter().map(Vec::len).max().unwrap_or(0) as f64;
    let near = cells_near(carried);
    let is_beside = |piece: &[usize]| {
        piece.iter().filter(|i| near.contains(&cell(&patches[**i].place))).count() >= LEAST_BESIDE
    };
    pieces.retain(|piece| piece.len() as f64 >= LEAST_SHARE * largest || is_beside(piece));
    let mut kept: Vec<usize> = pieces.concat();
    kept.sort_unstable();
    kept.into_iter().map(|i| patches[i]).collect()
}

/// Cells that are few cells away from a surface.
fn cells_near(surface: &[Patch]) -> BTreeSet<[i64; 3]> {
    let side = 2 * BESIDE_CELLS + 1;
    let around = |[x, y, z]: [i64; 3]| {
        let offset = move |i: i64| i % side - BESIDE_CELLS;
        (0..side.pow(3))
            .map(move |i| [x + offset(i), y + offset(i / side), z + offset(i / side.pow(2))])
    };
    let cells: BTreeSet<[i64; 3]> = surface.iter().map(|p| cell(&p.place)).collect();
    cells.into_iter().flat_map(around).collect()
}

fn cell(place: &Vector3<f64>) -> [i64; 3] {
    place.map(|x| (x / CELL_M).floor() as i64).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(x: f64, count: usize) -> impl Iterator<Item = Patch> {
        (0..count).map(move |i| Patch {
            place: Vector3::new(x, 0.02 * (i % 20) as f64, 0.02 * (i / 20) as f64),
            normal: Vector3::x(),
            lab: [50.0, 0.0, 0.0],
        })
    }

    #[test]
    fn a_small_piece_that_lies_apart_is_left_out_and_a_large_one_is_kept() {
        let count = |patches: Vec<Patch>| main_surface(&patches, &[]).len();
        assert_eq!(count(piece(0.0, 400).chain(piece(1.0, 40)).collect()), 400);
        assert_eq!(count(piece(0.0, 400).chain(piece(1.0, 200)).collect()), 600);
        assert_eq!(count(piece(0.0, 400).chain(piece(0.04, 40)).collect()), 440);
        assert_eq!(count(Vec::new()), 0);
    }
    #[test]
    fn a_small_piece_beside_what_is_carried_is_kept() {
        let base: Vec<Patch> = piece(0.0, 400).chain(piece(1.0, 40)).collect();
        let count = |x: f64| main_surface(&base, &piece(x, 100).collect::<Vec<_>>()).len();
        assert_eq!((count(1.08), count(1.3), count(-0.5)), (440, 400, 400));
    }
}
