//! Do two boxes overlap, and how deep? The collision library's answers.

use super::cuboid::Cuboid;
use nalgebra::Vector3;
use parry3d::math::{Pose, Vector};
use parry3d::{query, shape};

/// Distance that shapes of different parts keep, metres.
pub const CLEARANCE_M: f64 = 0.002;
/// Boxes at the very distance are apart, metres.
const ROUNDING_M: f64 = 1e-4;

/// How much two boxes are nearer to each other than the clearance, metres, and the direction from the
/// first to the second; `None` where they keep their distance.
pub fn overlap(a: &Cuboid, b: &Cuboid) -> Option<(f64, Vector3<f64>)> {
    let (a, b) = (placed(a, 0.0), placed(b, 0.0));
    let contact = query::contact(&a.0, &a.1, &b.0, &b.1, CLEARANCE_M as f32).ok()??;
    let n = contact.normal1;
    let normal = Vector3::new(n.x, n.y, n.z).map(f64::from);
    let depth = CLEARANCE_M - f64::from(contact.dist);
    let is_told = depth.is_finite() && normal.iter().all(|x| x.is_finite());
    (is_told && depth > ROUNDING_M).then_some((depth, normal))
}

/// True where they are nearer than the clearance.
pub fn is_overlapping(a: &Cuboid, b: &Cuboid) -> bool {
    let (a, b) = (placed(a, CLEARANCE_M - ROUNDING_M), placed(b, 0.0));
    query::intersection_test(&a.0, &a.1, &b.0, &b.1).is_ok_and(|found| found.intersecting)
}

/// A box as the collision library has it, grown by a margin.
fn placed(of: &Cuboid, margin_m: f64) -> (Pose, shape::Cuboid) {
    let half = of.size.map(|side| (0.5 * side + margin_m) as f32);
    let turn = of.rotation.scaled_axis().map(|x| x as f32);
    let at = of.center.map(|x| x as f32);
    let pose = Pose::new(Vector::new(at.x, at.y, at.z), Vector::new(turn.x, turn.y, turn.z));
    (pose, shape::Cuboid::new(Vector::new(half.x, half.y, half.z)))
}
