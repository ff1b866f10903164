//! Region growing over one surface in a depth image: from some cells to all that are connected with them without a
//! step in depth.
//!
//! In: cells to start from, the depth in each cell, and which cells may be reached; metres.
//! Out: the cells that are reached, the first ones included.

use crate::math::grid::four_neighbours;
use std::collections::HashSet;

/// Column and row of a cell of an image.
pub type Cell = (usize, usize);

/// Largest difference of depth between neighbouring cells of one surface: metres, plus a share of the depth.
const SAME_SURFACE: (f64, f64) = (0.015, 0.006);

/// Cells that are connected with those of `start`. `size`: numbers of columns and rows. `depth`: metres, `None` where
/// there is no reading. Only cells that `may_reach` accepts are reached.
pub fn connected_cells(
    start: HashSet<Cell>,
    size: (usize, usize),
    depth: impl Fn(Cell) -> Option<f64>,
    may_reach: impl Fn(Cell) -> bool,
) -> HashSet<Cell> {
    let mut front: Vec<Cell> = start.iter().copied().collect();
    let mut reached = start;
    while let Some(cell) = front.pop() {
        let Some(here) = depth(cell) else { continue };
        for next in four_neighbours(cell, size) {
            let is_one_surface =
                depth(next).is_some_and(|there| (there - here).abs() < largest_step(here));
            if is_one_surface && may_reach(next) && reached.insert(next) {
                front.push(next);
            }
        }
    }
    reached
}

/// Largest difference of depth between neighbouring cells of one surface at a depth, metres.
pub fn largest_step(depth: f64) -> f64 {
    SAME_SURFACE.0 + SAME_SURFACE.1 * depth
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_reached_up_to_a_step_in_depth_a_hole_or_what_may_not_be_reached() {
        // A slope, then a step of 16 cm; a hole below it.
        let depth = |(column, row): Cell| match (column, row) {
            (_, 1) => None,
            (0..5, _) => Some(1.0 + 0.01 * column as f64),
            _ => Some(1.2),
        };
        let reached = |may_reach: &dyn Fn(Cell) -> bool| {
            connected_cells(HashSet::from([(0, 0)]), (8, 3), depth, may_reach).len()
        };
        assert_eq!(reached(&|_| true), 5);
        assert_eq!(reached(&|(column, _)| column < 3), 3);
    }
}
