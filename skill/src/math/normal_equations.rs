//! Normal equations of a least-squares problem, for one step of Gauss and Newton.
//!
//! In: residuals, each with its row of the Jacobian and its weight. Out: the step that lowers them, and the
//! information (inverse covariance) of the unknowns. Which way a step goes the sign of the residuals says: with
//! "seen less predicted" the solution is the step, with "predicted less seen" its negative.

use nalgebra::allocator::Allocator;
use nalgebra::{Const, DefaultAllocator, Dim, DimSub, Dyn, OMatrix, OVector};

/// Normal equations; `D` is the number of unknowns, known to the compiler (`Const<5>`) or not (`Dyn`).
pub struct NormalEquations<D: Dim>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    /// Sum of the weighted products of each row with itself; of the symmetric matrix the lower triangle alone.
    pub left: OMatrix<f64, D, D>,
    /// Sum of the weighted rows, each times its residual.
    pub right: OVector<f64, D>,
}

impl<D: Dim> NormalEquations<D>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    /// Of so many unknowns, of which nothing is known.
    pub fn of(unknowns: D) -> Self {
        Self {
            left: OMatrix::zeros_generic(unknowns, unknowns),
            right: OVector::zeros_generic(unknowns, Const::<1>),
        }
    }

    /// Adds one residual, with how the prediction changes with each unknown.
    pub fn add(&mut self, row: &OVector<f64, D>, residual: f64, weight: f64) {
        self.right.axpy(weight * residual, row, 1.0);
        self.left.syger(weight, row, row, 1.0);
    }

    /// Adds all that other equations hold, weighted.
    pub fn add_weighted(&mut self, other: &Self, weight: f64) {
        self.left += &other.left * weight;
        self.right += &other.right * weight;
    }

    /// Adds information to each unknown: what nothing tells of stays about where it is.
    pub fn damp(&mut self, information: f64) {
        for k in 0..self.right.len() {
            self.left[(k, k)] += information;
        }
    }

    /// Information of the unknowns, both triangles.
    pub fn information(&self) -> OMatrix<f64, D, D> {
        let mut information = self.left.clone();
        information.fill_upper_triangle_with_lower_triangle();
        information
    }
}

impl<D: DimSub<Dyn>> NormalEquations<D>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    /// The solution; `None` where something is not told.
    pub fn solution(self) -> Option<OVector<f64, D>> {
        Some(self.left.cholesky()?.solve(&self.right))
    }
}

/// Least information of an unknown that is eliminated.
const LEAST_INFORMATION: f64 = 1e-9;

impl<const N: usize> NormalEquations<Const<N>> {
    /// Of unknowns of which nothing is known.
    pub fn zero() -> Self {
        Self::of(Const::<N>)
    }

    /// The equations of the unknowns before the last one (`M` of them), whatever that is: Schur complement.
    pub fn without_last<const M: usize>(&self) -> NormalEquations<Const<M>> {
        const { assert!(M + 1 == N, "one unknown is eliminated") };
        let own = self.left[(M, M)].max(LEAST_INFORMATION);
        let cross = self.left.fixed_view::<1, M>(M, 0).transpose();
        NormalEquations {
            left: self.left.fixed_view::<M, M>(0, 0) - cross * cross.transpose() / own,
            right: self.right.fixed_rows::<M>(0) - cross * (self.right[M] / own),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DVector, Matrix3, Vector2, Vector3};

    /// A line's height and slope at so many places, seen with some error.
    fn line_through(points: &[(f64, f64)]) -> NormalEquations<Const<2>> {
        let mut equations = NormalEquations::zero();
        points.iter().for_each(|(x, y)| equations.add(&Vector2::new(1.0, *x), *y, 1.0));
        equations
    }

    #[test]
    fn the_solution_is_that_of_least_squares() {
        let exact = line_through(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]).solution().unwrap();
        assert!((exact - Vector2::new(1.0, 2.0)).norm() < 1e-12);
        // The middle one is 0.3 too high: the line rises by a third of that.
        let off = line_through(&[(0.0, 1.0), (1.0, 3.3), (2.0, 5.0)]).solution().unwrap();
        assert!((off - Vector2::new(1.1, 2.0)).norm() < 1e-12);
    }

    #[test]
    fn a_residual_of_twice_the_weight_counts_as_two() {
        let (mut once, mut twice) = (NormalEquations::zero(), NormalEquations::zero());
        let row = Vector2::new(0.5, -2.0);
        once.add(&row, 0.7, 2.0);
        (0..2).for_each(|_| twice.add(&row, 0.7, 1.0));
        assert!((once.information() - twice.information()).norm() < 1e-12);
        assert!((once.right - twice.right).norm() < 1e-12);
        let mut added = NormalEquations::zero();
        added.add_weighted(&once, 0.5);
        assert!((added.information() - 0.5 * once.information()).norm() < 1e-12);
    }

    #[test]
    fn an_unknown_of_which_nothing_tells_has_no_solution_and_with_damping_it_stays() {
        let mut equations = NormalEquations::of(Dyn(3));
        equations.add(&DVector::from_column_slice(&[1.0, 0.0, 0.0]), 2.0, 4.0);
        let mut damped = NormalEquations::of(Dyn(3));
        damped.add_weighted(&equations, 1.0);
        damped.damp(1e-6);
        assert!(equations.solution().is_none());
        let step = damped.solution().unwrap();
        assert!((step[0] - 2.0).abs() < 1e-5 && step[1] == 0.0 && step[2] == 0.0);
    }

    #[test]
    fn information_is_symmetric() {
        let mut equations = NormalEquations::zero();
        equations.add(&Vector3::new(1.0, 2.0, 3.0), 0.0, 2.0);
        let row = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(equations.information(), 2.0 * row * row.transpose());
    }

    #[test]
    fn without_its_last_unknown_a_problem_has_the_same_solution_for_the_others() {
        let mut all = NormalEquations::<Const<3>>::zero();
        for i in 0..7 {
            let i = f64::from(i);
            all.add(&Vector3::new(1.0, i.sin(), 0.3 * i), 0.2 * i - 1.0, 1.0 + 0.1 * i);
        }
        let others = all.without_last::<2>();
        // The covariance of the others is that which they have beside it.
        let covariance: Matrix3<f64> = all.information().try_inverse().unwrap();
        let beside = others.information().try_inverse().unwrap();
        assert!((beside - covariance.fixed_view::<2, 2>(0, 0)).norm() < 1e-9);
        let full = all.solution().unwrap();
        assert!((others.solution().unwrap() - full.fixed_rows::<2>(0)).norm() < 1e-9);
    }

    #[test]
    fn a_last_unknown_of_which_nothing_tells_takes_nothing_from_the_others() {
        let mut all = NormalEquations::<Const<3>>::zero();
        all.add(&Vector3::new(1.0, 2.0, 0.0), 1.0, 1.0);
        let others = all.without_last::<2>();
        let row = Vector2::new(1.0, 2.0);
        assert_eq!(others.information(), row * row.transpose());
        assert_eq!(others.right, row);
    }
}
