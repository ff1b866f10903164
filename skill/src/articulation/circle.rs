//! Lines and circles through weighted points in space.

use nalgebra::{Matrix2, Matrix3, Point3, UnitVector3, Vector2, Vector3};

/// Mean and principal directions of weighted points, widest first.
pub struct Principal {
    /// Weighted mean.
    pub mean: Point3<f64>,
    /// Unit directions.
    pub directions: [Vector3<f64>; 3],
}

/// Principal directions; `None` without weight.
pub fn principal(points: &[Point3<f64>], weights: &[f64]) -> Option<Principal> {
    let total: f64 = weights.iter().sum();
    if total <= 1e-9 {
        return None;
    }
    let weighted = || points.iter().zip(weights);
    let mean = weighted().map(|(p, w)| p.coords * *w).sum::<Vector3<f64>>() / total;
    let mut covariance = Matrix3::zeros();
    for (p, w) in weighted() {
        let d = p.coords - mean;
        covariance += *w / total * d * d.transpose();
    }
    let eigen = covariance.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    Some(Principal {
        mean: Point3::from(mean),
        directions: order.map(|i| eigen.eigenvectors.column(i).into_owned()),
    })
}

/// A circle in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Its centre.
    pub centre: Point3<f64>,
    /// Normal of its plane.
    pub normal: UnitVector3<f64>,
    /// Radius in metres.
    pub radius: f64,
}

/// Radius above which an arc is a line, metres.
const MAX_RADIUS_M: f64 = 1000.0;

/// The circle nearest to weighted points: plane by principal directions, then an algebraic
/// circle (Kasa) refined geometrically by Gauss-Newton. `None` for points on a line.
pub fn fit_circle(points: &[Point3<f64>], weights: &[f64]) -> Option<Circle> {
    let principal = principal(points, weights)?;
    let normal = principal.directions[2];
    let (u, v) = (principal.directions[0], principal.directions[1]);
    let flat: Vec<Vector2<f64>> = points
        .iter()
        .map(|p| {
            let d = p - principal.mean;
            Vector2::new(d.dot(&u), d.dot(&v))
        })
        .collect();
    let (centre, radius) = refine_flat(&flat, weights, algebraic(&flat, weights)?)?;
    Some(Circle {
        centre: principal.mean + u * centre.x + v * centre.y,
        normal: UnitVector3::new_normalize(normal),
        radius,
    })
}

/// Least squares of x² + y² = 2 a x + 2 b y + c about a zero mean.
fn algebraic(points: &[Vector2<f64>], weights: &[f64]) -> Option<(Vector2<f64>, f64)> {
    let total: f64 = weights.iter().sum();
    let mut second = Matrix2::zeros();
    let mut third = Vector2::zeros();
    let mut square = 0.0;
    for (p, w) in points.iter().zip(weights) {
        second += *w * p * p.transpose();
        third += *w * p * p.norm_squared();
        square += w * p.norm_squared();
    }
    let centre = second.try_inverse()? * third * 0.5;
    let radius = (centre.norm_squared() + square / total).sqrt();
    (radius.is_finite() && radius < MAX_RADIUS_M).then_some((centre, radius))
}

/// Gauss-Newton on the distances to the circle. The unknowns are taken where the arc passes
/// (its nearest point, direction and curvature stay well determined for flat arcs).
fn refine_flat(
    points: &[Vector2<f64>],
    weights: &[f64],
    start: (Vector2<f64>, f64),
) -> Option<(Vector2<f64>, f64)> {
    let (mut centre, mut radius) = start;
    for _ in 0..8 {
        let mut hessian = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        for (p, w) in points.iter().zip(weights) {
            let d = p - centre;
            let distance = d.norm().max(1e-9);
            let jacobian = Vector3::new(-d.x / distance, -d.y / distance, -1.0);
            hessian += *w * jacobian * jacobian.transpose();
            gradient += *w * jacobian * (distance - radius);
        }
        let step = hessian.try_inverse()? * gradient;
        centre -= step.xy();
        radius -= step.z;
        if !(radius.is_finite() && radius > 0.0 && radius < MAX_RADIUS_M) {
            return None;
        }
        if step.norm() < 1e-7 {
            break;
        }
    }
    Some((centre, radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::orthonormal_basis;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_exact_arc_gives_its_circle(
            radius in 0.1..2.0_f64,
            arc in 0.3..3.0_f64,
            direction in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            prop_assume!(Vector3::from(direction).norm() > 0.1);
            let normal = UnitVector3::new_normalize(Vector3::from(direction));
            let (u, v) = orthonormal_basis(&normal);
            let centre = Point3::new(0.3, -0.2, 1.5);
            let points: Vec<_> = (0..50)
                .map(|i| {
                    let a = arc * f64::from(i) / 49.0;
                    centre + radius * (u * a.cos() + v * a.sin())
                })
                .collect();
            let circle = fit_circle(&points, &[1.0; 50]).unwrap();
            prop_assert!((circle.radius - radius).abs() < 1e-5);
            prop_assert!((circle.centre - centre).norm() < 1e-5);
            prop_assert!(circle.normal.dot(&normal).abs() > 1.0 - 1e-9);
        }
    }
}
