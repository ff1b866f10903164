//! Points in a grid of cubes, to find the nearest of them to a place.

use nalgebra::Point3;

/// Cells along an edge of the grid, at most: a grid of few far points must not take all memory.
const MAX_CELLS: usize = 256;

/// Points by the cell that they are in.
pub struct PointGrid {
    /// Least corner.
    corner: Point3<f64>,
    /// Edge of a cell, metres: the largest distance that is asked for.
    edge: f64,
    size: [usize; 3],
    /// Where the points of each cell begin in the list, and its end.
    starts: Vec<u32>,
    points: Vec<Point3<f64>>,
}

impl PointGrid {
    /// A grid of points for places up to `edge` metres from them.
    pub fn new(points: &[Point3<f64>], edge: f64) -> Self {
        let low = |k: usize| points.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let high = |k: usize| points.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
        let corner = Point3::new(low(0), low(1), low(2));
        let cells = |k: usize| ((high(k) - corner[k]) / edge).max(0.0) as usize + 1;
        let size = [0, 1, 2].map(|k| cells(k).min(MAX_CELLS));
        let mut grid = Self {
            corner,
            edge,
            size,
            starts: Vec::new(),
            points: Vec::with_capacity(points.len()),
        };
        let mut counts = vec![0_u32; size.iter().product::<usize>() + 1];
        let of = |p: &Point3<f64>| grid.index([0, 1, 2].map(|k| grid.cell(p, k)));
        let cells: Vec<Option<usize>> = points.iter().map(of).collect();
        cells.iter().flatten().for_each(|cell| counts[cell + 1] += 1);
        for cell in 1..counts.len() {
            counts[cell] += counts[cell - 1];
        }
        let mut order: Vec<usize> = (0..points.len()).filter(|i| cells[*i].is_some()).collect();
        order.sort_by_key(|i| cells[*i]);
        grid.points.extend(order.into_iter().map(|i| points[i]));
        grid.starts = counts;
        grid
    }

    /// All points, cell by cell.
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// The point nearest to a place, if it is nearer than the edge of a cell.
    pub fn nearest(&self, place: &Point3<f64>) -> Option<Point3<f64>> {
        if self.points.is_empty() {
            return None;
        }
        let [x, y, z] = [0, 1, 2].map(|k| self.cell(place, k));
        let mut best: Option<(f64, Point3<f64>)> = None;
        let limit = self.edge * self.edge;
        for dz in -1..=1 {
            for dy in -1..=1 {
                for dx in -1..=1 {
                    let Some(cell) = self.index([x + dx, y + dy, z + dz]) else { continue };
                    let [start, end] = [self.starts[cell], self.starts[cell + 1]];
                    for p in &self.points[start as usize..end as usize] {
                        let distance_sq = (p - place).norm_squared();
                        if distance_sq < best.map_or(limit, |(d, _)| d) {
                            best = Some((distance_sq, *p));
                        }
                    }
                }
            }
        }
        best.map(|(_, p)| p)
    }

    /// Number of a place's cell along one edge of the grid; it may be outside.
    fn cell(&self, place: &Point3<f64>, k: usize) -> i64 {
        ((place[k] - self.corner[k]) / self.edge).floor() as i64
    }

    fn index(&self, cell: [i64; 3]) -> Option<usize> {
        let inside = |k: usize| (0..self.size[k] as i64).contains(&cell[k]);
        let [x, y, z] = cell.map(|c| c as usize);
        (inside(0) && inside(1) && inside(2)).then(|| (z * self.size[1] + y) * self.size[0] + x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn place() -> impl Strategy<Value = Point3<f64>> {
        prop::array::uniform3(-0.5..0.5_f64).prop_map(Point3::from)
    }

    proptest! {
        #[test]
        fn the_nearest_point_is_that_of_a_search_through_all(
            points in prop::collection::vec(place(), 0..60), at in place(),
        ) {
            let edge = 0.2;
            let distance = |p: &Point3<f64>| (p - at).norm();
            let all = points.iter().map(distance).fold(f64::INFINITY, f64::min);
            let found = PointGrid::new(&points, edge).nearest(&at).map(|p| distance(&p));
            prop_assert_eq!(found, (all < edge).then_some(all));
        }
    }

    #[test]
    fn points_far_apart_do_not_take_much_memory() {
        let points = [Point3::origin(), Point3::new(1e6, 1e6, 1e6)];
        let grid = PointGrid::new(&points, 0.01);
        assert!(grid.starts.len() <= MAX_CELLS.pow(3) + 1);
        assert_eq!(grid.nearest(&Point3::new(0.005, 0.0, 0.0)), Some(Point3::origin()));
    }
}
