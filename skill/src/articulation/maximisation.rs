//! The maximisation step of EM: the parameters of a joint that fit best to the weighted samples.

use super::circle::{fit_circle, principal};
use super::residuals::{Problem, Residual};
use super::rest_state::State;
use crate::math::normal_equations::NormalEquations;
use crate::math::rigid::{orthonormal_basis, rotation_nearest};
use crate::object::joint_geometry::JointKind;
use nalgebra::{Const, DVector, Matrix3, SVector, UnitQuaternion, UnitVector3, Vector3, Vector6};

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
        let mut equations = NormalEquations::<Const<10>>::zero();
        for (i, r) in base.iter().enumerate() {
            for (c, residual) in r.iter().enumerate() {
                let row = SVector::from_fn(|k, _| (columns[k][i][c] - residual) / STEP);
                equations.add(&row, *residual, 1.0);
            }
        }
        equations.damp(1e-6 * equations.left.trace() / 10.0 + 1e-9);
        let step = -equations.solution()?;
        let bounded = step * (0.5 / step.norm().max(0.5));
        Some(perturbed(state, &DVector::from_column_slice(bounded.as_slice())))
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

#[cfg(test)]
mod tests {
    use super::super::pose_sample::PoseSample;
    use super::*;
    use crate::math::rigid::{distance_to_line, line_angle};
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::Point3;

    fn truth(geometry: JointGeometry) -> State {
        State {
            geometry,
            rest_position: Point3::new(0.5, 0.1, 0.2),
            rest_orientation: UnitQuaternion::from_euler_angles(0.2, 0.1, -0.3),
        }
    }

    fn hinge() -> State {
        truth(JointGeometry::hinge(Vector3::z_axis(), Point3::new(0.1, -0.1, 0.0)))
    }

    fn slide() -> State {
        truth(JointGeometry::slide(Vector3::x_axis(), Point3::origin()))
    }

    /// The part's poses at configurations about 0.
    fn samples(state: &State, has_orientation: bool) -> Vec<PoseSample> {
        let sample = |i: i32| {
            let motion = state.geometry.motion(0.04 * f64::from(i));
            let orientation = has_orientation.then(|| motion.rotation * state.rest_orientation);
            PoseSample { t: f64::from(i), position: motion * state.rest_position, orientation }
        };
        (-15..=15).map(sample).collect()
    }

    /// A state after so many steps, all samples of one weight.
    fn stepped(start: &State, samples: &[PoseSample], steps: usize) -> Option<State> {
        let problem = Problem::new(samples);
        let ones = vec![1.0; samples.len()];
        (0..steps).try_fold(*start, |state, _| {
            problem.maximise(&state, &problem.residuals(&state), &ones, &ones)
        })
    }

    #[test]
    fn the_state_that_made_the_samples_is_kept() {
        for state in [hinge(), slide()] {
            let kept = stepped(&state, &samples(&state, true), 1).unwrap();
            assert!(kept.geometry.axis.dot(&state.geometry.axis) > 1.0 - 1e-9);
            assert!((kept.rest_position - state.rest_position).norm() < 1e-6);
            assert!(kept.rest_orientation.angle_to(&state.rest_orientation) < 1e-6);
        }
    }

    #[test]
    fn a_hinge_beside_the_true_one_is_led_to_it() {
        let off =
            DVector::from_row_slice(&[0.1, -0.1, 0.05, 0.03, 0.01, 0.0, -0.02, 0.05, 0.0, 0.1]);
        let led = stepped(&perturbed(&hinge(), &off), &samples(&hinge(), true), 20).unwrap();
        let line = hinge().geometry;
        assert!(line_angle(&led.geometry.axis, &line.axis) < 1e-4);
        assert!(distance_to_line(&line.origin, &line.axis, &led.geometry.origin) < 1e-4);
    }

    #[test]
    fn places_alone_give_a_hinge_by_their_circle_and_a_slide_by_their_line() {
        let turned = stepped(&hinge(), &samples(&hinge(), false), 1).unwrap();
        let line = hinge().geometry;
        assert!(distance_to_line(&line.origin, &line.axis, &turned.geometry.origin) < 1e-6);
        let slid = stepped(&slide(), &samples(&slide(), false), 1).unwrap();
        assert!(line_angle(&slid.geometry.axis, &Vector3::x_axis()) < 1e-9);
    }

    #[test]
    fn an_axis_keeps_its_sense() {
        for mut state in [hinge(), slide()] {
            let samples = samples(&state, false);
            for _ in 0..2 {
                state.geometry.axis = -state.geometry.axis;
                let next = stepped(&state, &samples, 1).unwrap();
                assert!(next.geometry.axis.dot(&state.geometry.axis) > 0.99);
            }
        }
    }

    #[test]
    fn samples_without_weight_give_no_state() {
        for state in [hinge(), slide()] {
            let samples = samples(&state, false);
            let problem = Problem::new(&samples);
            let nothing = vec![0.0; samples.len()];
            let residuals = problem.residuals(&state);
            assert!(problem.maximise(&state, &residuals, &nothing, &nothing).is_none());
        }
    }

    #[test]
    fn an_outlier_without_weight_has_no_say() {
        let mut samples = samples(&slide(), true);
        samples[3].position += Vector3::new(0.0, 2.0, 0.0);
        samples[3].orientation = Some(UnitQuaternion::from_euler_angles(2.0, 0.0, 0.0));
        let problem = Problem::new(&samples);
        let weights: Vec<f64> = (0..samples.len()).map(|i| f64::from(u8::from(i != 3))).collect();
        let residuals = problem.residuals(&slide());
        let next = problem.maximise(&slide(), &residuals, &weights, &weights).unwrap();
        assert!(line_angle(&next.geometry.axis, &Vector3::x_axis()) < 1e-9);
        assert!(next.rest_orientation.angle_to(&slide().rest_orientation) < 1e-6);
    }

    #[test]
    fn small_steps_move_each_unknown_by_themselves_and_none_moves_none() {
        let state = hinge();
        let same = perturbed(&state, &DVector::zeros(10));
        assert_eq!(same.rest_position, state.rest_position);
        assert!(
            (same.geometry.axis.into_inner() - state.geometry.axis.into_inner()).norm() < 1e-15
        );
        let mut step = DVector::zeros(10);
        (step[0], step[5], step[9]) = (0.02, 0.3, 0.1);
        let moved = perturbed(&state, &step);
        assert!((line_angle(&moved.geometry.axis, &state.geometry.axis) - 0.02).abs() < 1e-5);
        assert!((moved.geometry.axis.norm() - 1.0).abs() < 1e-12);
        assert!((moved.rest_position - state.rest_position - Vector3::y() * 0.3).norm() < 1e-12);
        assert!((moved.rest_orientation.angle_to(&state.rest_orientation) - 0.1).abs() < 1e-9);
        assert_eq!(moved.geometry.origin, state.geometry.origin);
    }
}
