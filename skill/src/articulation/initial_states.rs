//! States from which the fit of a joint starts.

use super::circle::{fit_circle, principal};
use super::residuals::Problem;
use super::rest_state::State;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::{Matrix3, Point3, UnitQuaternion, UnitVector3, Vector3};

impl Problem<'_> {
    /// Initial states from all samples.
    pub fn starts(&self, kind: JointKind) -> Vec<State> {
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

    /// The orientation with the least sum of angles to the others, of a subset of them.
    fn median_orientation(&self) -> UnitQuaternion<f64> {
        let step = (self.samples.len() / 40).max(1);
        let some: Vec<UnitQuaternion<f64>> =
            self.samples.iter().step_by(step).filter_map(|s| s.orientation).collect();
        let cost = |q: &UnitQuaternion<f64>| some.iter().map(|o| o.angle_to(q)).sum::<f64>();
        some.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::pose_sample::PoseSample;
    use super::*;
    use crate::math::rigid::{distance_to_line, line_angle};

    fn hinge() -> JointGeometry {
        JointGeometry::hinge(Vector3::z_axis(), Point3::new(0.2, 0.1, 0.0))
    }

    /// Poses of a part of the hinge, this far from it.
    fn samples(arm: f64, has_orientation: bool) -> Vec<PoseSample> {
        let rest = hinge().origin + Vector3::x() * arm;
        let sample = |i| {
            let motion = hinge().motion(0.05 * f64::from(i));
            let orientation = has_orientation.then_some(motion.rotation);
            PoseSample { t: f64::from(i), position: motion * rest, orientation }
        };
        (0..30).map(sample).collect()
    }

    fn starts(samples: &[PoseSample], kind: JointKind) -> Vec<State> {
        Problem::new(samples).starts(kind)
    }

    /// The state is about the true hinge.
    fn is_true(state: &State) -> bool {
        let (line, found) = (hinge(), &state.geometry);
        line_angle(&line.axis, &found.axis) < 1e-4
            && distance_to_line(&line.origin, &line.axis, &found.origin) < 1e-4
    }

    #[test]
    fn places_on_an_arc_start_a_hinge_at_its_centre() {
        let found = starts(&samples(0.5, false), JointKind::Revolute);
        assert_eq!(found.len(), 1, "no orientation tells another");
        assert!(is_true(&found[0]));
        let with_both = starts(&samples(0.5, true), JointKind::Revolute);
        assert_eq!(with_both.len(), 2);
        assert!(with_both.iter().all(is_true));
    }

    #[test]
    fn a_marker_on_the_hinge_starts_it_by_its_orientations() {
        let found = starts(&samples(0.0, true), JointKind::Revolute);
        assert_eq!(found.len(), 1, "places that do not move are on no arc");
        assert!(is_true(&found[0]));
    }

    #[test]
    fn what_does_not_turn_starts_no_hinge_by_its_orientations() {
        let still: Vec<PoseSample> =
            samples(0.5, true).iter().map(|_| samples(0.5, true)[0]).collect();
        assert!(starts(&still, JointKind::Revolute).is_empty());
    }

    #[test]
    fn a_slide_starts_along_the_places_about_their_mean() {
        let sample = |i| PoseSample {
            t: f64::from(i),
            position: Point3::new(0.0, 0.02 * f64::from(i), 1.0),
            orientation: None,
        };
        let found = starts(&(0..11).map(sample).collect::<Vec<_>>(), JointKind::Prismatic);
        assert_eq!(found.len(), 1);
        assert!(found[0].geometry.axis.y.abs() > 1.0 - 1e-9);
        assert!((found[0].rest_position - Point3::new(0.0, 0.1, 1.0)).norm() < 1e-12);
    }

    #[test]
    fn types_that_are_not_fitted_and_logs_without_samples_have_no_start() {
        for kind in [JointKind::Helical, JointKind::Nonparametric] {
            assert!(starts(&samples(0.5, true), kind).is_empty());
        }
        assert!(starts(&[], JointKind::Prismatic).is_empty());
    }

    #[test]
    fn flipped_markers_do_not_draw_the_orientation_at_rest() {
        let mut seen = samples(0.5, true);
        let (straight, flipped) =
            (UnitQuaternion::identity(), UnitQuaternion::from_euler_angles(3.0, 0.0, 0.0));
        for (i, sample) in seen.iter_mut().enumerate() {
            sample.orientation = Some(if i % 3 == 0 { flipped } else { straight });
        }
        assert_eq!(Problem::new(&seen).median_orientation(), straight);
    }
}
