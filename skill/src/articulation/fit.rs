//! Maximum-likelihood joints with an outlier component (Sturm et al. 2011, section 3),
//! ranked by BIC (paper, Eq. 10).
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
    if let Some(sample) =
        samples.iter().position(|s| !s.position.coords.iter().all(|x| x.is_finite()))
    {
        return Err(FitError::NotFinite { sample });
    }
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
