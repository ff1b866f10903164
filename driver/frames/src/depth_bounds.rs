//! The least and greatest reading around each place of a picture, to tell quickly whether something behind a place is
//! seen. Places are asked about in no order, so that each look-up may miss the processor's cache: one look-up replaces
//! nine.

/// What is told where nothing is read: nothing is behind any place, and nothing reaches one.
const NONE: [f32; 2] = [0.0, f32::NEG_INFINITY];

/// The readings around each cell of a grid of pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthBounds {
    columns: usize,
    /// Least and greatest depth, row by row, metres.
    cells: Vec<[f32; 2]>,
}

impl DepthBounds {
    /// Pixels between two cells, and from a cell to the eight readings around it.
    pub const STRIDE_PX: usize = 2;

    /// Those of a picture of so many columns and rows; metres, row by row, NaN where there is no reading.
    pub(crate) fn of(width: usize, height: usize, metres: &[f32]) -> Self {
        let (columns, rows) = (width / Self::STRIDE_PX, height / Self::STRIDE_PX);
        if columns == 0 {
            return Self { columns, cells: Vec::new() };
        }
        let pixels = metres.chunks_exact(width).step_by(Self::STRIDE_PX);
        let along: Vec<Vec<[f32; 2]>> = pixels.take(rows).map(bounds_along).collect();
        let beside = |row: usize| &along[row.saturating_sub(1)..(row + 2).min(rows)];
        let across = |row: usize| (0..columns).map(move |column| joined(beside(row), column));
        Self { columns, cells: (0..rows).flat_map(across).collect() }
    }

    /// Columns of the grid.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Cells of the grid.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// True of a picture that is smaller than a cell.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The cell nearest to a pixel; `None` beyond the last column or row of cells, which ends up to two pixels before the
    /// picture does. Coordinates below 0 count as 0.
    #[inline]
    pub fn cell_at(&self, u: f64, v: f64) -> Option<usize> {
        let nearest = |x: f64| (x / Self::STRIDE_PX as f64 + 0.5) as usize;
        let cell = nearest(v) * self.columns + nearest(u);
        (nearest(u) < self.columns && cell < self.cells.len()).then_some(cell)
    }

    /// Least and greatest depth that is read around a cell, metres. Where nothing is read, the first is 0 and the second
    /// is less than any depth.
    ///
    /// # Panics
    /// If there is no such cell.
    #[inline]
    pub fn around(&self, cell: usize) -> [f32; 2] {
        self.cells[cell]
    }
}

/// Of one row of pixels, those of each cell and the cells to its left and right.
fn bounds_along(row: &[f32]) -> Vec<[f32; 2]> {
    let cells: Vec<f32> =
        row.chunks_exact(DepthBounds::STRIDE_PX).map(|pixels| pixels[0]).collect();
    let last = cells.len() - 1;
    let of = |i: usize| {
        let [a, b, c] = [cells[i.saturating_sub(1)], cells[i], cells[(i + 1).min(last)]];
        [a.min(b).min(c), a.max(b).max(c)]
    };
    (0..cells.len()).map(of).collect()
}

/// The bounds of one column over rows next to one another; [`NONE`] where no row has a reading. The least and the greater
/// of a number and NaN is the number.
fn joined(rows: &[Vec<[f32; 2]>], column: usize) -> [f32; 2] {
    let of_all = rows.iter().map(|row| row[column]);
    let [least, greatest] =
        of_all.fold([f32::NAN; 2], |[low, high], [a, b]| [low.min(a), high.max(b)]);
    if least.is_nan() { NONE } else { [least, greatest] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WIDTH: usize = 13;
    const HEIGHT: usize = 9;

    fn picture() -> impl Strategy<Value = Vec<f32>> {
        let reading = prop_oneof![3 => 0.5..4.0_f32, 2 => Just(f32::NAN)];
        prop::collection::vec(reading, WIDTH * HEIGHT)
    }

    proptest! {
        #[test]
        fn bounds_are_those_of_the_nine_readings(metres in picture()) {
            let bounds = DepthBounds::of(WIDTH, HEIGHT, &metres);
            prop_assert_eq!((bounds.columns(), bounds.len()), (6, 6 * 4));
            for (column, row) in (0..6).flat_map(|c| (0..4).map(move |r| (c, r))) {
                let beside = |x: usize, end: usize| x.saturating_sub(1)..(x + 2).min(end);
                let cells = beside(row, 4).flat_map(|r| beside(column, 6).map(move |c| (c, r)));
                let at = |(c, r): (usize, usize)| metres[2 * r * WIDTH + 2 * c];
                let readings: Vec<f32> = cells.map(at).filter(|z| !z.is_nan()).collect();
                let least = readings.iter().copied().fold(f32::INFINITY, f32::min);
                let greatest = readings.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                let told = bounds.around(row * 6 + column);
                prop_assert_eq!(told, if readings.is_empty() { NONE } else { [least, greatest] });
            }
        }
    }

    #[test]
    fn a_pixel_has_the_nearest_cell_and_none_outside_the_grid() {
        let bounds = DepthBounds::of(WIDTH, HEIGHT, &[1.0; WIDTH * HEIGHT]);
        assert_eq!(bounds.cell_at(0.0, 0.0), Some(0));
        assert_eq!(bounds.cell_at(2.9, 1.1), Some(6 + 1));
        assert_eq!(bounds.cell_at(12.0, 0.0), None);
        assert_eq!(bounds.cell_at(0.0, 8.0), None);
    }

    #[test]
    fn a_picture_smaller_than_a_cell_has_none() {
        for (width, height) in [(1, 5), (5, 1), (0, 0)] {
            let bounds = DepthBounds::of(width, height, &vec![1.0; width * height]);
            assert!(bounds.is_empty());
            assert_eq!(bounds.cell_at(0.0, 0.0), None);
        }
    }
}
