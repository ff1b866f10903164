//! The direction that a turning plane keeps to: across all its normals, wherever it lies.

use crate::geometry::orthonormal_basis;
use crate::structure::LearnedJoint;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// What planes do not tell, however many there are, radians.
const SYSTEMATIC_RAD: f64 = 0.0025;
/// Fewest planes.
const MIN_PLANES: usize = 6;
/// Tracks' direction gives way to one whose variance is so much smaller.
const SURER: f64 = 4.0;
/// Both must agree within so many standard deviations.
const MAX_SIGMAS: f64 = 3.0;

/// A direction with what is not known of it.
pub struct Direction {
    /// Unit vector.
    axis: Vector3<f64>,
    /// Of the axis, radians squared.
    covariance: Matrix3<f64>,
}

impl Direction {
    /// From a plane's unit normals; `None` for too few.
    pub fn across(normals: &[Vector3<f64>]) -> Option<Self> {
        if normals.len() < MIN_PLANES {
            return None;
        }
        let scatter: Matrix3<f64> = normals.iter().map(|n| n * n.transpose()).sum();
        let eigen = SymmetricEigen::new(scatter);
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        let tilt: f64 = normals.iter().map(|n| n.dot(&axis).powi(2)).sum();
        let noise = tilt / (normals.len() - 2) as f64;
        let (u, v) = orthonormal_basis(&axis);
        let across = |side: Vector3<f64>| {
            let seen = side.dot(&(scatter * side)).max(1e-6);
            (noise / seen + SYSTEMATIC_RAD * SYSTEMATIC_RAD) * side * side.transpose()
        };
        Some(Self { axis, covariance: across(u) + across(v) })
    }

    /// Turns a joint's axis about its origin, where the planes are much surer of its direction
    /// than the tracks that told it, and do not contradict them.
    pub fn correct(&self, learned: &mut LearnedJoint) -> bool {
        let joint = &mut learned.joint;
        let told = Vector3::from(joint.axis);
        let axis = if self.axis.dot(&told) < 0.0 { -self.axis } else { self.axis };
        let of_tracks = Matrix3::from_fn(|r, c| joint.covariance[r][c]);
        let apart = told - axis;
        let expected = of_tracks + self.covariance;
        let (u, v) = orthonormal_basis(&axis);
        let agrees = [u, v].iter().all(|side| {
            apart.dot(side).powi(2) < MAX_SIGMAS * MAX_SIGMAS * side.dot(&(expected * side))
        });
        if of_tracks.trace() < SURER * self.covariance.trace() || !agrees {
            return false;
        }
        joint.axis = axis.into();
        for r in 0..3 {
            for c in 0..3 {
                joint.covariance[r][c] = self.covariance[(r, c)];
                joint.covariance[r][c + 3] = 0.0;
                joint.covariance[r + 3][c] = 0.0;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::articulate::JointGeometry;
    use crate::geometry::line_angle;
    use crate::model::{Joint, covariance_rows};
    use nalgebra::{Matrix6, Point3, UnitVector3};

    /// Normals of a door that turns by this much, each off by about a hundredth of a radian.
    fn normals(turn: f64) -> Vec<Vector3<f64>> {
        (0..20)
            .map(|k| {
                let q = turn * f64::from(k) / 19.0;
                let off = 0.01 * (f64::from(k) * 2.4).sin();
                Vector3::new(q.sin(), off, -q.cos()).normalize()
            })
            .collect()
    }

    /// A door whose tracks tell a direction off by 0.06 rad, and claim so many.
    fn told(sigma: f64) -> LearnedJoint {
        let axis = UnitVector3::new_normalize(Vector3::new(0.06, 1.0, 0.0));
        let covariance = Matrix6::identity() * sigma * sigma;
        let joint = Joint {
            covariance: covariance_rows(&covariance),
            ..Joint::of(&JointGeometry::hinge(axis, Point3::origin()))
        };
        LearnedJoint { joint, base_from_part: Vec::new(), tracks: Vec::new() }
    }

    fn off(learned: &LearnedJoint) -> f64 {
        line_angle(&learned.joint.axis.into(), &Vector3::y())
    }

    #[test]
    fn planes_correct_a_direction_that_few_tracks_told() {
        let mut learned = told(0.05);
        assert!(Direction::across(&normals(0.8)).unwrap().correct(&mut learned));
        assert!(off(&learned) < 0.005, "{}", off(&learned));
        assert!(learned.joint.covariance[0][0] < 1e-4);
    }

    #[test]
    fn tracks_that_are_sure_are_not_corrected() {
        for sigma in [0.002, 0.01] {
            let mut learned = told(sigma);
            assert!(!Direction::across(&normals(0.8)).unwrap().correct(&mut learned));
            assert!(off(&learned) > 0.05);
        }
    }

    #[test]
    fn a_plane_that_hardly_turns_tells_no_direction() {
        let mut learned = told(0.05);
        assert!(!Direction::across(&normals(0.02)).unwrap().correct(&mut learned));
    }
}
