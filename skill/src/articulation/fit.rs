//! Maximum-likelihood joints with an outlier component (Sturm et al. 2011, section 3),
//! ranked by BIC (paper, Eq. 11).
//!
//! Two departures, because consecutive samples of a motion are not independent: the
//! likelihood counts *effective* observations, estimated from the autocorrelation of the
//! residuals; and a hinge far away from what it carries is penalised by how rarely such
//! hinges are built, since a slide that is bent by a few millimetres is always explained a
//! little better by some arc of several metres' radius.

use super::consensus::candidates;
use super::fitted_joint::FittedJoint;
use super::lost_poses::lost_samples;
use super::model_selection::effective_count;
use super::pose_sample::PoseSample;
use super::residuals::{POSITION_SIGMA_M, Problem, Residual};
use super::rest_state::State;
use crate::object::joint_geometry::JointKind;
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// A log that no joint can be fitted to.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum FitError {
    /// Too few samples.
    #[error("{found} samples, at least {needed} are needed")]
    TooFewSamples {
        /// Samples given.
        found: usize,
        /// Samples needed.
        needed: usize,
    },
    /// A value that is not finite.
    #[error("sample {sample} is not finite")]
    NotFinite {
        /// Number of the sample, from 0.
        sample: usize,
    },
}

/// EM iterations that separate outliers.
const EM_ITERATIONS: usize = 12;
/// Fewest samples that a joint is fitted to.
const MIN_SAMPLES: usize = 6;
/// Samples by which initial states are compared.
const COMPARED_SAMPLES: usize = 100;

/// Fits rigid, prismatic and revolute joints; least BIC first.
///
/// # Errors
/// [`FitError`] for too few samples or a value that is not finite.
///
/// # Source
/// Paper, Eqs. 8-10; Sturm et al. 2011, sections 3.2-3.4.
pub fn fit_models(samples: &[PoseSample]) -> Result<Vec<FittedJoint>, FitError> {
    if samples.len() < MIN_SAMPLES {
        return Err(FitError::TooFewSamples { found: samples.len(), needed: MIN_SAMPLES });
    }
    if let Some(sample) = samples.iter().position(|s| !is_finite(s)) {
        return Err(FitError::NotFinite { sample });
    }
    let samples = &samples.iter().map(within_bounds).collect::<Vec<_>>()[..];
    let lost = lost_samples(samples, POSITION_SIGMA_M);
    let kept: Vec<PoseSample> =
        samples.iter().zip(&lost).filter(|(_, lost)| !**lost).map(|(s, _)| *s).collect();
    let problem = Problem::new(&kept);
    let mut fitted: Vec<FittedJoint> =
        [JointKind::Fixed, JointKind::Prismatic, JointKind::Revolute]
            .into_iter()
            .filter_map(|kind| problem.fit(kind))
            .collect();
    problem.score(&mut fitted);
    if kept.len() < samples.len() {
        let all = Problem::new(samples);
        fitted.iter_mut().for_each(|joint| all.add_lost(joint, &lost));
    }
    fitted.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    Ok(fitted)
}

/// No thing is farther away, metres. Products of such lengths are still finite.
const FARTHEST_M: f64 = 1e9;

/// A place that programs write where they have none, such as the largest number, is as far away as
/// can be computed with.
fn within_bounds(sample: &PoseSample) -> PoseSample {
    let position = sample.position.map(|x| x.clamp(-FARTHEST_M, FARTHEST_M));
    PoseSample { position, ..*sample }
}

fn is_finite(sample: &PoseSample) -> bool {
    let turn = sample.orientation.unwrap_or_default();
    sample.position.coords.iter().chain(turn.coords.iter()).all(|x| x.is_finite())
}

/// Probability of each kind given the samples, from the BIC of its fit (Kass & Raftery 1995).
#[must_use]
pub fn type_probabilities(fits: &[FittedJoint]) -> BTreeMap<JointKind, f64> {
    let least = fits.iter().map(|f| f.bic).fold(f64::INFINITY, f64::min);
    let weights: Vec<f64> = fits.iter().map(|f| (-0.5 * (f.bic - least)).exp()).collect();
    let total: f64 = weights.iter().sum();
    fits.iter().zip(weights).map(|(f, w)| (f.geometry.kind, w / total)).collect()
}

impl Problem<'_> {
    /// EM: weights from the residuals, parameters from the weights.
    fn fit(&self, kind: JointKind) -> Option<FittedJoint> {
        let better = |best: Option<(f64, State)>, start: State| {
            let found = self.refined(start);
            if best.is_none_or(|(likelihood, _)| found.0 > likelihood) { Some(found) } else { best }
        };
        let mut best = self.starts(kind).into_iter().fold(None, better);
        // Initial states from all samples are wrong where outliers lie far away; one from few
        // samples is not.
        if best.is_none_or(|(_, state)| self.has_outliers(&state)) {
            best = self.start_by_consensus(kind).into_iter().fold(best, better);
        }
        best.map(|(likelihood, state)| self.finish(&state, likelihood))
    }

    /// The state after EM from an initial one, and its log likelihood.
    fn refined(&self, start: State) -> (f64, State) {
        let mut state = start;
        for round in 0..EM_ITERATIONS {
            // The first rounds assume more noise, so that a poor initial state does not end in a local
            // maximum.
            let widen = 1.0 + 4.0 * (-(round as f64) / 1.5).exp();
            let residuals = self.residuals(&state);
            let (wp, wo) = self.weights(&residuals, widen);
            let Some(next) = self.maximise(&state, &residuals, &wp, &wo) else { break };
            let done = self.close(&state, &next) && round > 3;
            state = next;
            if done {
                break;
            }
        }
        (self.log_likelihood(&self.residuals(&state)), state)
    }

    fn has_outliers(&self, state: &State) -> bool {
        let (wp, wo) = self.weights(&self.residuals(state), 1.0);
        wp.iter().chain(&wo).any(|w| *w < 0.5)
    }

    /// The joint through few samples that explains the others best.
    fn start_by_consensus(&self, kind: JointKind) -> Option<State> {
        let stride = self.samples.len().div_ceil(COMPARED_SAMPLES);
        let likelihood = |state: &State| {
            let some = self.samples.iter().step_by(stride);
            let residuals: Vec<Residual> = some.map(|s| self.residual(state, s)).collect();
            // These joints pass exactly through noisy samples, so twice the noise is assumed.
            self.log_likelihood_of(&residuals, 2.0)
        };
        let scored = candidates(kind, self.samples).into_iter().map(|s| (likelihood(&s), s));
        scored.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, state)| state)
    }

    fn close(&self, a: &State, b: &State) -> bool {
        (a.geometry.axis.into_inner() - b.geometry.axis.into_inner()).norm() < 1e-5
            && (a.geometry.origin - b.geometry.origin).norm() < 1e-5
            && (a.rest_position - b.rest_position).norm() < 1e-6
    }

    fn finish(&self, state: &State, log_likelihood: f64) -> FittedJoint {
        let residuals = self.residuals(state);
        let (wp, wo) = self.weights(&residuals, 1.0);
        let rms = |values: &mut dyn Iterator<Item = (f64, f64)>| {
            let (mut sum, mut weight) = (0.0, 0.0);
            for (r, w) in values {
                sum += w * r * r;
                weight += w;
            }
            if weight > 0.0 { (sum / weight).sqrt() } else { 0.0 }
        };
        let position_rmse =
            rms(&mut residuals.iter().zip(&wp).map(|(r, w)| (r.position.norm(), *w)));
        let orientation_rmse = rms(&mut residuals
            .iter()
            .zip(&wo)
            .filter_map(|(r, w)| Some((r.orientation?.norm(), *w))));
        let inlier: Vec<bool> = wp.iter().map(|w| *w > 0.5).collect();
        let mut geometry = state.geometry;
        if geometry.kind == JointKind::Revolute {
            geometry.origin = crate::math::rigid::nearest_on_line(
                &geometry.origin,
                &geometry.axis,
                &state.rest_position,
            );
        }
        FittedJoint {
            geometry,
            rest_position: state.rest_position,
            rest_orientation: state.rest_orientation,
            configuration: unwrapped(&residuals, &inlier),
            log_likelihood,
            bic: f64::INFINITY,
            position_rmse,
            orientation_rmse,
            outlier_ratio: 1.0 - wp.iter().sum::<f64>() / wp.len() as f64,
            effective_observations: effective_count(&residuals, &inlier),
            inlier,
            covariance: DMatrix::zeros(6, 6),
        }
    }

    /// Adds the lost samples to a joint that was fitted to the others: they are outliers.
    fn add_lost(&self, joint: &mut FittedJoint, lost: &[bool]) {
        let state = State {
            geometry: joint.geometry,
            rest_position: joint.rest_position,
            rest_orientation: joint.rest_orientation,
        };
        let mut of_kept = std::mem::take(&mut joint.inlier).into_iter();
        joint.inlier = lost.iter().map(|&lost| !lost && of_kept.next().unwrap_or(false)).collect();
        let n = self.samples.len() as f64;
        let lost = lost.iter().filter(|l| **l).count() as f64;
        joint.outlier_ratio = (joint.outlier_ratio * (n - lost) + lost) / n;
        joint.configuration = unwrapped(&self.residuals(&state), &joint.inlier);
    }
}

/// Angles without jumps of a full turn, from each inlier to the next.
fn unwrapped(residuals: &[Residual], inlier: &[bool]) -> Vec<f64> {
    let mut previous: Option<f64> = None;
    let unwrap = |(r, &is_inlier): (&Residual, &bool)| {
        let q = previous.map_or(r.q, |before: f64| {
            r.q - std::f64::consts::TAU * ((r.q - before) / std::f64::consts::TAU).round()
        });
        if is_inlier || previous.is_none() {
            previous = Some(q);
        }
        q
    };
    residuals.iter().zip(inlier).map(unwrap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};
    use std::f64::consts::PI;

    fn hinge() -> JointGeometry {
        JointGeometry::hinge(Vector3::z_axis(), Point3::new(0.1, -0.2, 0.3))
    }

    fn slide() -> JointGeometry {
        JointGeometry::slide(Vector3::x_axis(), Point3::origin())
    }

    /// Poses of a part that a joint moves.
    fn moved(joint: &JointGeometry, q: impl Iterator<Item = f64>) -> Vec<PoseSample> {
        let rest = Pose::translation(0.5, 0.1, 0.4);
        let pose =
            |(i, q): (usize, f64)| PoseSample::from_pose(i as f64, &(joint.motion(q) * rest));
        q.enumerate().map(pose).collect()
    }

    fn opening() -> impl Iterator<Item = f64> {
        (0..40).map(|i| 0.03 * f64::from(i))
    }

    #[test]
    fn places_as_far_away_as_numbers_go_are_outliers_or_give_some_answer() {
        let whole = moved(&hinge(), opening());
        for far in [1e12, 1e100, 1e160, -1e300, f64::MAX] {
            let mut samples = whole.clone();
            samples[7].position.x = far;
            samples[20].position = Point3::new(far, far, -far);
            let fits = fit_models(&samples).unwrap();
            assert_eq!(fits[0].geometry.kind, JointKind::Revolute, "{far}");
            let apart = fits[0].geometry.origin - hinge().origin;
            assert!(apart.xy().norm() < 1e-3, "{far}: {apart}");
            // Units that nobody has: all that counts is that it ends, and with numbers.
            let spread: Vec<PoseSample> = whole
                .iter()
                .map(|s| PoseSample { position: s.position.map(|x| x * far), ..*s })
                .collect();
            let fits = fit_models(&spread).unwrap();
            assert!(fits.iter().all(|f| f.geometry.origin.coords.iter().all(|x| x.is_finite())));
        }
    }

    #[test]
    fn the_type_that_made_the_poses_is_the_best_and_has_its_line_and_configurations() {
        for joint in [hinge(), slide()] {
            let fits = fit_models(&moved(&joint, opening())).unwrap();
            assert_eq!(fits[0].geometry.kind, joint.kind);
            let line = &fits[0].geometry;
            assert!(line.axis.dot(&joint.axis).abs() > 1.0 - 1e-9);
            let turned = (fits[0].configuration[39] - fits[0].configuration[0]).abs();
            assert!((turned - 39.0 * 0.03).abs() < 1e-3, "{turned}");
            assert!(fits[0].position_rmse < 1e-4 && fits[0].outlier_ratio < 1e-3);
        }
        let fits = fit_models(&moved(&hinge(), opening())).unwrap();
        let apart = fits[0].geometry.origin - hinge().origin;
        assert!(apart.xy().norm() < 1e-4, "{apart}");
    }

    #[test]
    fn what_keeps_still_is_rigid() {
        let fits = fit_models(&moved(&hinge(), std::iter::repeat_n(0.4, 30))).unwrap();
        assert_eq!(fits[0].geometry.kind, JointKind::Fixed);
    }

    #[test]
    fn a_part_that_turns_more_than_once_around_has_no_jump() {
        let twice = (0..120).map(|i| 4.0 * PI * f64::from(i) / 119.0);
        let fits = fit_models(&moved(&hinge(), twice)).unwrap();
        let q = &fits[0].configuration;
        assert!(((q[119] - q[0]).abs() - 4.0 * PI).abs() < 1e-3);
    }

    #[test]
    fn too_few_samples_are_refused_with_how_many_are_needed() {
        for found in [0, 5] {
            let few = moved(&hinge(), opening().take(found));
            assert_eq!(
                fit_models(&few).unwrap_err(),
                FitError::TooFewSamples { found, needed: MIN_SAMPLES }
            );
        }
    }

    #[test]
    fn a_position_that_is_not_finite_is_refused_by_its_number() {
        for value in [f64::NAN, f64::INFINITY] {
            let mut samples = moved(&hinge(), opening());
            samples[7].position.y = value;
            assert_eq!(fit_models(&samples).unwrap_err(), FitError::NotFinite { sample: 7 });
        }
    }

    #[test]
    fn an_orientation_that_is_not_finite_is_refused_by_its_number() {
        let mut samples = moved(&hinge(), opening());
        let broken = Quaternion::new(f64::NAN, 0.0, 0.0, 1.0);
        samples[7].orientation = Some(UnitQuaternion::new_unchecked(broken));
        assert_eq!(fit_models(&samples).unwrap_err(), FitError::NotFinite { sample: 7 });
    }

    #[test]
    fn the_probabilities_of_all_types_sum_to_one_and_the_best_fit_has_the_greatest() {
        let fits = fit_models(&moved(&slide(), opening())).unwrap();
        let probabilities = type_probabilities(&fits);
        assert!((probabilities.values().sum::<f64>() - 1.0).abs() < 1e-12);
        let best = probabilities[&fits[0].geometry.kind];
        assert!(probabilities.values().all(|p| *p <= best));
        assert!(type_probabilities(&[]).is_empty());
    }

    #[test]
    fn an_outlier_does_not_turn_the_angles_after_it() {
        let seen = |q: f64| Residual { q, position: Vector3::zeros(), orientation: None };
        let residuals = [seen(3.0), seen(-0.1), seen(-3.0)];
        let q = unwrapped(&residuals, &[true, false, true]);
        assert!((q[2] - (2.0 * PI - 3.0)).abs() < 1e-12, "{q:?}");
        assert!(unwrapped(&[], &[]).is_empty());
    }
}
