//! A piece of surface.

use nalgebra::Vector3;

/// A piece of a part's surface in the export's frame.
#[derive(Clone, Copy)]
pub struct Patch {
    pub place: Vector3<f64>,
    pub normal: Vector3<f64>,
    pub lab: [f32; 3],
}
