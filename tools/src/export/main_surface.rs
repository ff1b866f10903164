//! The main connected component of a surface.
//!
//! Some of what was seen of a part is not of it: a piece of the floor that the part moved over, a
//! sleeve. Such pieces lie apart from the rest. They do no harm to recognition, but a box around all
//! would be far too large.

use super::patch::Patch;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Side of a cell; surface in cells that touch is connected, metres.
const CELL_M: f64 = 0.05;
/// Pieces of fewer patches than this share of the largest piece are left out.
const LEAST_SHARE: f64 = 0.2;

/// The patches of the largest piece, and of others that are not much smaller.
pub fn main_surface(patches: &[Patch]) -> Vec<Patch> {
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
    pieces.retain(|piece| piece.len() as f64 >= LEAST_SHARE * largest);
    let mut kept: Vec<usize> = pieces.concat();
    kept.sort_unstable();
    kept.into_iter().map(|i| patches[i]).collect()
}

fn cell(place: &Vector3<f64>) -> [i64; 3] {
    place.map(|x| (x / CELL_M).floor() as i64).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_piece_that_lies_apart_is_left_out_and_a_large_one_is_kept() {
        let piece = |x: f64, count: usize| {
            (0..count).map(move |i| Patch {
                place: Vector3::new(x, 0.02 * (i % 20) as f64, 0.02 * (i / 20) as f64),
                normal: Vector3::x(),
                lab: [50.0, 0.0, 0.0],
            })
        };
        let count = |patches: Vec<Patch>| main_surface(&patches).len();
        assert_eq!(count(piece(0.0, 400).chain(piece(1.0, 40)).collect()), 400);
        assert_eq!(count(piece(0.0, 400).chain(piece(1.0, 200)).collect()), 600);
        assert_eq!(count(piece(0.0, 400).chain(piece(0.04, 40)).collect()), 440);
        assert_eq!(count(Vec::new()), 0);
    }
}
