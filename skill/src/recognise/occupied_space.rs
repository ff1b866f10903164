//! Occupied voxels: space in which recognised objects stand.
//!
//! In: surfaces of recognised objects, camera frame, metres.
//! Out: whether a place is occupied, and which share of another surface is.

use super::kinematics::{Articulated, State};
use super::render_cloud::Cloud;
use nalgebra::Point3;
use std::collections::HashSet;

/// Edge length of a voxel, metres.
const CELL_M: f64 = 0.03;

/// Index of a voxel along x, y and z.
type Cell = [i32; 3];

/// Occupied voxels, camera frame.
#[derive(Default)]
pub struct OccupiedVoxels {
    cells: HashSet<Cell>,
}

fn cell_of(p: &Point3<f64>) -> Cell {
    [p.x, p.y, p.z].map(|x| (x / CELL_M).floor() as i32)
}

/// A voxel and its 26 neighbours.
fn around(cell: Cell) -> impl Iterator<Item = Cell> {
    (0..27).map(move |i| [cell[0] + i % 3 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i / 9 - 1])
}

/// Places of the surfels of an object in a state, camera frame, metres.
pub fn places_of(cloud: &Cloud, articulated: &Articulated, state: &State) -> Vec<Point3<f64>> {
    let poses = articulated.poses(state);
    cloud.surfels.iter().map(|s| poses[s.part] * s.point).collect()
}

impl OccupiedVoxels {
    /// Marks the voxels of places, and the neighbours of these voxels, as occupied.
    pub fn add(&mut self, places: &[Point3<f64>]) {
        let own: HashSet<Cell> = places.iter().map(cell_of).collect();
        self.cells.extend(own.into_iter().flat_map(around));
    }

    /// True if the place is occupied.
    pub fn holds(&self, place: &Point3<f64>) -> bool {
        self.cells.contains(&cell_of(place))
    }

    /// Share of places that are occupied, 0 to 1.
    pub fn share(&self, places: &[Point3<f64>]) -> f64 {
        places.iter().filter(|p| self.holds(p)).count() as f64 / places.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_in_a_place_takes_it_and_what_touches_it() {
        let mut occupied = OccupiedVoxels::default();
        let place = Point3::new(-0.01, 0.2, 1.0);
        assert!(!occupied.holds(&place));
        occupied.add(&[place]);
        let beside = |x: f64| Point3::new(place.x + x, place.y, place.z);
        assert!(occupied.holds(&place) && occupied.holds(&beside(CELL_M)));
        assert!(!occupied.holds(&beside(2.1 * CELL_M)));
        assert_eq!(occupied.share(&[place, beside(0.5), beside(1.0)]), 1.0 / 3.0);
    }
}
