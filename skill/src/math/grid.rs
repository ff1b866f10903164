//! A grid of cubic cells.

use nalgebra::Point3;

/// The cell of a point in a grid whose cells have this side, metres.
pub fn cell(p: &Point3<f64>, side: f64) -> [i32; 3] {
    [0, 1, 2].map(|k| (p[k] / side).floor() as i32)
}
