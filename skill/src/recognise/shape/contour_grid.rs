//! The contour of a frame in a grid: which of its points is near a place and ends in the same direction.
//!
//! In: a contour in the camera frame, metres.
//! Out: the nearest contour point that agrees with a place, normal and direction outward.

use super::super::scene::Scene;
use super::contour::{ContourPoint, contour_of_scene};
use crate::math::grid::cell;
use linkage_frames::depth::DepthSensor;
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;

/// Side of a cell, metres.
const CELL_M: f64 = 0.04;
/// Smallest cosine between normals of one edge.
const SAME_NORMAL: f64 = 0.87;
/// Smallest cosine between outward directions of one edge.
const SAME_OUTWARD: f64 = 0.8;

/// Contour with a grid to find the points near a place.
pub struct ContourGrid {
    /// Points of the contour.
    pub points: Vec<ContourPoint>,
    /// For each point, largest distance of a place that agrees with it, metres.
    gates: Vec<f64>,
    cells: HashMap<[i32; 3], Vec<u32>>,
}

/// Largest distance, metres, between the end of a surface as it is known and as a camera of focal length `fx`, pixels,
/// sees it at depth `z`, metres.
pub fn gate(z: f64, sensor: DepthSensor, fx: f64) -> f64 {
    0.012 + 2.0 * sensor.reading_sigma(z) + 1.5 * z / fx
}

impl ContourGrid {
    /// Contour of a frame.
    pub fn of(scene: &Scene) -> Self {
        let camera = &scene.frame.camera;
        Self::new(contour_of_scene(scene), camera.depth_sensor, camera.fx)
    }

    /// Grid of contour points seen by a camera of focal length `fx`, pixels.
    pub fn new(points: Vec<ContourPoint>, sensor: DepthSensor, fx: f64) -> Self {
        let gates: Vec<f64> = points.iter().map(|p| gate(p.point.z, sensor, fx)).collect();
        let mut cells: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
        for (i, (p, gate)) in points.iter().zip(&gates).enumerate() {
            let reach = Vector3::repeat(*gate);
            let (low, high) = (cell(&(p.point - reach), CELL_M), cell(&(p.point + reach), CELL_M));
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        cells.entry([x, y, z]).or_default().push(i as u32);
                    }
                }
            }
        }
        Self { points, gates, cells }
    }

    /// Nearest contour point that agrees with an end at `point` with this normal and direction outward.
    pub fn nearest(
        &self,
        point: &Point3<f64>,
        normal: &Vector3<f64>,
        outward: &Vector3<f64>,
    ) -> Option<&ContourPoint> {
        let near = self.cells.get(&cell(point, CELL_M))?;
        let agreeing = near.iter().filter_map(|i| {
            let (p, gate) = (&self.points[*i as usize], self.gates[*i as usize]);
            let apart = (p.point - point).norm();
            let agrees = apart < gate
                && p.normal.dot(normal) > SAME_NORMAL
                && p.outward.dot(outward) > SAME_OUTWARD;
            agrees.then_some((apart, p))
        });
        agreeing.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, p)| p)
    }

    /// True if [`Self::nearest`] finds a point.
    pub fn has(&self, point: &Point3<f64>, normal: &Vector3<f64>, outward: &Vector3<f64>) -> bool {
        self.cells.get(&cell(point, CELL_M)).is_some_and(|near| {
            near.iter().any(|i| {
                let p = &self.points[*i as usize];
                p.normal.dot(normal) > SAME_NORMAL
                    && p.outward.dot(outward) > SAME_OUTWARD
                    && (p.point - point).norm() < self.gates[*i as usize]
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_found_near_by_and_only_where_it_ends_alike() {
        let at = |x: f64, outward| ContourPoint {
            part: 0,
            point: Point3::new(x, 0.0, 1.0),
            normal: -Vector3::z(),
            outward,
            side: 0,
            configurations: [0.0; 2],
        };
        let points = vec![at(0.0, Vector3::x()), at(0.03, Vector3::x()), at(0.0, -Vector3::x())];
        let grid = ContourGrid::new(points, DepthSensor::default(), 525.0);
        let found = |x: f64, outward: Vector3<f64>| {
            grid.nearest(&Point3::new(x, 0.0, 1.0), &-Vector3::z(), &outward).map(|p| p.point.x)
        };
        assert_eq!(found(0.01, Vector3::x()), Some(0.0));
        assert_eq!(found(0.02, Vector3::x()), Some(0.03));
        assert_eq!(found(0.05, -Vector3::x()), None);
        assert_eq!(found(0.5, Vector3::x()), None);
        assert!(grid.has(&Point3::new(0.01, 0.0, 1.0), &-Vector3::z(), &Vector3::x()));
        assert!(!grid.has(&Point3::new(0.01, 0.0, 1.0), &Vector3::z(), &Vector3::x()));
    }
}
