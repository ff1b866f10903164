//! Grids: cubic cells in space, and cells of an image.

use nalgebra::Point3;

/// The cell of a point in a grid whose cells have this side, metres.
pub fn cell(p: &Point3<f64>, side: f64) -> [i32; 3] {
    [0, 1, 2].map(|k| (p[k] / side).floor() as i32)
}

/// The four neighbours of a cell of an image, by column and row, within its numbers of columns and rows.
pub fn four_neighbours(
    (column, row): (usize, usize),
    (columns, rows): (usize, usize),
) -> impl Iterator<Item = (usize, usize)> {
    [(-1, 0), (1, 0), (0, -1), (0, 1)].into_iter().filter_map(move |(right, down)| {
        let next = (column.checked_add_signed(right)?, row.checked_add_signed(down)?);
        (next.0 < columns && next.1 < rows).then_some(next)
    })
}
