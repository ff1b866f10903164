//! The maximisation step of EM: the parameters of a joint that fit best to the weighted samples.

use super::circle::{fit_circle, principal};
use super::residuals::{Problem, Residual};
use super::rest_state::State;
use crate::math::rigid::{orthonormal_basis, rotation_nearest};
use crate::object::joint_geometry::JointKind;
use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, UnitVector3, Vector3, Vector6};

impl Problem<'_> {
    /// The state that fits best; `wp` and `wo` are the weights of positions and orientations.
    pub fn maximise(
        &self,
        state: &State,
        residuals: &[Residual],
        wp: &[f64],
        wo: &[f64],
    ) -> Option<State> {
        let mut next = *state;
        match state.geometry.kind {
            JointKind::Fixed => {
                next.rest_position = principal(&self.positions, wp)?.mean;
                next.geometry.origin = next.rest_position;
            }
            JointKind::Prismatic => {
                let p = principal(&self.positions, wp)?;
                let forward = p.directions[0].dot(&state.geometry.axis).signum();
                next.geometry.axis = UnitVector3::new_normalize(p.directions[0] * forward);
                next.rest_position = p.mean;
                next.geometry.origin = p.mean;
            }
            JointKind::Revolute if self.has_orientation => {
                return self.gauss_newton(state, wp, wo);
            }
            JointKind::Revolute => {
                let circle = fit_circle(&self.positions, wp)?;
                let forward = circle.normal.dot(&state.geometry.axis).signum();
                let axis = circle.normal.into_inner() * forward;
                next.geometry.axis = UnitVector3::new_normalize(axis);
                next.geometry.origin = circle.centre;
                let d = state.rest_position - circle.centre;
                let across = d - axis * axis.dot(&d);
                next.rest_position =
                    circle.centre + across * (circle.radius / across.norm().max(1e-9));
            }
            JointKind::Helical | JointKind::Nonparametric => return None,
        }
        if self.has_orientation {
            next.rest_orientation = self.mean_orientation(state, residuals, wo);
        }
        Some(next)
    }

    /// Weighted mean of the orientations, each turned back to configuration 0.
    fn mean_orientation(
        &self,
        state: &State,
        residuals: &[Residual],
        wo: &[f64],
    ) -> UnitQuaternion<f64> {
        let mut sum = Matrix3::zeros();
        for ((s, r), w) in self.samples.iter().zip(residuals).zip(wo) {
            if let Some(o) = s.orientation {
                let back = state.geometry.motion(r.q).rotation.inverse() * o;
                sum += *w * back.to_rotation_matrix().into_inner();
            }
        }
        rotation_nearest(&sum).unwrap_or(state.rest_orientation)
    }

    /// One Gauss-Newton step on axis (2), origin (2), rest position (3) and rest orientation
    /// (3), configurations eliminated by solving for them at every evaluation.
    fn gauss_newton(&self, state: &State, wp: &[f64], wo: &[f64]) -> Option<State> {
        const STEP: f64 = 1e-5;
        let zero = DVector::zeros(10);
        let base = self.stacked(&perturbed(state, &zero), wp, wo);
        let columns: Vec<Vec<Vector6<f64>>> = (0..10)
            .map(|k| {
                let mut delta = zero.clone();
                delta[k] = STEP;
                self.stacked(&perturbed(state, &delta), wp, wo)
            })
            .collect();
        let mut hessian = DMatrix::<f64>::zeros(10, 10);
        let mut gradient = DVector::<f64>::zeros(10);
        for (i, r) in base.iter().enumerate() {
            let jacobian: [Vector6<f64>; 10] = std::array::from_fn(|k| (columns[k][i] - r) / STEP);
            for a in 0..10 {
                gradient[a] += jacobian[a].dot(r);
                for b in a..10 {
                    hessian[(a, b)] += jacobian[a].dot(&jacobian[b]);
                }
            }
        }
        hessian.fill_lower_triangle_with_upper_triangle();
        let damping = 1e-6 * hessian.trace() / 10.0 + 1e-9;
        for k in 0..10 {
            hessian[(k, k)] += damping;
        }
        let step = hessian.cholesky()?.solve(&(-gradient));
        let bounded = if step.norm() > 0.5 { &step * (0.5 / step.norm()) } else { step };
        Some(perturbed(state, &bounded))
    }
}

/// A state moved by small steps: axis (2), origin (2), rest position (3), rest orientation (3).
pub fn perturbed(state: &State, delta: &DVector<f64>) -> State {
    let axis = state.geometry.axis.into_inner();
    let (u, v) = orthonormal_basis(&axis);
    let mut next = *state;
    next.geometry.axis = UnitVector3::new_normalize(axis + u * delta[0] + v * delta[1]);
    next.geometry.origin += u * delta[2] + v * delta[3];
    next.rest_position += Vector3::new(delta[4], delta[5], delta[6]);
    let turn = Vector3::new(delta[7], delta[8], delta[9]);
    next.rest_orientation = UnitQuaternion::from_scaled_axis(turn) * state.rest_orientation;
    next
}
