//! Estimates the direction of a hinge from a turning plane: it is perpendicular to all normals of
//! the plane, wherever the line lies.
//!
//! In: unit normals of a part's plane in several keyframes (base frame), and a joint from tracks.
//! Out: the joint with a corrected line and covariance.
//! From: the eigenvector of the normals' scatter matrix with the smallest eigenvalue; Kalman
//! update.

use super::hinge::SYSTEMATIC_RAD;
use crate::learn::learned_joint::LearnedJoint;
use crate::math::rigid::orthonormal_basis;
use crate::object::model::covariance_rows;
use nalgebra::{Matrix2x3, Matrix2x6, Matrix3, SymmetricEigen, Vector3, Vector6};

/// Fewest planes that determine a direction.
const MIN_PLANES: usize = 6;
/// Smallest ratio of the variance of the tracks' direction to that of the planes' direction at
/// which the planes correct it.
const SURER: f64 = 4.0;
/// Largest difference between the directions of planes and tracks, standard deviations; a larger
/// one is a contradiction.
const MAX_SIGMAS: f64 = 4.0;

/// Direction of an axis with its uncertainty.
pub struct Direction {
    /// Unit vector, base frame.
    axis: Vector3<f64>,
    /// Covariance of the unit vector, radians squared.
    covariance: Matrix3<f64>,
}

impl Direction {
    /// The direction perpendicular to a plane's unit normals; `None` for too few.
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

    /// Corrects the direction of a joint's line, if the planes determine it much better than the
    /// tracks and do not contradict them. The line's place follows through its covariance with the
    /// direction: a Kalman update that measures the direction. Returns true if the line was
    /// corrected.
    pub fn correct(&self, learned: &mut LearnedJoint) -> bool {
        let joint = &mut learned.joint;
        let tracked = Vector3::from(joint.axis);
        let axis = if self.axis.dot(&tracked) < 0.0 { -self.axis } else { self.axis };
        let Some(covariance) = joint.known_covariance() else { return false };
        let (u, v) = orthonormal_basis(&axis);
        let across = Matrix2x3::from_rows(&[u.transpose(), v.transpose()]);
        let mut measures = Matrix2x6::zeros();
        measures.fixed_view_mut::<2, 3>(0, 0).copy_from(&across);
        let of_tracks = measures * covariance * measures.transpose();
        let of_planes = across * self.covariance * across.transpose();
        let apart = across * (axis - tracked);
        let Some(information) = (of_tracks + of_planes).try_inverse() else { return false };
        let contradicts = apart.dot(&(information * apart)) > MAX_SIGMAS * MAX_SIGMAS;
        if of_tracks.trace() < SURER * of_planes.trace() || contradicts {
            return false;
        }
        let gain = covariance * measures.transpose() * information;
        let step: Vector6<f64> = gain * apart;
        joint.axis = (tracked + step.fixed_rows::<3>(0)).normalize().into();
        joint.origin = (Vector3::from(joint.origin) + step.fixed_rows::<3>(3)).into();
        joint.covariance = covariance_rows(&(covariance - gain * measures * covariance));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::line_angle;
    use crate::object::joint_geometry::JointGeometry;
    use crate::object::model::Joint;
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

    /// A door whose tracks give a direction that is off by 0.06 rad, with a standard deviation.
    fn tracked(sigma: f64) -> LearnedJoint {
        let axis = UnitVector3::new_normalize(Vector3::new(0.06, 1.0, 0.0));
        let covariance = Matrix6::identity() * sigma * sigma;
        let joint = Joint {
            covariance: covariance_rows(&covariance),
            ..Joint::of(&JointGeometry::hinge(axis, Point3::origin()))
        };
        LearnedJoint {
            joint,
            base_from_part: Vec::new(),
            tracks: Vec::new(),
            plain_surface: Vec::new(),
        }
    }

    fn off(learned: &LearnedJoint) -> f64 {
        line_angle(&learned.joint.axis.into(), &Vector3::y())
    }

    #[test]
    fn planes_correct_a_direction_of_few_tracks() {
        let mut learned = tracked(0.05);
        assert!(Direction::across(&normals(0.8)).unwrap().correct(&mut learned));
        assert!(off(&learned) < 0.005, "{}", off(&learned));
        assert!(learned.joint.covariance[0][0] < 1e-4);
    }

    #[test]
    fn the_place_follows_where_its_error_goes_with_that_of_the_direction() {
        let mut learned = tracked(0.05);
        for k in 0..3 {
            learned.joint.covariance[k][k + 3] = 0.5 * 0.05 * 0.05;
            learned.joint.covariance[k + 3][k] = 0.5 * 0.05 * 0.05;
        }
        assert!(Direction::across(&normals(0.8)).unwrap().correct(&mut learned));
        assert!((learned.joint.origin[0] + 0.5 * 0.06).abs() < 0.003, "{:?}", learned.joint.origin);
    }

    #[test]
    fn tracks_that_are_sure_are_not_corrected() {
        for sigma in [0.002, 0.01] {
            let mut learned = tracked(sigma);
            assert!(!Direction::across(&normals(0.8)).unwrap().correct(&mut learned));
            assert!(off(&learned) > 0.05);
        }
    }

    #[test]
    fn a_plane_that_hardly_turns_tells_no_direction() {
        let mut learned = tracked(0.05);
        assert!(!Direction::across(&normals(0.02)).unwrap().correct(&mut learned));
    }
}
