//! Robust statistics, and other statistics of lists of points.

use nalgebra::Point3;

/// The middle value; `None` of nothing. NaN must not be among the values.
pub fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Points that have more than `neighbours` points within `radius`, themselves counted (radius
/// outlier removal).
pub fn without_isolated(
    points: &[Point3<f64>],
    radius: f64,
    neighbours: usize,
) -> Vec<Point3<f64>> {
    let near = |p: &Point3<f64>| points.iter().filter(|o| (*o - p).norm() < radius).count();
    points.iter().copied().filter(|p| near(p) > neighbours).collect()
}

/// Component-wise median of points.
pub fn median_point(points: &[Point3<f64>]) -> Option<Point3<f64>> {
    let of = |k: usize| median(&mut points.iter().map(|p| p[k]).collect::<Vec<_>>());
    Some(Point3::new(of(0)?, of(1)?, of(2)?))
}

/// Diagonal of the box that holds some places, metres; 0 without any.
#[cfg(any(test, feature = "paper"))]
pub fn extent(mut places: impl Iterator<Item = nalgebra::Vector3<f64>>) -> f64 {
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
    /// The moments of pairs of samples.
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

/// Share of `a` that is in `b`.
pub fn overlap(a: &[usize], b: &[usize]) -> f64 {
    if a.is_empty() {
        return 0.0;
    }
    let set: std::collections::HashSet<&usize> = b.iter().collect();
    a.iter().filter(|t| set.contains(t)).count() as f64 / a.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_function_is_wholly_correlated_and_a_constant_not_at_all() {
        let line: Vec<(f64, f64)> =
            (0..9).map(|i| (f64::from(i), 3.0 - 2.0 * f64::from(i))).collect();
        assert!((Moments::of(&line).correlation_sq().unwrap() - 1.0).abs() < 1e-12);
        let constant: Vec<(f64, f64)> = line.iter().map(|p| (p.0, 1.0)).collect();
        assert_eq!(Moments::of(&constant).correlation_sq(), None);
    }
}
