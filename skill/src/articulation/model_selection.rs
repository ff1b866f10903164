//! Scores fitted joints by the Bayesian information criterion (paper, Eq. 10), and estimates their
//! covariance.

use super::fitted_joint::FittedJoint;
use super::maximisation::perturbed;
use super::residuals::{ORIENTATION_SIGMA_RAD, POSITION_SIGMA_M, Problem, Residual};
use super::rest_state::State;
use crate::math::rigid::orthonormal_basis;
use crate::math::robust::median;
use crate::object::joint_geometry::JointKind;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};

/// Median distance between a hinge and the part that it carries, metres: hinges much farther away are
/// rarely built. Ours: in real logs 0.25-0.68 m.
const HINGE_RADIUS_M: f64 = 0.45;
/// Standard deviation of its logarithm; larger radii are penalised, smaller ones not.
const HINGE_RADIUS_LOG_SIGMA: f64 = 0.5;

impl Problem<'_> {
    /// BIC over effective observations, with the prior on a hinge's radius.
    pub fn score(&self, fitted: &mut [FittedJoint]) {
        let n = self.samples.len() as f64;
        // The moving joint with the fewest effective observations shows for how long errors are
        // correlated.
        let effective = fitted
            .iter()
            .filter(|f| f.geometry.kind != JointKind::Fixed)
            .map(|f| f.effective_observations)
            .fold(f64::INFINITY, f64::min);
        let effective = if effective.is_finite() { effective.clamp(2.0, n) } else { n };
        for f in fitted {
            let per_sample = f.log_likelihood / n;
            f.log_likelihood = per_sample * effective;
            f.effective_observations = effective;
            let parameters = self.parameter_count(f.geometry.kind);
            f.bic = -2.0 * f.log_likelihood + parameters * effective.ln() + self.hinge_penalty(f);
            f.covariance = self.covariance(f);
        }
    }

    /// Rigid 6, prismatic 8, revolute 9 (Sturm et al. 2011); three fewer without orientation.
    fn parameter_count(&self, kind: JointKind) -> f64 {
        let full: f64 = match kind {
            JointKind::Fixed => 6.0,
            JointKind::Prismatic => 8.0,
            _ => 9.0,
        };
        if self.has_orientation { full } else { full - 3.0 }
    }

    /// -2 log of the prior of the radius relative to the most common one.
    fn hinge_penalty(&self, f: &FittedJoint) -> f64 {
        if f.geometry.kind != JointKind::Revolute {
            return 0.0;
        }
        let radius = (f.rest_position - f.geometry.origin).norm();
        let excess = (radius / HINGE_RADIUS_M).ln().max(0.0);
        (excess / HINGE_RADIUS_LOG_SIGMA).powi(2)
    }

    /// Covariance of axis and origin from the curvature of the likelihood, for as many
    /// observations as are effective and no less noise than the residuals show.
    fn covariance(&self, f: &FittedJoint) -> DMatrix<f64> {
        let state = State {
            geometry: f.geometry,
            rest_position: f.rest_position,
            rest_orientation: f.rest_orientation,
        };
        if f.geometry.kind == JointKind::Fixed {
            return DMatrix::zeros(6, 6);
        }
        let ones = vec![1.0; self.samples.len()];
        let zero = DVector::zeros(10);
        let base = self.stacked(&state, &ones, &ones);
        const STEP: f64 = 1e-5;
        let told: Vec<usize> = (0..self.samples.len()).filter(|&i| f.inlier[i]).collect();
        let stride = (told.len() / 40).max(1);
        let mut information = DMatrix::<f64>::identity(10, 10) * 1e-3;
        let columns: Vec<Vec<Vector6<f64>>> = (0..10)
            .map(|k| {
                let mut delta = zero.clone();
                delta[k] = STEP;
                let moved = perturbed(&state, &delta);
                told.iter()
                    .step_by(stride)
                    .map(|&i| {
                        let r = self.residual(&moved, &self.samples[i]);
                        let p = r.position / POSITION_SIGMA_M;
                        let o = r.orientation.unwrap_or_default() / ORIENTATION_SIGMA_RAD;
                        (Vector6::new(p.x, p.y, p.z, o.x, o.y, o.z) - base[i]) / STEP
                    })
                    .collect()
            })
            .collect();
        let used = columns[0].len().max(1) as f64;
        for a in 0..10 {
            for b in 0..10 {
                let sum: f64 = columns[a].iter().zip(&columns[b]).map(|(x, y)| x.dot(y)).sum();
                information[(a, b)] += sum * f.effective_observations / used;
            }
        }
        let Some(covariance) = information.try_inverse() else { return DMatrix::zeros(6, 6) };
        let (u, v) = orthonormal_basis(&f.geometry.axis);
        let mut to_space = DMatrix::<f64>::zeros(6, 10);
        for r in 0..3 {
            to_space[(r, 0)] = u[r];
            to_space[(r, 1)] = v[r];
            to_space[(r + 3, 2)] = u[r];
            to_space[(r + 3, 3)] = v[r];
        }
        &to_space * covariance * to_space.transpose()
    }
}

/// n / (1 + 2 Σ ρ): independent observations that correlated residuals amount to, the sum
/// ending where the autocorrelation first falls below zero (Geyer 1992). Outliers count, but
/// the distance to them does not.
pub fn effective_count(residuals: &[Residual], inlier: &[bool]) -> f64 {
    let n = residuals.len();
    let mean_of = |inliers_alone: bool| {
        let some = residuals.iter().zip(inlier).filter(|(_, is)| **is || !inliers_alone);
        let (sum, count) =
            some.fold((Vector3::zeros(), 0.0), |(sum, n), (r, _)| (sum + r.position, n + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    let mean = mean_of(true).or_else(|| mean_of(false)).unwrap_or_default();
    let centred: Vec<Vector3<f64>> = {
        let mut norms: Vec<f64> = residuals.iter().map(|r| (r.position - mean).norm()).collect();
        let limit = 3.0 * median(&mut norms).unwrap_or(0.0).max(1e-9);
        residuals
            .iter()
            .map(|r| {
                let d = r.position - mean;
                if d.norm() > limit { d * (limit / d.norm()) } else { d }
            })
            .collect()
    };
    let at_lag = |lag: usize| {
        (0..n - lag).map(|i| centred[i].dot(&centred[i + lag])).sum::<f64>() / n as f64
    };
    let variance = at_lag(0);
    if variance <= 1e-18 {
        return n as f64;
    }
    let mut sum = 0.0;
    for lag in 1..n / 2 {
        let rho = at_lag(lag) / variance;
        if rho <= 0.0 {
            break;
        }
        sum += rho;
    }
    n as f64 / (1.0 + 2.0 * sum)
}
