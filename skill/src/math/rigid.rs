//! Rigid motions: closed-form fits, RANSAC, screws.
//!
//! Names follow `to_from`: `b_from_a * point_in_a` lies in frame b.

use nalgebra::{
    Isometry3, IsometryMatrix3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion,
    UnitVector3, Vector3,
};
use std::f64::consts::{PI, TAU};

/// A rigid motion or pose.
pub type Pose = Isometry3<f64>;

/// The same pose as a matrix, which transforms many points faster.
pub fn matrix_pose(pose: &Pose) -> IsometryMatrix3<f64> {
    IsometryMatrix3::from_parts(pose.translation, pose.rotation.to_rotation_matrix())
}

/// `[x, y, z, qx, qy, qz, qw]`, as poses are written in files and messages.
pub fn pose_to_array(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
}

/// The inverse of [`pose_to_array`]; `None` unless all is finite and the quaternion has a
/// direction.
pub fn pose_from_array(a: &[f64; 7]) -> Option<Pose> {
    let q = nalgebra::Quaternion::new(a[6], a[3], a[4], a[5]);
    if !(a.iter().all(|x| x.is_finite()) && q.norm() > 1e-9) {
        return None;
    }
    Some(Pose::from_parts(Translation3::new(a[0], a[1], a[2]), UnitQuaternion::from_quaternion(q)))
}

/// Rotation by `angle` radians about the line through `origin` along `axis`.
pub fn rotation_about(origin: &Point3<f64>, axis: &UnitVector3<f64>, angle: f64) -> Pose {
    let rotation = UnitQuaternion::from_axis_angle(axis, angle);
    let shift = origin.coords - rotation * origin.coords;
    Pose::from_parts(Translation3::from(shift), rotation)
}

/// Two unit vectors that complete `axis` to an orthonormal frame.
pub fn orthonormal_basis(axis: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let least = axis.iamin();
    let mut helper = Vector3::zeros();
    helper[least] = 1.0;
    let u = axis.cross(&helper).normalize();
    (u, axis.cross(&u))
}

/// The point of the line (`origin`, unit `axis`) nearest to `point`.
pub fn nearest_on_line(
    origin: &Point3<f64>,
    axis: &Vector3<f64>,
    point: &Point3<f64>,
) -> Point3<f64> {
    origin + axis * axis.dot(&(point - origin))
}

/// Distance between `point` and the line (`origin`, unit `axis`).
pub fn distance_to_line(origin: &Point3<f64>, axis: &Vector3<f64>, point: &Point3<f64>) -> f64 {
    (point - nearest_on_line(origin, axis, point)).norm()
}

/// Angle in radians between two lines' directions, 0 to π/2.
pub fn line_angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b).abs())
}

/// An angle without whole turns: from -π up to π, radians.
pub fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

/// The rigid motion that takes `a` to `b` with least weighted squares (Kabsch 1976,
/// Umeyama 1991). `None` for fewer than three points or no weight; points on one line
/// leave the turn about it undetermined, which this does not detect.
pub fn rigid_fit(a: &[Point3<f64>], b: &[Point3<f64>], weights: &[f64]) -> Option<Pose> {
    let total: f64 = weights.iter().sum();
    if a.len() < 3 || total <= 0.0 {
        return None;
    }
    let mean = |points: &[Point3<f64>]| {
        points.iter().zip(weights).map(|(p, w)| p.coords * *w).sum::<Vector3<f64>>() / total
    };
    let (mean_a, mean_b) = (mean(a), mean(b));
    let mut cross = Matrix3::zeros();
    for ((pa, pb), w) in a.iter().zip(b).zip(weights) {
        cross += *w * (pb.coords - mean_b) * (pa.coords - mean_a).transpose();
    }
    rotation_nearest(&cross)
        .map(|rotation| Pose::from_parts(Translation3::from(mean_b - rotation * mean_a), rotation))
}

/// The rotation nearest to a matrix (Frobenius norm).
pub fn rotation_nearest(matrix: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = matrix.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut fix = Matrix3::identity();
    fix[(2, 2)] = (u * v_t).determinant().signum();
    let rotation = u * fix * v_t;
    rotation
        .iter()
        .all(|x| x.is_finite())
        .then(|| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

/// The line that a rigid motion turns about.
#[derive(Debug, Clone, Copy)]
pub struct Screw {
    /// Angle in radians, above zero.
    pub angle: f64,
    /// Direction, right-handed with the angle.
    pub axis: UnitVector3<f64>,
    /// A point on the line.
    pub origin: Point3<f64>,
}

/// Screw of a motion (Chasles); `None` when it does not turn.
pub fn screw_of(motion: &Pose) -> Option<Screw> {
    let (axis, angle) = motion.rotation.axis_angle()?;
    if angle < 1e-6 {
        return None;
    }
    let t = motion.translation.vector;
    let across = t - axis.into_inner() * axis.dot(&t);
    let origin = 0.5 * (across + axis.cross(&across) / (0.5 * angle).tan());
    Some(Screw { angle, axis, origin: Point3::from(origin) })
}

/// The plane through points by least squares: their mean, and the unit normal in either sense.
pub fn plane_through(points: &[Point3<f64>]) -> (Point3<f64>, Vector3<f64>) {
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let spread: Matrix3<f64> =
        points.iter().map(|p| p.coords - mean).map(|d| d * d.transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    (Point3::from(mean), normal)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub fn any_pose() -> impl Strategy<Value = Pose> {
        (prop::array::uniform3(-2.0..2.0_f64), prop::array::uniform3(-1.5..1.5_f64))
            .prop_map(|(t, r)| Pose::new(Vector3::from(t), Vector3::from(r)))
    }

    pub fn cloud() -> Vec<Point3<f64>> {
        (0..20)
            .map(|i| {
                let s = f64::from(i);
                Point3::new((s * 1.7).sin(), (s * 0.9).cos(), (s * 0.37).sin() + 1.0)
            })
            .collect()
    }

    proptest! {
        #[test]
        fn a_rigid_fit_returns_the_motion_that_made_the_points(pose in any_pose()) {
            let a = cloud();
            let b: Vec<_> = a.iter().map(|p| pose * p).collect();
            let fitted = rigid_fit(&a, &b, &vec![1.0; a.len()]).unwrap();
            prop_assert!((fitted.translation.vector - pose.translation.vector).norm() < 1e-9);
            prop_assert!(fitted.rotation.angle_to(&pose.rotation) < 1e-7);
        }

        #[test]
        fn the_screw_of_a_rotation_about_a_line_is_that_line(
            origin in prop::array::uniform3(-1.0..1.0_f64),
            direction in prop::array::uniform3(-1.0..1.0_f64),
            angle in 0.05..3.0_f64,
        ) {
            prop_assume!(Vector3::from(direction).norm() > 0.1);
            let axis = UnitVector3::new_normalize(Vector3::from(direction));
            let origin = Point3::from(Vector3::from(origin));
            let screw = screw_of(&rotation_about(&origin, &axis, angle)).unwrap();
            prop_assert!((screw.angle - angle).abs() < 1e-9);
            prop_assert!(distance_to_line(&screw.origin, &screw.axis, &origin) < 1e-7);
            prop_assert!(screw.axis.dot(&axis) > 0.999_999);
        }

        #[test]
        fn a_pose_survives_its_array(pose in any_pose()) {
            let back = pose_from_array(&pose_to_array(&pose)).unwrap();
            prop_assert!((back.inverse() * pose).translation.vector.norm() < 1e-12);
        }
    }
}
