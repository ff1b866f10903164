//! Scores fitted joints by the Bayesian information criterion (paper, Eq. 11), and estimates their
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

#[cfg(test)]
mod tests {
    use super::super::pose_sample::PoseSample;
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::{Point3, UnitQuaternion};

    fn residuals(offsets: impl IntoIterator<Item = f64>) -> Vec<Residual> {
        let residual = |x| Residual { q: 0.0, position: Vector3::x() * x, orientation: None };
        offsets.into_iter().map(residual).collect()
    }

    fn count(offsets: impl IntoIterator<Item = f64>) -> f64 {
        let residuals = residuals(offsets);
        effective_count(&residuals, &vec![true; residuals.len()])
    }

    /// 1, 1, -1, 1, ... without any period.
    fn sign(i: usize) -> f64 {
        if (i * i * 7 + i * 3).is_multiple_of(5) || i.is_multiple_of(7) { 1.0 } else { -1.0 }
    }

    #[test]
    fn residuals_that_alternate_are_as_many_observations_as_they_are() {
        assert_eq!(count((0..100).map(|i| if i % 2 == 0 { 1e-3 } else { -1e-3 })), 100.0);
    }

    #[test]
    fn residuals_that_keep_their_value_for_ten_samples_are_ten_times_fewer() {
        let found = count((0..600).map(|i| 1e-3 * sign(i / 10)));
        assert!((30.0..120.0).contains(&found), "{found}");
    }

    #[test]
    fn residuals_that_vanish_are_all_observations_and_none_are_none() {
        assert_eq!(count([0.0; 20]), 20.0);
        assert_eq!(count([]), 0.0);
    }

    #[test]
    fn how_far_an_outlier_lies_does_not_matter() {
        let with_outlier = |far: f64| {
            let residuals = residuals((0..60).map(|i| if i == 30 { far } else { 1e-3 * sign(i) }));
            let inlier: Vec<bool> = (0..60).map(|i| i != 30).collect();
            effective_count(&residuals, &inlier)
        };
        assert!((with_outlier(1.0) - with_outlier(100.0)).abs() < 1e-6);
    }

    /// A hinge along z at the origin, fitted to a part this far from it.
    fn hinge(radius: f64) -> FittedJoint {
        FittedJoint {
            geometry: JointGeometry::hinge(Vector3::z_axis(), Point3::origin()),
            rest_position: Point3::new(radius, 0.0, 0.0),
            rest_orientation: UnitQuaternion::identity(),
            configuration: Vec::new(),
            log_likelihood: 0.0,
            bic: 0.0,
            position_rmse: 0.0,
            orientation_rmse: 0.0,
            outlier_ratio: 0.0,
            inlier: vec![true; 40],
            effective_observations: 40.0,
            covariance: DMatrix::zeros(6, 6),
        }
    }

    /// What the hinge's part is seen to do; all orientations are told, or none.
    fn samples(radius: f64, has_orientation: bool) -> Vec<PoseSample> {
        let joint = hinge(radius);
        let sample = |i| {
            let motion = joint.geometry.motion(0.03 * f64::from(i));
            let orientation = has_orientation.then_some(motion.rotation);
            PoseSample { t: f64::from(i), position: motion * joint.rest_position, orientation }
        };
        (0..40).map(sample).collect()
    }

    #[test]
    fn a_hinge_is_penalised_only_where_it_is_farther_than_hinges_are_built() {
        let samples = samples(0.3, true);
        let problem = Problem::new(&samples);
        assert_eq!(problem.hinge_penalty(&hinge(0.1)), 0.0);
        assert_eq!(problem.hinge_penalty(&hinge(HINGE_RADIUS_M)), 0.0);
        let far = HINGE_RADIUS_M * HINGE_RADIUS_LOG_SIGMA.exp();
        assert!((problem.hinge_penalty(&hinge(far)) - 1.0).abs() < 1e-9);
        let slide = JointGeometry::slide(Vector3::z_axis(), Point3::origin());
        assert_eq!(problem.hinge_penalty(&FittedJoint { geometry: slide, ..hinge(5.0) }), 0.0);
    }

    #[test]
    fn without_orientations_each_type_has_three_parameters_fewer() {
        let (full, places) = (samples(0.3, true), samples(0.3, false));
        let kinds = [JointKind::Fixed, JointKind::Prismatic, JointKind::Revolute];
        let of = |samples: &[PoseSample]| {
            let problem = Problem::new(samples);
            kinds.map(|kind| problem.parameter_count(kind))
        };
        assert_eq!(of(&full), [6.0, 8.0, 9.0]);
        assert_eq!(of(&places), [3.0, 5.0, 6.0]);
    }

    #[test]
    fn a_line_is_known_the_better_the_more_observations_tell_it_and_not_along_itself() {
        let samples = samples(0.4, true);
        let problem = Problem::new(&samples);
        let covariance = |effective_observations| {
            problem.covariance(&FittedJoint { effective_observations, ..hinge(0.4) })
        };
        let (few, many) = (covariance(10.0), covariance(40.0));
        for k in [0, 1, 3, 4] {
            let ratio = few[(k, k)] / many[(k, k)];
            assert!((ratio - 4.0).abs() < 0.1, "{k}: {ratio}");
        }
        assert!(many[(2, 2)].abs() < 1e-15 && many[(5, 5)].abs() < 1e-15);
        let nothing = FittedJoint { inlier: vec![false; 40], ..hinge(0.4) };
        assert!(problem.covariance(&nothing).iter().all(|x| x.is_finite()));
    }

    #[test]
    fn what_does_not_move_has_no_line_to_be_unsure_of() {
        let samples = samples(0.4, true);
        let mut geometry = hinge(0.4).geometry;
        geometry.kind = JointKind::Fixed;
        let rigid = FittedJoint { geometry, ..hinge(0.4) };
        assert_eq!(Problem::new(&samples).covariance(&rigid), DMatrix::zeros(6, 6));
    }
}
