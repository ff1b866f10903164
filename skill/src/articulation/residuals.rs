//! Residuals of samples against a joint, and their likelihood: the noise is normally distributed,
//! and some samples are outliers.

use super::pose_sample::PoseSample;
use super::rest_state::State;
use crate::math::rigid::wrapped;
use crate::object::joint_geometry::JointKind;
use nalgebra::{Point3, Vector3, Vector6};

/// Standard deviation of an observed position about an ideal joint, metres: marker noise together
/// with the play and bend of real hinges and slides. Ours.
pub const POSITION_SIGMA_M: f64 = 0.008;
/// Standard deviation of an observed orientation, radians.
pub const ORIENTATION_SIGMA_RAD: f64 = 0.08;

/// Beyond so many standard deviations a position contradicts the circle, or an angle the other one.
const CONTRADICTION_SIGMAS: f64 = 3.0;

/// Density of outliers: positions anywhere within about a metre, orientations anywhere
/// within half a radian.
const OUTLIER_LOG_DENSITY_POSITION: f64 = 0.0;
const OUTLIER_LOG_DENSITY_ORIENTATION: f64 = 0.7;
/// Smallest share of outliers in the mixture.
const MIN_OUTLIER_RATIO: f64 = 0.01;

/// Residual of one sample.
#[derive(Debug, Clone, Copy)]
pub struct Residual {
    /// The configuration that fits best.
    pub q: f64,
    /// In the parent's frame, metres.
    pub position: Vector3<f64>,
    /// Rotation vector, radians; `None` without orientation.
    pub orientation: Option<Vector3<f64>>,
}

/// The samples that a joint is fitted to.
pub struct Problem<'s> {
    pub samples: &'s [PoseSample],
    /// The positions of the samples.
    pub positions: Vec<Point3<f64>>,
    /// All samples have an orientation.
    pub has_orientation: bool,
}

impl<'s> Problem<'s> {
    pub fn new(samples: &'s [PoseSample]) -> Self {
        Self {
            samples,
            positions: samples.iter().map(|s| s.position).collect(),
            has_orientation: samples.iter().all(|s| s.orientation.is_some()),
        }
    }

    /// The residuals of all samples.
    pub fn residuals(&self, state: &State) -> Vec<Residual> {
        self.samples.iter().map(|s| self.residual(state, s)).collect()
    }

    /// The residual of one sample, at the configuration that fits it best.
    pub fn residual(&self, state: &State, sample: &PoseSample) -> Residual {
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

    /// Angle about the hinge from the position and, where known, the orientation, weighted by the
    /// inverse of their variances.
    fn revolute_configuration(&self, state: &State, sample: &PoseSample) -> f64 {
        let axis = state.geometry.axis.into_inner();
        let along_and_across = |p: &Point3<f64>| {
            let d = p - state.geometry.origin;
            let along = axis.dot(&d);
            (along, d - axis * along)
        };
        let (rest_along, rest) = along_and_across(&state.rest_position);
        let (now_along, now) = along_and_across(&sample.position);
        let by_position = axis.dot(&rest.cross(&now)).atan2(rest.dot(&now));
        let Some(orientation) = sample.orientation else { return by_position };
        let turn = (orientation * state.rest_orientation.inverse()).into_inner();
        let by_orientation = 2.0 * turn.imag().dot(&axis).atan2(turn.w);
        // A position that is off the circle is an outlier, and its angle tells nothing. (Far from the solution most
        // are, and the orientation alone gives the angle.)
        let off_circle = (now_along - rest_along).hypot(now.norm() - rest.norm());
        if off_circle > CONTRADICTION_SIGMAS * POSITION_SIGMA_M {
            return wrapped(by_orientation);
        }
        let difference = wrapped(by_orientation - by_position);
        let wp = (rest.norm() * now.norm()) / POSITION_SIGMA_M.powi(2);
        let wo = ORIENTATION_SIGMA_RAD.powi(-2);
        // Where the two contradict each other, the one with the larger weight is taken.
        let tolerance = CONTRADICTION_SIGMAS * (1.0 / wp.max(1e-9) + 1.0 / wo).sqrt();
        if difference.abs() > tolerance {
            return if wp > wo { by_position } else { wrapped(by_orientation) };
        }
        wrapped(by_position + difference * wo / (wp + wo))
    }

    /// Posterior probabilities that a sample is no outlier, separately for position and orientation: a
    /// marker whose orientation flips still has the right position.
    pub fn weights(&self, residuals: &[Residual], widen: f64) -> (Vec<f64>, Vec<f64>) {
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

    /// Log likelihood of the residuals.
    pub fn log_likelihood(&self, residuals: &[Residual]) -> f64 {
        self.log_likelihood_of(residuals, 1.0)
    }

    /// Log likelihood under `widen` times the noise.
    pub fn log_likelihood_of(&self, residuals: &[Residual], widen: f64) -> f64 {
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

    /// Whitened residuals of position and orientation; `wp` and `wo` are the weights of the two.
    pub fn stacked(&self, state: &State, wp: &[f64], wo: &[f64]) -> Vec<Vector6<f64>> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::UnitQuaternion;

    /// A part half a metre from a hinge, or on it.
    fn state(arm: f64) -> State {
        let geometry = JointGeometry::hinge(Vector3::z_axis(), Point3::new(0.2, 0.1, 0.0));
        State {
            geometry,
            rest_position: geometry.origin + Vector3::x() * arm,
            rest_orientation: UnitQuaternion::from_euler_angles(0.3, -0.2, 0.1),
        }
    }

    /// The part's pose, its place at one angle and its orientation at another.
    fn seen(state: &State, place: f64, turn: f64) -> PoseSample {
        PoseSample {
            t: 0.0,
            position: state.geometry.motion(place) * state.rest_position,
            orientation: Some(state.geometry.motion(turn).rotation * state.rest_orientation),
        }
    }

    fn angle_of(state: &State, sample: PoseSample) -> f64 {
        Problem::new(&[sample]).residual(state, &sample).q
    }

    #[test]
    fn a_pose_that_the_hinge_made_leaves_no_residual_at_its_angle() {
        let state = state(0.5);
        for q in [-3.1, -1.0, 0.0, 0.4, 3.1] {
            let sample = seen(&state, q, q);
            let residual = Problem::new(&[sample]).residual(&state, &sample);
            assert!((residual.q - q).abs() < 1e-9);
            assert!(residual.position.norm() < 1e-9);
            assert!(residual.orientation.unwrap().norm() < 1e-9);
        }
    }

    #[test]
    fn both_quaternions_of_an_orientation_give_one_angle() {
        let state = state(0.0);
        let sample = seen(&state, 0.0, 0.7);
        let other = sample.orientation.map(|o| UnitQuaternion::new_unchecked(-o.into_inner()));
        for orientation in [sample.orientation, other] {
            assert!((angle_of(&state, PoseSample { orientation, ..sample }) - 0.7).abs() < 1e-9);
        }
    }

    #[test]
    fn the_place_tells_the_angle_far_from_the_hinge_and_the_orientation_on_it() {
        // They contradict each other: a marker whose orientation has flipped.
        let far = state(0.5);
        assert!((angle_of(&far, seen(&far, 0.3, -1.2)) - 0.3).abs() < 1e-9);
        let on_it = state(0.0);
        assert!((angle_of(&on_it, seen(&on_it, 0.0, -1.2)) + 1.2).abs() < 1e-9);
        // Where they differ by little the angle lies between both.
        let between = angle_of(&far, seen(&far, 0.30, 0.31));
        assert!((0.30..0.31).contains(&between), "{between}");
    }

    #[test]
    fn a_slide_has_the_way_along_its_axis_and_the_rest_is_residual() {
        let geometry = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let slide = State { geometry, ..state(0.5) };
        let place = slide.rest_position + Vector3::new(0.3, 0.0, 0.02);
        let sample = PoseSample { t: 0.0, position: place, orientation: None };
        let residual = Problem::new(&[sample]).residual(&slide, &sample);
        assert!((residual.q - 0.3).abs() < 1e-12 && residual.orientation.is_none());
        assert!((residual.position - Vector3::new(0.0, 0.0, 0.02)).norm() < 1e-12);
    }

    #[test]
    fn a_flipped_marker_loses_its_orientation_and_keeps_its_place() {
        let state = state(0.5);
        let mut samples: Vec<PoseSample> =
            (0..20).map(|i| 0.05 * f64::from(i)).map(|q| seen(&state, q, q)).collect();
        samples[4] = seen(&state, 0.2, 0.2 + 2.5);
        samples[9].position += Vector3::new(0.0, 0.0, 0.3);
        let problem = Problem::new(&samples);
        let (places, turns) = problem.weights(&problem.residuals(&state), 1.0);
        assert!(places[4] > 0.9 && turns[4] < 0.1, "{} {}", places[4], turns[4]);
        assert!(places[9] < 0.1, "{}", places[9]);
        assert!((0..20).filter(|i| ![4, 9].contains(i)).all(|i| places[i] > 0.9 && turns[i] > 0.9));
    }

    #[test]
    fn without_orientations_none_has_less_weight_than_another() {
        let state = state(0.5);
        let samples: Vec<PoseSample> =
            (0..8).map(|_| PoseSample { orientation: None, ..seen(&state, 0.1, 0.1) }).collect();
        let problem = Problem::new(&samples);
        assert!(!problem.has_orientation);
        assert_eq!(problem.weights(&problem.residuals(&state), 1.0).1, [1.0; 8]);
    }

    #[test]
    fn the_farther_the_residuals_the_less_likely_and_never_beyond_what_is_finite() {
        let at = |distance: f64| -> f64 {
            let far = Residual { q: 0.0, position: Vector3::x() * distance, orientation: None };
            Problem::new(&[]).log_likelihood_of(&[far; 5], 1.0)
        };
        let likelihoods = [at(0.0), at(0.01), at(0.03), at(0.1), at(1e6)];
        assert!(likelihoods.is_sorted_by(|a, b| a >= b), "{likelihoods:?}");
        assert!(likelihoods[4].is_finite());
        assert_eq!(mixture(&[], 0.0), (Vec::new(), 0.0));
    }
}
