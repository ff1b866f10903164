//! Stores points in a grid of cubes, to find the nearest of them to a place. Only cells with points take memory.

use nalgebra::Point3;

/// Points, sorted by their cells.
pub struct PointGrid {
    /// Edge of a cell, metres: the largest distance at which a point is found.
    edge: f64,
    /// The cell of each point, as z, y, x.
    cells: Vec<[i32; 3]>,
    points: Vec<Point3<f64>>,
}

/// The cell of a place in a grid of cubes, as z, y, x.
pub fn cell_of(place: &Point3<f64>, edge: f64) -> [i32; 3] {
    [place.z, place.y, place.x].map(|x| (x / edge).floor() as i32)
}

impl PointGrid {
    /// A grid that finds points up to `edge` metres from a place.
    pub fn new(points: &[Point3<f64>], edge: f64) -> Self {
        let mut order: Vec<([i32; 3], usize)> =
            points.iter().enumerate().map(|(i, p)| (cell_of(p, edge), i)).collect();
        order.sort_unstable();
        let points = order.iter().map(|(_, i)| points[*i]).collect();
        Self { edge, cells: order.into_iter().map(|(cell, _)| cell).collect(), points }
    }

    /// All points, cell by cell.
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// The point nearest to a place, if it is nearer than the edge of a cell.
    pub fn nearest(&self, place: &Point3<f64>) -> Option<Point3<f64>> {
        let [z, y, x] = cell_of(place, self.edge);
        let beside = |c: i32| c.saturating_sub(1)..=c.saturating_add(1);
        let mut best: Option<(f64, Point3<f64>)> = None;
        for (z, y) in beside(z).flat_map(|z| beside(y).map(move |y| (z, y))) {
            for p in self.row([z, y], [x.saturating_sub(1), x.saturating_add(1)]) {
                let distance_sq = (p - place).norm_squared();
                if distance_sq < best.map_or(self.edge * self.edge, |(d, _)| d) {
                    best = Some((distance_sq, *p));
                }
            }
        }
        best.map(|(_, p)| p)
    }

    /// The points of cells next to one another along x.
    fn row(&self, [z, y]: [i32; 2], [first, last]: [i32; 2]) -> &[Point3<f64>] {
        let start = self.cells.partition_point(|cell| *cell < [z, y, first]);
        let count = self.cells[start..].iter().take_while(|cell| **cell <= [z, y, last]).count();
        &self.points[start..start + count]
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
    fn points_far_apart_are_found_alike() {
        let far = Point3::new(1e6, 1e6, 1e6);
        let grid = PointGrid::new(&[far, Point3::origin()], 0.01);
        assert_eq!(grid.nearest(&Point3::new(0.005, 0.0, 0.0)), Some(Point3::origin()));
        assert_eq!(grid.nearest(&far), Some(far));
        assert_eq!(grid.points().len(), 2);
    }
}
