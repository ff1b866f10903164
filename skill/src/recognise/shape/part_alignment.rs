//! Alignment by contour: the ends of a surface hold it where a plain board would slide in its plane.
//!
//! In: a state (camera frame, metres), an object's contour and that of the picture. Out: rows of
//! normal equations, and a part's pose after some steps.

use super::super::kinematics::{Articulated, State};
use super::super::normal_equations::{System, add_surface};
use super::super::scene::Scene;
use super::contour::ContourPoint;
use super::contour_grid::ContourGrid;
use super::ends::LEAST_COSINE;
use super::object_shape::ObjectShape;
use crate::math::rigid::{Pose, matrix_pose};

/// Places of contour that count in full; of more each counts less.
const FULL_COUNT: f64 = 100.0;
/// Standard deviation of where a surface is seen to end, metres, and pixels.
const END_SIGMA: (f64, f64) = (0.004, 1.0);

/// Distances of contour, along the direction outward, from where the picture's surface ends.
pub fn add_contour<'c>(
    system: &mut System,
    scene: &Scene,
    seen: &ContourGrid,
    contour: impl Iterator<Item = &'c ContourPoint>,
    articulated: &Articulated,
    state: &State,
) -> usize {
    let poses = articulated.poses(state);
    let velocities = articulated.velocities(&poses);
    let poses: Vec<_> = poses.iter().map(matrix_pose).collect();
    let mut found = Vec::new();
    for c in contour {
        let pose = &poses[c.part];
        let (point, normal, outward) = (pose * c.point, pose * c.normal, pose * c.outward);
        if -normal.dot(&point.coords) < LEAST_COSINE * point.coords.norm() {
            continue;
        }
        if let Some(end) = seen.nearest(&point, &normal, &outward) {
            found.push((c.part, point, end.outward, (point - end.point).dot(&end.outward)));
        }
    }
    let share = (FULL_COUNT / found.len().max(1) as f64).min(1.0);
    for (part, point, outward, residual) in &found {
        let sigma = END_SIGMA.0 + END_SIGMA.1 * point.z / scene.frame.camera.fx;
        let weight = share / sigma.powi(2) / (residual.abs() / sigma / 2.0).max(1.0);
        let row = velocities.of(*part, point).map(|v| outward.dot(&v));
        system.add(row, *residual, weight);
    }
    found.len()
}

/// Steps of the alignment of one part.
const STEPS: usize = 8;
/// Surfels and places of contour below which nothing is aligned.
const LEAST_SEEN: usize = 12;
/// Distance from the seen surface up to which surfels count at first and at last, metres.
const GATES_M: (f64, f64) = (0.05, 0.02);

/// A part's pose, aligned by its own surface and contour.
pub fn aligned(
    scene: &Scene,
    seen: &ContourGrid,
    shape: &ObjectShape,
    part: usize,
    camera_from_part: Pose,
) -> Pose {
    let rigid = Articulated { parts: shape.clouds.len(), joints: Vec::new() };
    let mut state = State { camera_from_object: camera_from_part, q: Vec::new() };
    for i in 0..STEPS {
        let closing = i as f64 / (STEPS - 1) as f64;
        let gate = GATES_M.0 + (GATES_M.1 - GATES_M.0) * closing;
        let mut system = System::new(6);
        let surface = add_surface(&mut system, scene, &rigid, &shape.clouds[part], &state, gate);
        let own = shape.contour.iter().filter(|c| c.part == part);
        let ends = add_contour(&mut system, scene, seen, own, &rigid, &state);
        if surface + ends < LEAST_SEEN {
            break;
        }
        let Some(step) = system.solve(10.0) else { break };
        state = rigid.stepped(&state, &step);
        if step.amax() < 2e-4 {
            break;
        }
    }
    state.camera_from_object
}
