//! Articulated bundle adjustment: Gauss-Newton on axis, origin, the configuration of every
//! frame and the part points, which are eliminated by Schur complement.

use super::grown::Grown;
use super::view::View;
use crate::geometry::{median_point, orthonormal_basis};
use nalgebra::{DMatrix, DVector, Matrix3, Point3, SMatrix, Vector3};
use rayon::prelude::*;

/// Columns of an observation's Jacobian: axis (2), origin (2), configuration.
const COLUMNS: usize = 5;
const Q: usize = 4;
/// Parameters of a line: two of its direction, two of its place.
const LINE_PARAMETERS: usize = 4;

/// Redescending weight of a squared distance: 1 at none, 0 from the cut on.
pub fn weight(distance_sq: f64, cut: f64) -> f64 {
    if distance_sq < cut { (1.0 - distance_sq / cut).powi(2) } else { 0.0 }
}

/// Part points of tracks given joint and configurations: robust means of where each
/// observation says the point is, from their component-wise median.
pub fn locate_points(joint: &mut Grown, view: &View, tracks: &[usize], cut: f64) {
    let located: Vec<Option<Point3<f64>>> =
        tracks.par_iter().map(|&t| locate(joint, view, t, cut)).collect();
    for (&t, p) in tracks.iter().zip(located) {
        if let Some(p) = p {
            joint.points[t] = p;
        }
    }
}

fn locate(joint: &Grown, view: &View, track: usize, cut: f64) -> Option<Point3<f64>> {
    let seen: Vec<_> = view.life(track).filter(|(f, _)| joint.known[*f]).collect();
    let carried: Vec<Point3<f64>> =
        seen.iter().map(|(f, s)| joint.dof.move_point(-joint.q[*f], &s.point)).collect();
    let mut point = median_point(&carried)?;
    for _ in 0..2 {
        let (mut sum, mut total) = (Vector3::zeros(), 0.0);
        for ((f, s), c) in seen.iter().zip(&carried) {
            let w = weight(s.distance_sq(&joint.dof.move_point(joint.q[*f], &point)), cut);
            sum += w * c.coords;
            total += w;
        }
        if total > 1e-6 {
            point = Point3::from(sum / total);
        }
    }
    Some(point)
}

/// The reduced system of one track: contributions to the joint's Hessian and gradient.
struct Reduced {
    /// Hessian over (axis, origin).
    hessian: SMatrix<f64, 4, 4>,
    gradient: SMatrix<f64, 4, 1>,
    frames: Vec<usize>,
    /// (axis, origin) against each frame's configuration.
    cross: Vec<SMatrix<f64, 4, 1>>,
    /// Configurations against one another.
    configurations: DMatrix<f64>,
    configuration_gradient: Vec<f64>,
}

fn reduce(joint: &Grown, view: &View, track: usize, cut: f64) -> Option<Reduced> {
    let dof = &joint.dof;
    let (u, v) = orthonormal_basis(&dof.axis);
    let point = joint.points[track];
    let mut point_hessian = Matrix3::zeros();
    let mut point_gradient = Vector3::zeros();
    let mut hessian = SMatrix::<f64, COLUMNS, COLUMNS>::zeros();
    let mut gradient = SMatrix::<f64, 4, 1>::zeros();
    let (mut frames, mut couplings, mut blocks) = (Vec::new(), Vec::new(), Vec::new());
    for (f, s) in view.life(track).filter(|(f, _)| joint.known[*f]) {
        let q = joint.q[f];
        let moved = dof.move_point(q, &point);
        let w = weight(s.distance_sq(&moved), cut);
        if w <= 0.0 {
            continue;
        }
        let mut jacobian = SMatrix::<f64, 3, COLUMNS>::zeros();
        let mut rotation = Matrix3::identity();
        if dof.hinge {
            let arm = point - dof.origin;
            let (sin, cos) = q.sin_cos();
            for (k, side) in [u, v].into_iter().enumerate() {
                let turned = side.cross(&arm) * sin
                    + (side * dof.axis.dot(&arm) + dof.axis * side.dot(&arm)) * (1.0 - cos);
                jacobian.set_column(k, &turned);
                jacobian.set_column(2 + k, &(side - dof.turn(q, &side)));
            }
            for k in 0..3 {
                let mut unit = Vector3::zeros();
                unit[k] = 1.0;
                rotation.set_column(k, &dof.turn(q, &unit));
            }
        } else {
            jacobian.set_column(0, &(u * q));
            jacobian.set_column(1, &(v * q));
        }
        jacobian.set_column(Q, &dof.velocity(&moved));
        let information = s.information * w;
        let error = moved - s.point;
        let (ij, ir) = (information * jacobian, information * rotation);
        point_hessian += rotation.transpose() * ir;
        point_gradient += rotation.transpose() * (information * error);
        let full = jacobian.transpose() * ij;
        let full_gradient = jacobian.transpose() * (information * error);
        for a in 0..4 {
            gradient[a] += full_gradient[a];
            for b in 0..4 {
                hessian[(a, b)] += full[(a, b)];
            }
        }
        frames.push(f);
        couplings.push(rotation.transpose() * ij);
        blocks.push((full.column(Q).into_owned(), full_gradient[Q]));
    }
    if frames.len() < 2 {
        return None;
    }
    point_hessian += Matrix3::identity() * (1e-9 * point_hessian.trace() + 1e-6);
    let inverse = point_hessian.try_inverse()?;
    let mut line: SMatrix<f64, 3, 4> = SMatrix::zeros();
    for c in &couplings {
        line += c.fixed_view::<3, 4>(0, 0);
    }
    let inverse_line = inverse * line;
    let inverse_gradient = inverse * point_gradient;
    let n = frames.len();
    let mut configurations = DMatrix::zeros(n, n);
    let mut cross = Vec::with_capacity(n);
    let mut configuration_gradient = Vec::with_capacity(n);
    for i in 0..n {
        let ci: Vector3<f64> = couplings[i].column(Q).into_owned();
        cross.push(blocks[i].0.fixed_view::<4, 1>(0, 0) - inverse_line.transpose() * ci);
        configuration_gradient.push(blocks[i].1 - ci.dot(&inverse_gradient));
        let inverse_ci = inverse * ci;
        for j in 0..=i {
            let shared = couplings[j].column(Q).dot(&inverse_ci);
            configurations[(i, j)] = -shared;
            configurations[(j, i)] = -shared;
        }
        configurations[(i, i)] += blocks[i].0[Q];
    }
    Some(Reduced {
        hessian: hessian.fixed_view::<4, 4>(0, 0) - line.transpose() * inverse_line,
        gradient: gradient - line.transpose() * inverse_gradient,
        frames,
        cross,
        configurations,
        configuration_gradient,
    })
}

/// The system of all tracks over (axis, origin, configurations).
fn assemble(
    joint: &Grown,
    view: &View,
    tracks: &[usize],
    cut: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let reduced: Vec<Reduced> =
        tracks.par_iter().filter_map(|&t| reduce(joint, view, t, cut)).collect();
    assembled(&reduced, view.frames)
}

fn assembled(reduced: &[Reduced], frames: usize) -> (DMatrix<f64>, DVector<f64>) {
    let size = 4 + frames;
    let mut hessian = DMatrix::zeros(size, size);
    let mut gradient = DVector::zeros(size);
    for r in reduced {
        for a in 0..4 {
            gradient[a] += r.gradient[a];
            for b in 0..4 {
                hessian[(a, b)] += r.hessian[(a, b)];
            }
        }
        for (i, &f) in r.frames.iter().enumerate() {
            gradient[4 + f] += r.configuration_gradient[i];
            for a in 0..4 {
                hessian[(a, 4 + f)] += r.cross[i][a];
                hessian[(4 + f, a)] += r.cross[i][a];
            }
            for (j, &g) in r.frames.iter().enumerate() {
                hessian[(4 + f, 4 + g)] += r.configurations[(i, j)];
            }
        }
    }
    (hessian, gradient)
}

/// One damped step; `None` when the system cannot be solved.
fn step(joint: &Grown, view: &View, tracks: &[usize], cut: f64, damping: f64) -> Option<Grown> {
    let (mut hessian, gradient) = assemble(joint, view, tracks, cut);
    for k in 0..hessian.nrows() {
        hessian[(k, k)] += damping * hessian[(k, k)] + 1e-6;
    }
    hessian[(4 + joint.anchor, 4 + joint.anchor)] += 1e9;
    let delta = hessian.cholesky()?.solve(&(-gradient));
    if !delta.iter().all(|x| x.is_finite()) {
        return None;
    }
    let (u, v) = orthonormal_basis(&joint.dof.axis);
    let mut next = joint.clone();
    next.dof.axis = (joint.dof.axis + u * delta[0] + v * delta[1]).normalize();
    if joint.dof.hinge {
        let shift = u * delta[2] + v * delta[3];
        next.dof.origin += if shift.norm() > 1.0 { shift.normalize() } else { shift };
    }
    for f in 0..view.frames {
        if joint.known[f] {
            next.q[f] += delta[4 + f];
            if next.q[f].abs() > 20.0 {
                return None;
            }
        }
    }
    Some(next)
}

/// Refines a joint on the given tracks by at most `steps` steps, the first half with a wide
/// cut. Part points of the tracks follow.
pub fn refine(joint: &mut Grown, view: &View, tracks: &[usize], cut: f64, steps: usize) {
    if tracks.len() < 3 || joint.known.iter().filter(|k| **k).count() < 3 {
        return;
    }
    if !joint.known[joint.anchor] {
        joint.anchor = joint.known.iter().position(|k| *k).unwrap_or(0);
    }
    locate_points(joint, view, tracks, 4.0 * cut);
    let mut damping = 1e-4;
    for i in 0..steps {
        let cut = if i < steps / 2 { 4.0 * cut } else { cut };
        let total =
            |j: &Grown| -> f64 { tracks.par_iter().map(|&t| j.cost_of(view, t, cut).sum).sum() };
        let before = total(joint);
        let Some(mut next) = step(joint, view, tracks, cut, damping) else { break };
        locate_points(&mut next, view, tracks, cut);
        if total(&next) > 1.0001 * before {
            damping = f64::max(damping, 1e-3) * 30.0;
            if damping > 1e3 {
                break;
            }
        } else {
            *joint = next;
            damping = f64::max(damping / 10.0, 1e-6);
        }
    }
    if joint.dof.hinge {
        let mean = tracks.iter().map(|&t| joint.points[t].coords).sum::<Vector3<f64>>()
            / tracks.len() as f64;
        joint.dof.origin =
            crate::geometry::nearest_on_line(&joint.dof.origin, &joint.dof.axis, &mean.into());
    }
}

/// Covariance of (axis, origin) in the view's frame, configurations and points marginalised.
///
/// A track's errors are one draw, however long it lives: a feature that slides along an edge
/// is off in all of its frames. So the spread is taken between tracks (the sandwich estimator
/// of Liang & Zeger 1986, one cluster a track), not from the noise of observations.
pub fn covariance(joint: &Grown, view: &View, tracks: &[usize], cut: f64) -> DMatrix<f64> {
    let zero = DMatrix::zeros(6, 6);
    let reduced: Vec<Reduced> =
        tracks.par_iter().filter_map(|&t| reduce(joint, view, t, cut)).collect();
    if reduced.len() <= LINE_PARAMETERS {
        return zero;
    }
    let (mut hessian, _) = assembled(&reduced, view.frames);
    for k in 0..hessian.nrows() {
        hessian[(k, k)] += 1e-6;
    }
    hessian[(4 + joint.anchor, 4 + joint.anchor)] += 1e9;
    let Some(cholesky) = hessian.cholesky() else { return zero };
    let size = 4 + view.frames;
    let mut right = DMatrix::zeros(size, 4);
    for k in 0..4 {
        right[(k, k)] = 1.0;
    }
    let line_of_gradient = cholesky.solve(&right).transpose();
    let mut between = DMatrix::zeros(4, 4);
    for r in &reduced {
        let mut pull =
            line_of_gradient.columns(0, 4) * DVector::from_column_slice(r.gradient.as_slice());
        for (&f, g) in r.frames.iter().zip(&r.configuration_gradient) {
            pull += line_of_gradient.column(4 + f) * *g;
        }
        between += &pull * pull.transpose();
    }
    let n = reduced.len() as f64;
    let marginal = between * (n / (n - LINE_PARAMETERS as f64));
    let (u, v) = orthonormal_basis(&joint.dof.axis);
    let mut to_space = DMatrix::zeros(6, 4);
    for r in 0..3 {
        to_space[(r, 0)] = u[r];
        to_space[(r, 1)] = v[r];
        if joint.dof.hinge {
            to_space[(r + 3, 2)] = u[r];
            to_space[(r + 3, 3)] = v[r];
        }
    }
    &to_space * marginal * to_space.transpose()
}

#[cfg(test)]
mod tests {
    use super::super::dof::Dof;
    use super::*;
    use crate::base::{BaseMotion, BasePoint, BaseTrack};
    use crate::geometry::line_angle;

    /// A door of 12 points turning by 60 degrees in 30 frames, with 2 mm of noise.
    fn door(hinge: &Dof) -> (View, Vec<f64>) {
        let q: Vec<f64> = (0..30).map(|f| f64::from(f) * 0.035).collect();
        let mut state = 1_u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            0.004 * (f64::from(state >> 8) / f64::from(1 << 24) - 0.5)
        };
        let tracks = (0..12)
            .map(|i| {
                let i = f64::from(i);
                let p = Point3::new(0.1 + 0.03 * i, 0.1 * (i * 1.3).sin(), 1.2 + 0.02 * i);
                BaseTrack {
                    first_frame: 0,
                    moves: true,
                    points: q
                        .iter()
                        .map(|&q| {
                            let n = Vector3::new(noise(), noise(), noise());
                            Some(BasePoint {
                                point: hinge.move_point(q, &p) + n,
                                information: Matrix3::identity() / 0.002_f64.powi(2),
                                sigma: 0.002,
                            })
                        })
                        .collect(),
                }
            })
            .collect();
        let base =
            BaseMotion { camera_from_base: vec![Default::default(); 30], tracks, static_count: 0 };
        (View::from_base(&base, (0..12).collect()), q)
    }

    #[test]
    fn a_rough_hinge_is_refined_to_the_true_one() {
        let truth = Dof { hinge: true, axis: Vector3::y(), origin: Point3::new(0.05, 0.0, 1.15) };
        let (view, q) = door(&truth);
        let rough = Dof {
            axis: Vector3::new(0.1, 1.0, -0.08).normalize(),
            origin: Point3::new(0.02, 0.0, 1.18),
            ..truth
        };
        let mut joint = Grown::new(rough, &view, 0);
        joint.q = q.iter().map(|q| 0.9 * q).collect();
        joint.known = vec![true; 30];
        let all: Vec<usize> = (0..12).collect();
        joint.members.clone_from(&all);
        refine(&mut joint, &view, &all, 16.0, 12);
        assert!(line_angle(&joint.dof.axis, &truth.axis).to_degrees() < 0.5);
        let offset =
            crate::geometry::distance_to_line(&joint.dof.origin, &truth.axis, &truth.origin);
        assert!(offset < 0.003, "{offset}");
        assert!((joint.q[29] - joint.q[0] - q[29]).abs() < 0.01);
        assert_eq!(joint.unruly_share(&view), 0.0);
        // What goes on where the joint explains nothing is a hand.
        joint.known[15..].fill(false);
        assert_eq!(joint.unruly_share(&view), 0.5);
        joint.known.fill(true);
        let covariance = covariance(&joint, &view, &all, 16.0);
        let sd = covariance.fixed_view::<3, 3>(0, 0).trace().sqrt().to_degrees();
        assert!(sd > 0.01 && sd < 0.5, "{sd}");
    }
}
