//! A coarse occupancy grid: the set of the occupied cells.

use crate::math::grid::cell;
use nalgebra::Point3;
use std::collections::HashSet;

/// Side of a cell of [`Occupancy`], metres.
pub const COARSE_M: f64 = 0.04;

/// Occupied cells, in the object frame.
pub struct Occupancy(pub HashSet<[i32; 3]>);

impl Occupancy {
    /// The cells that hold at least one of the points.
    pub fn new(points: impl Iterator<Item = Point3<f64>>) -> Self {
        Self(points.map(|p| cell(&p, COARSE_M)).collect())
    }

    /// All cells within `margin`, metres, of an occupied cell.
    pub fn grown(&self, margin: f64) -> Self {
        let reach = (margin / COARSE_M).round() as i32;
        let mut grown = HashSet::new();
        for c in &self.0 {
            for x in -reach..=reach {
                for y in -reach..=reach {
                    for z in -reach..=reach {
                        if x * x + y * y + z * z <= reach * reach {
                            grown.insert([c[0] + x, c[1] + y, c[2] + z]);
                        }
                    }
                }
            }
        }
        Self(grown)
    }

    /// True if the cell of a point is occupied.
    pub fn holds(&self, p: &Point3<f64>) -> bool {
        self.0.contains(&cell(p, COARSE_M))
    }

    /// The occupied cells that are also in `surface`, and the cells of `surface` connected to them,
    /// up to `reach` metres away along the surface; infinity: all of them.
    pub fn extended_along(&self, surface: &Self, reach: f64) -> Self {
        let mut front: Vec<[i32; 3]> = self.0.intersection(&surface.0).copied().collect();
        let mut reached: HashSet<[i32; 3]> = front.iter().copied().collect();
        for _ in 0..(reach / COARSE_M).round() as usize {
            if front.is_empty() {
                break;
            }
            front = front
                .iter()
                .flat_map(neighbours)
                .filter(|c| surface.0.contains(c) && reached.insert(*c))
                .collect();
        }
        Self(reached)
    }

    /// The cells of `surface` that are occupied here, and all cells of it that are connected to these.
    pub fn connected(&self, surface: &Self) -> Self {
        self.extended_along(surface, f64::INFINITY)
    }

    /// The cells that are occupied in both grids.
    pub fn intersection(&self, other: &Self) -> Self {
        Self(self.0.intersection(&other.0).copied().collect())
    }

    /// True if no occupied cell lies within `distance`, metres, of a point.
    pub fn is_far_from(&self, p: &Point3<f64>, distance: f64) -> bool {
        self.centres().all(|centre| (centre - p).norm() > distance)
    }

    /// The centre of each occupied cell.
    pub fn centres(&self) -> impl Iterator<Item = Point3<f64>> {
        self.0.iter().map(|c| Point3::from(c.map(|x| (f64::from(x) + 0.5) * COARSE_M)))
    }

    /// The union with another grid.
    pub fn with(mut self, other: &Self) -> Self {
        self.0.extend(&other.0);
        self
    }
}

/// A cell and the 26 cells that touch it.
fn neighbours(c: &[i32; 3]) -> impl Iterator<Item = [i32; 3]> + use<> {
    let [x, y, z] = *c;
    (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1])
}
