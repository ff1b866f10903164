//! A small change of a line, with four unknowns: two turn its direction, radians, and two shift its
//! origin across the line, metres, both along the basis of [`orthonormal_basis`].

use crate::math::rigid::orthonormal_basis;
use crate::object::joint_geometry::JointGeometry;
use nalgebra::{Matrix4, Matrix6, SMatrix, UnitVector3, Vector4};

/// The line with its direction turned and its origin shifted across it by `step`.
pub fn moved_line(line: &JointGeometry, step: &Vector4<f64>) -> JointGeometry {
    let (u, v) = orthonormal_basis(&line.axis);
    let axis = line.axis.into_inner() + u * step[0] + v * step[1];
    let origin = line.origin + u * step[2] + v * step[3];
    JointGeometry { axis: UnitVector3::new_normalize(axis), origin, ..*line }
}

/// Covariance of (axis, origin) from the information matrix of the line's four unknowns; zero if
/// that matrix is singular.
pub fn line_covariance(line: &JointGeometry, information: &Matrix4<f64>) -> Matrix6<f64> {
    let (u, v) = orthonormal_basis(&line.axis);
    let mut spread = SMatrix::<f64, 6, 4>::zeros();
    for (k, side) in [u, v].iter().enumerate() {
        spread.fixed_view_mut::<3, 1>(0, k).copy_from(side);
        spread.fixed_view_mut::<3, 1>(3, k + 2).copy_from(side);
    }
    let of_line = information.try_inverse().unwrap_or_else(Matrix4::zeros);
    spread * of_line * spread.transpose()
}

/// Covariance of a line's (axis, origin) with added errors that all readings share: standard
/// deviations of `direction` radians and `place` metres, to all sides across the line.
pub fn with_shared_errors(
    mut covariance: Matrix6<f64>,
    line: &JointGeometry,
    direction: f64,
    place: f64,
) -> Matrix6<f64> {
    let (u, v) = orthonormal_basis(&line.axis);
    let across = u * u.transpose() + v * v.transpose();
    for (block, sigma) in [(0, direction), (3, place)] {
        let mut own = covariance.fixed_view_mut::<3, 3>(block, block);
        own += sigma.powi(2) * across;
    }
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::line_angle;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn a_step_turns_the_direction_and_shifts_the_origin_across_it() {
        let line = JointGeometry::hinge(Vector3::z_axis(), Point3::origin());
        let moved = moved_line(&line, &Vector4::new(0.01, 0.0, 0.0, 0.2));
        assert!((line_angle(&line.axis, &moved.axis) - 0.01).abs() < 1e-6);
        assert!((moved.origin.coords.norm() - 0.2).abs() < 1e-12);
        assert!(moved.origin.z.abs() < 1e-12, "across the line");
    }

    #[test]
    fn nothing_is_uncertain_along_the_line() {
        let line = JointGeometry::hinge(Vector3::z_axis(), Point3::origin());
        let covariance = line_covariance(&line, &Matrix4::from_diagonal_element(4.0));
        let expected = [0.25, 0.25, 0.0, 0.25, 0.25, 0.0];
        for (k, variance) in expected.into_iter().enumerate() {
            assert!((covariance[(k, k)] - variance).abs() < 1e-12);
        }
    }

    #[test]
    fn shared_errors_widen_a_line_across_itself_only() {
        let line = JointGeometry::hinge(Vector3::z_axis(), Point3::origin());
        let wide = with_shared_errors(Matrix6::zeros(), &line, 0.1, 0.2);
        let expected = [0.01, 0.01, 0.0, 0.04, 0.04, 0.0];
        for (k, variance) in expected.into_iter().enumerate() {
            assert!((wide[(k, k)] - variance).abs() < 1e-12);
        }
    }
}
