//! Rigid motions: closed-form fits, RANSAC, screws.
//!
//! Names follow `to_from`: `b_from_a * point_in_a` lies in frame b.

use nalgebra::{
    Isometry3, IsometryMatrix3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion,
    UnitVector3, Vector3,
};
use rand::Rng;
use std::f64::consts::{PI, TAU};

/// A rigid motion or pose.
pub type Pose = Isometry3<f64>;

/// The same pose, which moves many points sooner.
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

/// A pair of corresponding points with the standard deviation (metres) expected of their
/// distance, and a weight for sampling and scoring.
#[derive(Debug, Clone, Copy)]
pub struct Correspondence {
    /// Before the motion.
    pub from: Point3<f64>,
    /// After it.
    pub to: Point3<f64>,
    /// Expected standard deviation of the residual, metres.
    pub sigma: f64,
    /// Weight, above zero.
    pub weight: f64,
}

/// How [`ransac_rigid`] searches.
#[derive(Debug, Clone, Copy)]
pub struct RansacOptions {
    /// Residual, in multiples of sigma, at which a pair stops counting.
    pub cut: f64,
    /// Samples drawn.
    pub iterations: usize,
    /// Second and third point are drawn within this distance of the first, in metres.
    pub locality: Option<f64>,
}

/// A rigid motion and the pairs that follow it.
#[derive(Debug, Clone)]
pub struct RigidMotion {
    /// `to_from_from`: takes `from` to `to`.
    pub motion: Pose,
    /// Indices of the pairs within the cut.
    pub inliers: Vec<usize>,
}

/// The rigid motion that most pairs follow: MSAC over three-point samples, then reweighted
/// closed-form fits over the inliers. `guess` is scored first.
pub fn ransac_rigid(
    pairs: &[Correspondence],
    options: &RansacOptions,
    guess: Option<&Pose>,
    rng: &mut impl Rng,
) -> Option<RigidMotion> {
    if pairs.len() < 3 {
        return None;
    }
    let mut best = (0.0, None);
    let mut consider = |motion: Pose| {
        let score = msac_score(pairs, &motion, options.cut);
        if score > best.0 {
            best = (score, Some(motion));
        }
    };
    if let Some(guess) = guess {
        consider(*guess);
    }
    let cumulative: Vec<f64> = pairs
        .iter()
        .scan(0.0, |sum, p| {
            *sum += p.weight;
            Some(*sum)
        })
        .collect();
    for _ in 0..options.iterations {
        if let Some(motion) =
            draw_triple(pairs, &cumulative, options, rng).and_then(|t| fit_triple(pairs, t))
        {
            consider(motion);
        }
    }
    let mut motion = best.1?;
    for _ in 0..3 {
        motion = reweighted_fit(pairs, &motion, options.cut).unwrap_or(motion);
    }
    let inliers: Vec<usize> = (0..pairs.len())
        .filter(|&i| residual_ratio_sq(&pairs[i], &motion, options.cut) < 1.0)
        .collect();
    (inliers.len() >= 3).then_some(RigidMotion { motion, inliers })
}

fn residual_ratio_sq(pair: &Correspondence, motion: &Pose, cut: f64) -> f64 {
    (motion * pair.from - pair.to).norm_squared() / (cut * pair.sigma).powi(2)
}

fn msac_score(pairs: &[Correspondence], motion: &Pose, cut: f64) -> f64 {
    pairs.iter().map(|p| p.weight * (1.0 - residual_ratio_sq(p, motion, cut)).max(0.0)).sum()
}

fn reweighted_fit(pairs: &[Correspondence], motion: &Pose, cut: f64) -> Option<Pose> {
    let (mut from, mut to, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    for pair in pairs {
        let closeness = 1.0 - residual_ratio_sq(pair, motion, cut);
        if closeness > 0.0 {
            from.push(pair.from);
            to.push(pair.to);
            weights.push(pair.weight * (closeness / pair.sigma).powi(2));
        }
    }
    rigid_fit(&from, &to, &weights)
}

fn draw_triple(
    pairs: &[Correspondence],
    cumulative: &[f64],
    options: &RansacOptions,
    rng: &mut impl Rng,
) -> Option<[usize; 3]> {
    let total = *cumulative.last()?;
    let mut draw = || {
        let x = rng.random::<f64>() * total;
        cumulative.partition_point(|&c| c < x).min(pairs.len() - 1)
    };
    let first = draw();
    let mut triple = [first; 3];
    let mut filled = 1;
    for _ in 0..60 {
        let next = draw();
        let near =
            options.locality.is_none_or(|r| (pairs[next].from - pairs[first].from).norm() <= r);
        if near && !triple[..filled].contains(&next) {
            triple[filled] = next;
            filled += 1;
            if filled == 3 {
                let consistent = [(0, 1), (1, 2), (2, 0)].iter().all(|&(i, j)| {
                    let (p, q) = (&pairs[triple[i]], &pairs[triple[j]]);
                    let stretch = (p.from - q.from).norm() - (p.to - q.to).norm();
                    stretch.abs() <= options.cut * p.sigma.max(q.sigma)
                });
                return consistent.then_some(triple);
            }
        }
    }
    None
}

fn fit_triple(pairs: &[Correspondence], triple: [usize; 3]) -> Option<Pose> {
    rigid_fit(&triple.map(|i| pairs[i].from), &triple.map(|i| pairs[i].to), &[1.0; 3])
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

/// The middle value; `None` of nothing. NaN must not be among the values.
pub fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Points that more than so many others lie within `radius` of, themselves counted.
pub fn without_strays(points: &[Point3<f64>], radius: f64, neighbours: usize) -> Vec<Point3<f64>> {
    let near = |p: &Point3<f64>| points.iter().filter(|o| (*o - p).norm() < radius).count();
    points.iter().copied().filter(|p| near(p) > neighbours).collect()
}

/// Component-wise median of points.
pub fn median_point(points: &[Point3<f64>]) -> Option<Point3<f64>> {
    let of = |k: usize| median(&mut points.iter().map(|p| p[k]).collect::<Vec<_>>());
    Some(Point3::new(of(0)?, of(1)?, of(2)?))
}

/// Diagonal of the box that holds some places, metres; 0 without any.
pub fn extent(mut places: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let Some(first) = places.next() else { return 0.0 };
    let (low, high) = places.fold((first, first), |(l, h), p| (l.inf(&p), h.sup(&p)));
    (high - low).norm()
}

/// Variances of two quantities and their covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// Variance of the first.
    pub xx: f64,
    /// Variance of the second.
    pub yy: f64,
    /// Covariance.
    pub xy: f64,
}

impl Moments {
    /// Of pairs of samples.
    pub fn of(pairs: &[(f64, f64)]) -> Self {
        let n = pairs.len().max(1) as f64;
        let mean = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / n;
        let (mx, my) = (mean(&|p| p.0), mean(&|p| p.1));
        Self {
            xx: mean(&|p| (p.0 - mx).powi(2)),
            yy: mean(&|p| (p.1 - my).powi(2)),
            xy: mean(&|p| (p.0 - mx) * (p.1 - my)),
        }
    }

    /// Squared correlation, 0 to 1; `None` where one of the two does not vary.
    pub fn correlation_sq(&self) -> Option<f64> {
        (self.xx > 0.0 && self.yy > 0.0).then(|| self.xy * self.xy / (self.xx * self.yy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;

    fn any_pose() -> impl Strategy<Value = Pose> {
        (prop::array::uniform3(-2.0..2.0_f64), prop::array::uniform3(-1.5..1.5_f64))
            .prop_map(|(t, r)| Pose::new(Vector3::from(t), Vector3::from(r)))
    }

    fn cloud() -> Vec<Point3<f64>> {
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
        fn ransac_survives_a_third_of_outliers(pose in any_pose(), seed in 0_u64..50) {
            let pairs: Vec<_> = cloud().iter().enumerate().map(|(i, p)| Correspondence {
                from: *p,
                to: if i % 3 == 0 { Point3::new(i as f64, -1.0, 0.3) } else { pose * p },
                sigma: 0.005,
                weight: 1.0,
            }).collect();
            let options = RansacOptions { cut: 2.0, iterations: 200, locality: None };
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let found = ransac_rigid(&pairs, &options, None, &mut rng).unwrap();
            prop_assert!((found.motion.translation.vector - pose.translation.vector).norm() < 1e-6);
            prop_assert!(found.inliers.len() >= 13);
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

    #[test]
    fn a_linear_function_is_wholly_correlated_and_a_constant_not_at_all() {
        let line: Vec<(f64, f64)> =
            (0..9).map(|i| (f64::from(i), 3.0 - 2.0 * f64::from(i))).collect();
        assert!((Moments::of(&line).correlation_sq().unwrap() - 1.0).abs() < 1e-12);
        let constant: Vec<(f64, f64)> = line.iter().map(|p| (p.0, 1.0)).collect();
        assert_eq!(Moments::of(&constant).correlation_sq(), None);
    }
}
