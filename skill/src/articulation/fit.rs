//! Maximum-likelihood joints with an outlier component (Sturm et al. 2011, section 3),
//! ranked by BIC (paper, Eq. 10).
//!
//! Two departures, because consecutive samples of a motion are not independent: the
//! likelihood counts *effective* observations, estimated from the autocorrelation of the
//! residuals; and a hinge far away from what it carries is penalised by how rarely such
//! hinges are built, since a slide that is bent by a few millimetres is always explained a
//! little better by some arc of several metres' radius.

use super::circle::{fit_circle, principal};
use super::consensus::candidates;
use super::lost_poses::lost_samples;
use super::pose_sample::PoseSample;
use super::rest_state::State;
use crate::math::rigid::{orthonormal_basis, rotation_nearest, wrapped};
use crate::math::robust::median;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::{DMatrix, DVector, Matrix3, Point3, UnitQuaternion, UnitVector3, Vector3, Vector6};
use std::collections::BTreeMap;

/// Standard deviation of an observed position about an ideal joint, metres: marker noise together
/// with the play and bend of real hinges and slides. Ours.
pub const POSITION_SIGMA_M: f64 = 0.008;
/// Standard deviation of an observed orientation, radians.
const ORIENTATION_SIGMA_RAD: f64 = 0.08;
/// Median distance between a hinge and what it carries, metres: hinges that nobody builds are
/// unlikely. Ours: in real logs 0.25-0.68 m.
const HINGE_RADIUS_M: f64 = 0.45;
/// Standard deviation of its logarithm; larger radii are penalised, smaller ones not.
const HINGE_RADIUS_LOG_SIGMA: f64 = 0.5;
/// EM iterations that separate outliers.
const EM_ITERATIONS: usize = 12;

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

/// One joint fitted to all samples.
#[derive(Debug, Clone)]
pub struct FittedJoint {
    /// Its line, in the parent's frame.
    pub geometry: JointGeometry,
    /// Where the part's origin is at configuration 0.
    pub rest_position: Point3<f64>,
    /// How the part is turned at configuration 0.
    pub rest_orientation: UnitQuaternion<f64>,
    /// Configuration of each sample.
    pub configuration: Vec<f64>,
    /// Log likelihood of the effective observations.
    pub log_likelihood: f64,
    /// Bayesian information criterion; least is best.
    pub bic: f64,
    /// Root mean square distance of the inliers, metres.
    pub position_rmse: f64,
    /// Root mean square angle of the inliers, radians; 0 without orientations.
    pub orientation_rmse: f64,
    /// Share of position outliers.
    pub outlier_ratio: f64,
    /// By sample: whether the joint explains its position; the configuration of others means
    /// nothing.
    pub inlier: Vec<bool>,
    /// Independent observations that the samples amount to.
    pub effective_observations: f64,
    /// Covariance of (axis x, y, z, origin x, y, z).
    pub covariance: DMatrix<f64>,
}

/// Fewest samples that a joint is fitted to.
const MIN_SAMPLES: usize = 6;
/// Density of outliers: positions anywhere within about a metre, orientations anywhere
/// within half a radian.
const OUTLIER_LOG_DENSITY_POSITION: f64 = 0.0;
const OUTLIER_LOG_DENSITY_ORIENTATION: f64 = 0.7;
/// Share of outliers below which the mixture is not driven.
const MIN_OUTLIER_RATIO: f64 = 0.01;

/// Samples by which starts are compared.
const COMPARED_SAMPLES: usize = 100;

/// Residual of one sample.
#[derive(Debug, Clone, Copy)]
struct Residual {
    q: f64,
    position: Vector3<f64>,
    /// Rotation vector; `None` without orientation.
    orientation: Option<Vector3<f64>>,
}

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
        fitted.iter_mut().for_each(|joint| all.tell_of_all(joint, &lost));
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

struct Problem<'s> {
    samples: &'s [PoseSample],
    positions: Vec<Point3<f64>>,
    has_orientation: bool,
}

impl<'s> Problem<'s> {
    fn new(samples: &'s [PoseSample]) -> Self {
        Self {
            samples,
            positions: samples.iter().map(|s| s.position).collect(),
            has_orientation: samples.iter().all(|s| s.orientation.is_some()),
        }
    }

    /// EM: weights from the residuals, parameters from the weights.
    fn fit(&self, kind: JointKind) -> Option<FittedJoint> {
        let better = |best: Option<(f64, State)>, start: State| {
            let found = self.refined(start);
            if best.is_none_or(|(likelihood, _)| found.0 > likelihood) { Some(found) } else { best }
        };
        let mut best = self.starts(kind).into_iter().fold(None, better);
        // Starts from all samples are led astray by far outliers, one by few samples is not.
        if best.is_none_or(|(_, state)| self.has_outliers(&state)) {
            best = self.start_by_consensus(kind).into_iter().fold(best, better);
        }
        best.map(|(likelihood, state)| self.finish(&state, likelihood))
    }

    /// A start after EM, and its likelihood.
    fn refined(&self, start: State) -> (f64, State) {
        let mut state = start;
        for round in 0..EM_ITERATIONS {
            // The first rounds take a wider noise, so that a poor start is no trap.
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
            // Joints through samples as they are, noise and all.
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

    fn starts(&self, kind: JointKind) -> Vec<State> {
        let weights = vec![1.0; self.samples.len()];
        let rest_orientation = self.median_orientation();
        let geometry = |axis: Vector3<f64>, origin| JointGeometry {
            kind,
            axis: UnitVector3::new_normalize(axis),
            origin,
            pitch: 0.0,
        };
        let Some(principal) = principal(&self.positions, &weights) else { return Vec::new() };
        let state = |geometry: JointGeometry, rest_position| State {
            geometry,
            rest_position,
            rest_orientation,
        };
        match kind {
            JointKind::Fixed | JointKind::Prismatic => {
                vec![state(geometry(principal.directions[0], principal.mean), principal.mean)]
            }
            JointKind::Revolute => {
                let mut starts = Vec::new();
                if let Some(circle) = fit_circle(&self.positions, &weights) {
                    let rest = self.positions[self.samples.len() / 2];
                    starts.push(state(geometry(circle.normal.into_inner(), circle.centre), rest));
                }
                starts.extend(self.start_from_rotations(kind));
                starts
            }
            JointKind::Helical | JointKind::Nonparametric => Vec::new(),
        }
    }

    /// Axis from the orientations alone: the principal direction of their rotation vectors;
    /// origin from (I - R) c = p - R p0.
    fn start_from_rotations(&self, kind: JointKind) -> Option<State> {
        if !self.has_orientation {
            return None;
        }
        let rest = self.samples[self.samples.len() / 2];
        let rest_orientation = rest.orientation?;
        let mut spread = Matrix3::zeros();
        let mut normal = Matrix3::identity() * 1e-6;
        let mut right = Vector3::zeros();
        for s in self.samples {
            let turn = s.orientation? * rest_orientation.inverse();
            spread += turn.scaled_axis() * turn.scaled_axis().transpose();
            let a = Matrix3::identity() - turn.to_rotation_matrix().into_inner();
            normal += a.transpose() * a;
            right += a.transpose() * (s.position - turn * rest.position);
        }
        let eigen = spread.symmetric_eigen();
        let largest = eigen.eigenvalues.imax();
        if eigen.eigenvalues[largest] < 1e-4 * self.samples.len() as f64 {
            return None;
        }
        let axis = eigen.eigenvectors.column(largest).into_owned();
        let origin = Point3::from(normal.try_inverse()? * right);
        Some(State {
            geometry: JointGeometry {
                kind,
                axis: UnitVector3::new_normalize(axis),
                origin,
                pitch: 0.0,
            },
            rest_position: rest.position,
            rest_orientation,
        })
    }

    /// The orientation that is nearest to all others (of a sample of them).
    fn median_orientation(&self) -> UnitQuaternion<f64> {
        let step = (self.samples.len() / 40).max(1);
        let some: Vec<UnitQuaternion<f64>> =
            self.samples.iter().step_by(step).filter_map(|s| s.orientation).collect();
        let cost = |q: &UnitQuaternion<f64>| some.iter().map(|o| o.angle_to(q)).sum::<f64>();
        some.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).copied().unwrap_or_default()
    }

    fn residuals(&self, state: &State) -> Vec<Residual> {
        self.samples.iter().map(|s| self.residual(state, s)).collect()
    }

    fn residual(&self, state: &State, sample: &PoseSample) -> Residual {
        let g = &state.geometry;
        let q = match g.kind {
            JointKind::Prismatic => g.axis.dot(&(sample.position - state.rest_position)),
            JointKind::Revolute => self.revolute_configuration(state, sample),
            _ => 0.0,
        };
        let motion = g.motion(q);
        Residual {
            q,
            position: sample.position - motion * state.rest_position,
            orientation: sample
                .orientation
                .map(|o| (o * (motion.rotation * state.rest_orientation).inverse()).scaled_axis()),
        }
    }

    /// Angle about the hinge, from the position and, where known, the orientation, each
    /// weighted by what it knows about the angle.
    fn revolute_configuration(&self, state: &State, sample: &PoseSample) -> f64 {
        let axis = state.geometry.axis.into_inner();
        let across = |p: &Point3<f64>| {
            let d = p - state.geometry.origin;
            d - axis * axis.dot(&d)
        };
        let (rest, now) = (across(&state.rest_position), across(&sample.position));
        let by_position = axis.dot(&rest.cross(&now)).atan2(rest.dot(&now));
        let Some(orientation) = sample.orientation else { return by_position };
        let turn = (orientation * state.rest_orientation.inverse()).into_inner();
        let by_orientation = 2.0 * turn.imag().dot(&axis).atan2(turn.w);
        let difference = wrapped(by_orientation - by_position);
        let wp = (rest.norm() * now.norm()) / POSITION_SIGMA_M.powi(2);
        let wo = ORIENTATION_SIGMA_RAD.powi(-2);
        // Beyond three sigma the two contradict each other: the heavier one is believed.
        let tolerance = 3.0 * (1.0 / wp.max(1e-9) + 1.0 / wo).sqrt();
        if difference.abs() > tolerance {
            return if wp > wo { by_position } else { wrapped(by_orientation) };
        }
        wrapped(by_position + difference * wo / (wp + wo))
    }

    /// Posterior probabilities of being no outlier, for position and orientation apart: a
    /// marker that flips is still where it is.
    fn weights(&self, residuals: &[Residual], widen: f64) -> (Vec<f64>, Vec<f64>) {
        let position: Vec<f64> = residuals
            .iter()
            .map(|r| log_normal3(r.position.norm(), widen * POSITION_SIGMA_M))
            .collect();
        let kept = mixture(&position, OUTLIER_LOG_DENSITY_POSITION).0;
        if !self.has_orientation {
            let ones = vec![1.0; kept.len()];
            return (kept, ones);
        }
        let orientation: Vec<f64> = residuals
            .iter()
            .map(|r| {
                let angle = r.orientation.map_or(0.0, |o| o.norm());
                log_normal3(angle, widen * ORIENTATION_SIGMA_RAD)
            })
            .collect();
        (kept, mixture(&orientation, OUTLIER_LOG_DENSITY_ORIENTATION).0)
    }

    fn log_likelihood(&self, residuals: &[Residual]) -> f64 {
        self.log_likelihood_of(residuals, 1.0)
    }

    /// Log likelihood under `widen` times the noise.
    fn log_likelihood_of(&self, residuals: &[Residual], widen: f64) -> f64 {
        let position: Vec<f64> = residuals
            .iter()
            .map(|r| log_normal3(r.position.norm(), widen * POSITION_SIGMA_M))
            .collect();
        let mut sum = mixture(&position, OUTLIER_LOG_DENSITY_POSITION).1;
        if self.has_orientation {
            let orientation: Vec<f64> = residuals
                .iter()
                .filter_map(|r| r.orientation)
                .map(|o| log_normal3(o.norm(), widen * ORIENTATION_SIGMA_RAD))
                .collect();
            sum += mixture(&orientation, OUTLIER_LOG_DENSITY_ORIENTATION).1;
        }
        sum
    }

    fn maximise(
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

    /// Whitened residuals.
    fn stacked(&self, state: &State, wp: &[f64], wo: &[f64]) -> Vec<Vector6<f64>> {
        self.samples
            .iter()
            .zip(wp.iter().zip(wo))
            .map(|(s, (wp, wo))| {
                let r = self.residual(state, s);
                let position = r.position * (wp.sqrt() / POSITION_SIGMA_M);
                let orientation =
                    r.orientation.unwrap_or_default() * (wo.sqrt() / ORIENTATION_SIGMA_RAD);
                Vector6::new(
                    position.x,
                    position.y,
                    position.z,
                    orientation.x,
                    orientation.y,
                    orientation.z,
                )
            })
            .collect()
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
    fn tell_of_all(&self, joint: &mut FittedJoint, lost: &[bool]) {
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

    /// BIC over effective observations, with the prior on a hinge's radius.
    fn score(&self, fitted: &mut [FittedJoint]) {
        let n = self.samples.len() as f64;
        // The straightest moving model's residuals show how long the motion's errors last.
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

fn perturbed(state: &State, delta: &DVector<f64>) -> State {
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

/// Log density of an isotropic normal in three dimensions at distance `r`.
fn log_normal3(r: f64, sigma: f64) -> f64 {
    -0.5 * (r / sigma).powi(2) - 3.0 * sigma.ln() - 1.5 * std::f64::consts::TAU.ln()
}

/// Responsibilities of the inlier component and the mixture's log likelihood, its ratio by EM.
fn mixture(log_inlier: &[f64], log_outlier: f64) -> (Vec<f64>, f64) {
    let n = log_inlier.len().max(1) as f64;
    // Outlier density over inlier density, bounded so that sums stay finite.
    let odds: Vec<f64> = log_inlier.iter().map(|l| (log_outlier - l).min(600.0).exp()).collect();
    let mut ratio: f64 = 0.05;
    let mut weights = vec![1.0; log_inlier.len()];
    for _ in 0..5 {
        let prior = ratio / (1.0 - ratio);
        for (w, odds) in weights.iter_mut().zip(&odds) {
            *w = 1.0 / (1.0 + odds * prior);
        }
        ratio = (1.0 - weights.iter().sum::<f64>() / n).clamp(MIN_OUTLIER_RATIO, 0.9);
    }
    let of_one = |(l, odds): (&f64, &f64)| {
        // Where the odds are bounded the outlier component alone counts.
        let beyond = log_outlier - l > 600.0;
        if beyond { log_outlier + ratio.ln() } else { l + ((1.0 - ratio) + ratio * odds).ln() }
    };
    let likelihood = log_inlier.iter().zip(&odds).map(of_one).sum();
    (weights, likelihood)
}

/// n / (1 + 2 Σ ρ): independent observations that correlated residuals amount to, the sum
/// ending where the autocorrelation first falls below zero (Geyer 1992). Outliers count, but
/// the distance to them does not.
fn effective_count(residuals: &[Residual], inlier: &[bool]) -> f64 {
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
