//! Where a surface ends, and what an image shows there: what the learner finds edges by, and the recogniser
//! tests them by.

use linkage_frames::RgbdFrame;
use nalgebra::{Point3, Vector3};

/// Length of the steps by which the surface is followed, metres.
pub const STEP_M: f64 = 0.005;
/// Distance from an edge's `surface` to the end of the surface, metres: the last place that shows the surface is half
/// a step from the end on average, and `Edge` names the place before it, because depth is unreliable at edges.
pub const INSET_M: f64 = 1.5 * STEP_M;
/// Smallest cosine of the angle between a surface's normal and the viewing ray of an image that shows the surface.
const LEAST_COSINE: f64 = 0.3;

/// True if nothing is at a place where a surface of that normal might be, both in the camera frame; `None` where the
/// place is occluded, not seen, or seen at a grazing angle.
pub fn is_empty(frame: &RgbdFrame, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<bool> {
    let cosine = normal.dot(&place.coords).abs() / place.coords.norm();
    if cosine < LEAST_COSINE {
        return None;
    }
    let pixel = frame.camera.project(place)?;
    let behind = f64::from(frame.depth.at_nearest(pixel.x, pixel.y)?) - place.z;
    let tolerance = frame.camera.depth_sensor.tolerance(place.z, cosine);
    match behind > 2.0 * tolerance {
        true => Some(true),
        false => (behind.abs() < tolerance).then_some(false),
    }
}
