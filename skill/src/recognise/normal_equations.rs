//! Normal equations over an object's pose and configurations, and the rows that a seen surface adds to them.
//!
//! The unknowns: rotation of the object about the camera's axes (3, radians), translation (3, metres), then one
//! configuration per joint (rad or m).
//!
//! In: residuals with their rows of the Jacobian.
//! Out: a step, or the standard deviation of each unknown.
//! From: Gauss-Newton; point-to-plane residuals with Huber's weight.

use super::kinematics::{Articulated, State};
use super::render_cloud::{Cloud, visible};
use super::scene::Scene;
use crate::math::normal_equations::NormalEquations;
use nalgebra::{DMatrix, DVector, Dyn};

/// Normal equations over pose and configurations; residuals are predicted minus seen.
pub struct System {
    equations: NormalEquations<Dyn>,
    row: DVector<f64>,
}

/// Smallest standard deviation, metres or radians, at which an unknown counts as undetermined.
const UNTOLD_DEVIATION: f64 = 1.0;
/// Information of an unknown without any evidence: a standard deviation of 2 metres or radians.
const UNTOLD_INFORMATION: f64 = 0.25;

impl System {
    /// Empty equations of this number of unknowns.
    pub fn new(unknowns: usize) -> Self {
        Self { equations: NormalEquations::of(Dyn(unknowns)), row: DVector::zeros(unknowns) }
    }

    /// Adds one residual with its row of the Jacobian and its weight.
    pub fn add(&mut self, jacobian: impl IntoIterator<Item = f64>, residual: f64, weight: f64) {
        self.row.iter_mut().zip(jacobian).for_each(|(entry, value)| *entry = value);
        self.equations.add(&self.row, residual, weight);
    }

    /// Adds a prior that draws configurations outside the demonstrated range back to it. A joint may move a little
    /// beyond that range, but only where the image supports it.
    pub fn draw_into_range(&mut self, articulated: &Articulated, state: &State) {
        for (j, (joint, q)) in articulated.joints.iter().zip(&state.q).enumerate() {
            let excess = joint.excess(*q);
            if excess != 0.0 {
                let weight = joint.slack().powi(-2);
                self.equations.right[6 + j] += weight * excess;
                self.equations.left[(6 + j, 6 + j)] += weight;
            }
        }
    }

    /// Adds information to the first six unknowns, the pose, so that they keep their values.
    pub fn hold_pose(&mut self, weight: f64) {
        for k in 0..6 {
            self.equations.left[(k, k)] += weight;
        }
    }

    /// Standard deviation of each unknown, in its own unit, if all others are unknown too; `None` if it is not
    /// determined.
    pub fn deviations(&self) -> Vec<Option<f64>> {
        deviations_of(self.equations.information())
    }

    /// Standard deviation of each of the first six unknowns, the pose, if the configurations are known; `None` if it
    /// is not determined.
    pub fn pose_deviations(&self) -> Vec<Option<f64>> {
        deviations_of(self.equations.information().view((0, 0), (6, 6)).into_owned())
    }

    /// Step that lowers the residuals, after `damping` is added to the information of each unknown; `None` if it is
    /// not determined.
    pub fn solve(mut self, damping: f64) -> Option<DVector<f64>> {
        self.equations.damp(damping);
        Some(-self.equations.solution()?)
    }
}

/// Standard deviations of unknowns by their information.
fn deviations_of(mut information: DMatrix<f64>) -> Vec<Option<f64>> {
    let unknowns = information.nrows();
    (0..unknowns).for_each(|k| information[(k, k)] += UNTOLD_INFORMATION);
    let Some(covariance) = information.cholesky().map(|c| c.inverse()) else {
        return vec![None; unknowns];
    };
    (0..unknowns)
        .map(|k| covariance[(k, k)].sqrt())
        .map(|deviation| (deviation < UNTOLD_DEVIATION).then_some(deviation))
        .collect()
}

/// Adds the distances of visible surfels to the planes seen at their pixels, and returns their number. `gate`:
/// largest distance, metres, to which depth noise is added. All planes together weigh at most as much as 300 single
/// ones.
pub fn add_surface(
    system: &mut System,
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
    gate: f64,
) -> usize {
    let poses = articulated.poses(state);
    let sensor = scene.frame.camera.depth_sensor;
    let mut planes = Vec::new();
    for p in visible(scene, cloud, &poses) {
        let Some(surface) = scene.surface(p.pixel.0, p.pixel.1) else { continue };
        let (u, v) = (p.pixel.0 as f64, p.pixel.1 as f64);
        let seen = scene.frame.camera.back_project(u, v, surface.z);
        let residual = (p.point - seen).dot(&surface.normal);
        let near = residual.abs() < gate + 2.0 * sensor.reading_sigma(p.point.z)
            && (seen.z - p.point.z).abs() < 2.0 * gate + 0.02
            && surface.normal.dot(&p.normal) > 0.8;
        if near {
            planes.push((p, surface.normal, residual));
        }
    }
    let velocities = articulated.velocities(&poses);
    let share = (300.0 / planes.len().max(1) as f64).min(1.0);
    for (p, normal, residual) in &planes {
        let sigma = sensor.reading_sigma(p.point.z) + 0.002;
        let weight = share / sigma.powi(2) / (residual.abs() / sigma / 2.0).max(1.0);
        let row = velocities.of(p.part, &p.point).map(|v| normal.dot(&v));
        system.add(row, *residual, weight);
    }
    planes.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deviation_is_that_of_the_mean_of_its_residuals() {
        let mut system = System::new(7);
        let sigma = 0.01_f64;
        for _ in 0..100 {
            system.add([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 0.0, 1.0 / sigma.powi(2));
        }
        let deviations = system.deviations();
        assert!((deviations[3].unwrap() - sigma / 10.0).abs() < 1e-6);
        assert_eq!(deviations[6], None);
    }

    #[test]
    fn two_unknowns_that_one_residual_mixes_are_not_told() {
        let mut system = System::new(7);
        system.add([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0], 0.0, 1e6);
        assert_eq!(system.deviations()[6], None);
        // A residual that fixes the first unknown fixes the second one too.
        system.add([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 0.0, 1e6);
        assert!(system.deviations()[6].is_some_and(|d| d < 0.002));
    }
}
