//! Whether a picture's surface ends where a contour says.
//!
//! In: a place of contour and the pose of its part (camera frame, metres), or a whole state. Out: yes, no,
//! or not seen; by part, how many of each.

use super::super::kinematics::{Articulated, State};
use super::super::render_cloud::NEAREST_M;
use super::super::scene::Scene;
use super::contour::ContourPoint;
use super::contour_grid::ContourGrid;
use super::object_shape::Contours;
use nalgebra::{IsometryMatrix3, Point3, Vector3};

/// Least cosine between the normal of a place and the direction to the camera, for it to be seen.
pub const LEAST_COSINE: f64 = 0.2;
/// What is seen this far before a place hides it, metres.
const HIDDEN_M: f64 = 0.05;

/// Whether the picture's surface ends as a place of contour says; `None` where it is not seen.
pub fn ends(
    scene: &Scene,
    seen: &ContourGrid,
    pose: &IsometryMatrix3<f64>,
    c: &ContourPoint,
) -> Option<bool> {
    let (point, normal) = (pose * c.point, pose * c.normal);
    let (u, v) = pixel_of(scene, &point, &normal)?;
    let z = f64::from(scene.frame.depth.at(u, v)?);
    if seen.has(&point, &normal, &(pose * c.outward)) {
        return Some(true);
    }
    (z > point.z - HIDDEN_M).then_some(false)
}

/// How exactly the picture ends as a place of contour says, 0 to 1.
fn closeness(seen: &ContourGrid, pose: &IsometryMatrix3<f64>, c: &ContourPoint) -> f64 {
    seen.closeness(&(pose * c.point), &(pose * c.normal), &(pose * c.outward)).unwrap_or(0.0)
}

/// Where a place is seen; `None` where a surface of that normal would not be.
pub fn pixel_of(
    scene: &Scene,
    point: &Point3<f64>,
    normal: &Vector3<f64>,
) -> Option<(usize, usize)> {
    let faces = -normal.dot(&point.coords) > LEAST_COSINE * point.coords.norm();
    let camera = &scene.frame.camera;
    let pixel = (faces && point.z > NEAREST_M).then(|| camera.project(point)).flatten()?;
    let is_seen = camera.sees(&pixel, 2.0);
    is_seen.then_some(((pixel.x + 0.5) as usize, (pixel.y + 0.5) as usize))
}

/// Places of a part's contour in sight: those at which the picture's surface ends too, and the others.
#[derive(Debug, Clone, Copy, Default)]
pub struct EndsInSight {
    /// The picture's surface ends there.
    pub found: usize,
    /// It does not.
    pub missing: usize,
    /// How exactly it ends there, 0 to 1, summed over those that are found.
    pub closeness: f64,
}

impl EndsInSight {
    /// All of them.
    pub fn count(&self) -> usize {
        self.found + self.missing
    }

    /// Share that is found; 1 where none is in sight.
    pub fn share(&self) -> f64 {
        if self.count() == 0 { 1.0 } else { self.found as f64 / self.count() as f64 }
    }
}

/// Ends in sight by part, of the contour that is known at a state.
pub fn ends_in_sight(
    scene: &Scene,
    articulated: &Articulated,
    contours: Contours,
    state: &State,
) -> Vec<EndsInSight> {
    let poses = articulated.matrices(state);
    let mut counts = vec![EndsInSight::default(); articulated.parts];
    for c in contours.shape.known_at(articulated, state) {
        match ends(scene, contours.seen, &poses[c.part], c) {
            Some(true) => {
                counts[c.part].found += 1;
                counts[c.part].closeness += closeness(contours.seen, &poses[c.part], c);
            }
            Some(false) => counts[c.part].missing += 1,
            None => {}
        }
    }
    counts
}
