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
