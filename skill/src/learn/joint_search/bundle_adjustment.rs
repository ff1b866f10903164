//! Articulated bundle adjustment: refines axis, origin, the configurations of the known frames and the
//! points on the part. The points are eliminated by Schur complement; the pitch of a screw is fixed.
//!
//! In: a joint, and tracks in the frame of its parent (metres) with the covariance of each observation.
//! Out: the refined joint; the covariance of (axis, origin), 6 x 6, in that frame (unit vector,
//! metres).
//! From: Gauss-Newton with Levenberg-Marquardt damping on Mahalanobis residuals with Tukey's biweight;
//! sandwich covariance of Liang & Zeger 1986.

use super::estimate::JointEstimate;
use super::screw_joint::{ScrewJoint, ScrewMotion};
use super::tracks_in_part_frame::TracksInFrame;
use crate::learn::ego_motion::BaseObservation;
use crate::math::normal_equations::NormalEquations;
use crate::math::rigid::orthonormal_basis;
use crate::math::robust::median_point;
use nalgebra::{DMatrix, Dyn, Matrix3, Point3, SMatrix, SVector, Vector3};
use rayon::prelude::*;

/// Squared Mahalanobis distance from which an observation is an outlier.
pub const OUTLIER_CUT: f64 = 16.0;
/// Number of bundle adjustment steps once a joint has been propagated to all frames.
pub const FINISH_STEPS: usize = 5;
/// Number of parameters of a line: two of its direction, two of its place.
const LINE: usize = 4;

/// Tukey's biweight for a squared distance: 1 at distance 0, and 0 from `cut` on.
pub fn weight(distance_sq: f64, cut: f64) -> f64 {
    if distance_sq < cut { (1.0 - distance_sq / cut).powi(2) } else { 0.0 }
}

/// Largest number of observations of a track from which its point is first estimated.
const SKETCH: usize = 24;

/// Estimates the points of tracks on the part, given the joint and its configurations: the
/// component-wise median of some observations carried back to configuration 0, then robust means.
pub fn locate_points(joint: &mut JointEstimate, view: &TracksInFrame, tracks: &[usize], cut: f64) {
    let motions = joint.motions();
    place(joint, tracks, |joint, t| {
        let known: Vec<(usize, &BaseObservation)> =
            view.life(t).filter(|(f, _)| joint.known[*f]).collect();
        let stride = known.len().div_ceil(SKETCH).max(1);
        let sketch = || known.iter().copied().step_by(stride);
        let carried: Vec<Point3<f64>> =
            sketch().map(|(f, s)| motions[f].inverse_transform(&s.point)).collect();
        let middle = median_point(&carried)?;
        let nearer = settled(&motions, sketch(), middle, cut);
        Some(settled(&motions, known.iter().copied(), nearer, cut))
    });
}

/// Updates the points on the part by one robust mean from their present places, which are nearly right.
fn follow_points(joint: &mut JointEstimate, view: &TracksInFrame, tracks: &[usize], cut: f64) {
    let motions = joint.motions();
    place(joint, tracks, |joint, t| {
        let known = view.life(t).filter(|(f, _)| joint.known[*f]);
        Some(settled(&motions, known, joint.points[t], cut))
    });
}

fn place(
    joint: &mut JointEstimate,
    tracks: &[usize],
    located: impl Fn(&JointEstimate, usize) -> Option<Point3<f64>> + Sync,
) {
    let points: Vec<Option<Point3<f64>>> = tracks.par_iter().map(|&t| located(joint, t)).collect();
    for (&t, p) in tracks.iter().zip(points) {
        if let Some(p) = p {
            joint.points[t] = p;
        }
    }
}

/// Robust mean of observations that are carried back to configuration 0, each weighted by its distance
/// from `point`.
fn settled<'s>(
    motions: &[ScrewMotion],
    observations: impl Iterator<Item = (usize, &'s BaseObservation)>,
    point: Point3<f64>,
    cut: f64,
) -> Point3<f64> {
    let (mut sum, mut total) = (Vector3::zeros(), 0.0);
    for (f, s) in observations {
        let w = weight(s.distance_sq(&motions[f].transform(&point)), cut);
        if w > 0.0 {
            sum += w * motions[f].inverse_transform(&s.point).coords;
            total += w;
        }
    }
    if total > 1e-6 { Point3::from(sum / total) } else { point }
}

/// Normal equations of one track over line and configurations, with its point eliminated. The track
/// adds to the block of the configurations `own` on the diagonal less `couplings' * inverse *
/// couplings`.
struct Reduced {
    /// Hessian over the line's parameters.
    hessian: SMatrix<f64, LINE, LINE>,
    gradient: SVector<f64, LINE>,
    /// Terms of the frames in which the track is an inlier.
    frames: Vec<FrameTerms>,
    inverse: Matrix3<f64>,
}

/// Terms of one observation that depend on the configuration of its frame.
struct FrameTerms {
    frame: usize,
    /// Hessian block of the line and the configuration.
    cross: SVector<f64, LINE>,
    /// Hessian entry of the configuration.
    own: f64,
    /// Hessian block of the track's point and the configuration.
    coupling: Vector3<f64>,
    gradient: f64,
}

/// Rotation of a joint's part at one configuration.
struct Turn {
    sin: f64,
    cos: f64,
    rotation: Matrix3<f64>,
}

fn turns(joint: &JointEstimate) -> Vec<Turn> {
    joint
        .q
        .iter()
        .map(|&q| {
            let (sin, cos) = q.sin_cos();
            let unit = [Vector3::x(), Vector3::y(), Vector3::z()];
            let rotation = match joint.dof.hinge {
                true => Matrix3::from_columns(&unit.map(|e| joint.dof.turn(q, &e))),
                false => Matrix3::identity(),
            };
            Turn { sin, cos, rotation }
        })
        .collect()
}

/// Derivative of a moved point by the line: two columns for its direction along `sides`, two for its
/// place. `arm` is the vector from the line's origin to the point on the part.
fn line_jacobian(
    dof: &ScrewJoint,
    sides: [Vector3<f64>; 2],
    arm: &Vector3<f64>,
    q: f64,
    turn: &Turn,
) -> SMatrix<f64, 3, LINE> {
    let mut jacobian = SMatrix::<f64, 3, LINE>::zeros();
    if dof.hinge {
        let advance = dof.pitch.unwrap_or(0.0) * q;
        for (k, side) in sides.into_iter().enumerate() {
            let turned = side.cross(arm) * turn.sin
                + (side * dof.axis.dot(arm) + dof.axis * side.dot(arm)) * (1.0 - turn.cos);
            jacobian.set_column(k, &(turned + side * advance));
            jacobian.set_column(2 + k, &(side - turn.rotation * side));
        }
    } else {
        jacobian.set_column(0, &(sides[0] * q));
        jacobian.set_column(1, &(sides[1] * q));
    }
    jacobian
}

/// Normal equations of one track over the line, the track's point and the configurations of its frames.
struct TrackEquations {
    hessian: SMatrix<f64, LINE, LINE>,
    gradient: SVector<f64, LINE>,
    point_hessian: Matrix3<f64>,
    point_gradient: Vector3<f64>,
    /// Hessian block of the point and the line.
    line: SMatrix<f64, 3, LINE>,
    frames: Vec<FrameTerms>,
}

/// Derivatives of a moved point by the parameters that all tracks share.
struct Derivatives {
    /// Derivative by the line's parameters.
    jacobian: SMatrix<f64, 3, LINE>,
    /// Derivative by the configuration.
    velocity: Vector3<f64>,
}

impl TrackEquations {
    fn of(
        joint: &JointEstimate,
        turns: &[Turn],
        view: &TracksInFrame,
        track: usize,
        cut: f64,
    ) -> Self {
        let dof = &joint.dof;
        let sides = orthonormal_basis(&dof.axis).into();
        let point = joint.points[track];
        let arm = point - dof.origin;
        let mut equations = Self {
            hessian: SMatrix::zeros(),
            gradient: SVector::zeros(),
            point_hessian: Matrix3::zeros(),
            point_gradient: Vector3::zeros(),
            line: SMatrix::zeros(),
            frames: Vec::new(),
        };
        for (f, s) in view.life(track).filter(|(f, _)| joint.known[*f]) {
            let (q, turn) = (joint.q[f], &turns[f]);
            let moved = match dof.hinge {
                true => dof.origin + turn.rotation * arm + dof.advance(q),
                false => point + dof.axis * q,
            };
            let w = weight(s.distance_sq(&moved), cut);
            if w > 0.0 {
                let information = s.precision.matrix() * w;
                let jacobian = line_jacobian(dof, sides, &arm, q, turn);
                let pull = information * (moved - s.point);
                let derivatives = Derivatives { jacobian, velocity: dof.velocity(&moved) };
                equations.add(f, &information, &derivatives, &pull, turn);
            }
        }
        equations
    }

    /// Adds an observation: the derivatives of the moved point, and the weighted residual `pull`
    /// (predicted less observed).
    fn add(
        &mut self,
        frame: usize,
        information: &Matrix3<f64>,
        Derivatives { jacobian, velocity }: &Derivatives,
        pull: &Vector3<f64>,
        turn: &Turn,
    ) {
        let (weighed, weighed_velocity) = (information * jacobian, information * velocity);
        let back = turn.rotation.transpose();
        self.point_hessian += back * information * turn.rotation;
        self.point_gradient += back * pull;
        self.gradient += jacobian.transpose() * pull;
        self.hessian += jacobian.transpose() * weighed;
        self.line += back * weighed;
        self.frames.push(FrameTerms {
            frame,
            cross: jacobian.transpose() * weighed_velocity,
            own: velocity.dot(&weighed_velocity),
            coupling: back * weighed_velocity,
            gradient: velocity.dot(pull),
        });
    }

    /// Eliminates the point by Schur complement; `None` for a track of fewer than two inlier
    /// observations.
    fn reduced(mut self) -> Option<Reduced> {
        if self.frames.len() < 2 {
            return None;
        }
        self.point_hessian += Matrix3::identity() * (1e-9 * self.point_hessian.trace() + 1e-6);
        let inverse = self.point_hessian.try_inverse()?;
        let inverse_line = inverse * self.line;
        let inverse_gradient = inverse * self.point_gradient;
        for terms in &mut self.frames {
            terms.cross -= inverse_line.transpose() * terms.coupling;
            terms.gradient -= terms.coupling.dot(&inverse_gradient);
        }
        Some(Reduced {
            hessian: self.hessian - self.line.transpose() * inverse_line,
            gradient: self.gradient - self.line.transpose() * inverse_gradient,
            frames: self.frames,
            inverse,
        })
    }
}

fn reduce(
    joint: &JointEstimate,
    turns: &[Turn],
    view: &TracksInFrame,
    track: usize,
    cut: f64,
) -> Option<Reduced> {
    TrackEquations::of(joint, turns, view, track, cut).reduced()
}

/// Normal equations over the line and the configurations of the known frames; residuals are predicted
/// less observed.
struct System {
    equations: NormalEquations<Dyn>,
    /// By frame: row of the frame's configuration; valid for known frames.
    rows: Vec<usize>,
}

/// Number of tracks that are summed in one piece. It is fixed, so that sums do not depend on how the
/// work is divided among threads.
const PIECE: usize = 24;

impl System {
    fn of(joint: &JointEstimate, view: &TracksInFrame, tracks: &[usize], cut: f64) -> Self {
        let turns = turns(joint);
        let mut system = Self::empty(joint);
        let pieces: Vec<Self> = tracks
            .par_chunks(PIECE)
            .map(|piece| {
                let mut part = Self::empty(joint);
                for r in piece.iter().filter_map(|&t| reduce(joint, &turns, view, t, cut)) {
                    part.add(&r);
                }
                part
            })
            .collect();
        for part in pieces {
            system.equations.left += part.equations.left;
            system.equations.right += part.equations.right;
        }
        system
    }

    fn empty(joint: &JointEstimate) -> Self {
        let mut size = LINE;
        let rows = joint
            .known
            .iter()
            .map(|known| {
                size += usize::from(*known);
                size.saturating_sub(1)
            })
            .collect();
        Self { equations: NormalEquations::of(Dyn(size)), rows }
    }

    fn add(&mut self, r: &Reduced) {
        let NormalEquations { left, right } = &mut self.equations;
        for a in 0..LINE {
            right[a] += r.gradient[a];
            for b in 0..LINE {
                left[(a, b)] += r.hessian[(a, b)];
            }
        }
        for (i, terms) in r.frames.iter().enumerate() {
            let column = self.rows[terms.frame];
            right[column] += terms.gradient;
            for a in 0..LINE {
                left[(column, a)] += terms.cross[a];
            }
            left[(column, column)] += terms.own;
            let pulled = r.inverse * terms.coupling;
            let mut below = left.column_mut(column);
            for later in &r.frames[i..] {
                below[self.rows[later.frame]] -= later.coupling.dot(&pulled);
            }
        }
    }

    /// Holds the configuration at the anchor fixed, because the zero of q is free.
    fn pin(&mut self, joint: &JointEstimate) {
        if joint.known[joint.anchor] {
            let row = self.rows[joint.anchor];
            self.equations.left[(row, row)] += 1e9;
        }
    }
}

/// One damped step; `None` if the system cannot be solved or a configuration diverges.
fn step(
    joint: &JointEstimate,
    view: &TracksInFrame,
    tracks: &[usize],
    cut: f64,
    damping: f64,
) -> Option<JointEstimate> {
    let mut system = System::of(joint, view, tracks, cut);
    let left = &mut system.equations.left;
    for k in 0..left.nrows() {
        left[(k, k)] += damping * left[(k, k)] + 1e-6;
    }
    system.pin(joint);
    let delta = -system.equations.solution()?;
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
            next.q[f] += delta[system.rows[f]];
            if next.q[f].abs() > 20.0 {
                return None;
            }
        }
    }
    Some(next)
}

/// Share of the cost that must remain after a step for the refinement to stop, because the step changed
/// next to nothing.
const SETTLED: f64 = 0.999;

/// Refines a joint on the given tracks by at most `steps` steps, the first half of them with a wide
/// outlier cut. The points of these tracks are updated too.
pub fn refine(
    joint: &mut JointEstimate,
    view: &TracksInFrame,
    tracks: &[usize],
    cut: f64,
    steps: usize,
) {
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
        let total = |j: &JointEstimate| -> f64 {
            let motions = j.motions();
            tracks.par_iter().map(|&t| j.cost_of(&motions, view, t, cut).sum).sum()
        };
        let before = total(joint);
        let Some(mut next) = step(joint, view, tracks, cut, damping) else { break };
        if i < steps / 2 {
            locate_points(&mut next, view, tracks, cut);
        } else {
            follow_points(&mut next, view, tracks, cut);
        }
        let after = total(&next);
        if after > 1.0001 * before {
            damping = f64::max(damping, 1e-3) * 30.0;
            if damping > 1e3 {
                break;
            }
        } else {
            *joint = next;
            damping = f64::max(damping / 10.0, 1e-6);
            if i >= steps / 2 && after > SETTLED * before {
                break;
            }
        }
    }
    if joint.dof.hinge {
        let mean = tracks.iter().map(|&t| joint.points[t].coords).sum::<Vector3<f64>>()
            / tracks.len() as f64;
        joint.dof.origin =
            crate::math::rigid::nearest_on_line(&joint.dof.origin, &joint.dof.axis, &mean.into());
    }
}

/// Covariance of (axis, origin) in the frame of the joint's parent; configurations and points are
/// marginalised. Zero where it cannot be computed.
///
/// The errors of one track are correlated over its whole life: a feature that slides along an edge is
/// off in all of its frames. So the spread between tracks is taken (the sandwich estimator of Liang &
/// Zeger 1986, one cluster per track), not the noise of observations.
pub fn covariance(
    joint: &JointEstimate,
    view: &TracksInFrame,
    tracks: &[usize],
    cut: f64,
) -> DMatrix<f64> {
    let zero = DMatrix::zeros(6, 6);
    let turns = turns(joint);
    let reduced: Vec<Reduced> =
        tracks.par_iter().filter_map(|&t| reduce(joint, &turns, view, t, cut)).collect();
    if reduced.len() <= LINE {
        return zero;
    }
    let mut system = System::empty(joint);
    for r in &reduced {
        system.add(r);
    }
    let size = system.equations.right.len();
    system.equations.damp(1e-6);
    system.pin(joint);
    let Some(cholesky) = system.equations.left.cholesky() else { return zero };
    let line_of_gradient = cholesky.solve(&DMatrix::identity(size, LINE)).transpose();
    let mut between = DMatrix::zeros(LINE, LINE);
    for r in &reduced {
        let mut pull = line_of_gradient.columns(0, LINE) * r.gradient;
        for terms in &r.frames {
            pull += line_of_gradient.column(system.rows[terms.frame]) * terms.gradient;
        }
        between += &pull * pull.transpose();
    }
    let n = reduced.len() as f64;
    let marginal = between * (n / (n - LINE as f64));
    let (u, v) = orthonormal_basis(&joint.dof.axis);
    let mut to_space = DMatrix::zeros(6, LINE);
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
    use super::*;
    use crate::learn::joint_search::test_data::seen_moving;
    use crate::math::rigid::line_angle;

    /// A door of 12 points turning by 60 degrees in 30 frames, with 2 mm of noise.
    fn door(hinge: &ScrewJoint) -> (TracksInFrame, Vec<f64>) {
        let q: Vec<f64> = (0..30).map(|f| f64::from(f) * 0.035).collect();
        let places: Vec<Point3<f64>> = (0..12)
            .map(f64::from)
            .map(|i| Point3::new(0.1 + 0.03 * i, 0.1 * (i * 1.3).sin(), 1.2 + 0.02 * i))
            .collect();
        (seen_moving(hinge, &places, &q), q)
    }

    #[test]
    fn a_rough_hinge_is_refined_to_the_true_one() {
        let truth = ScrewJoint::hinge(Vector3::y(), Point3::new(0.05, 0.0, 1.15));
        let (view, q) = door(&truth);
        let rough = ScrewJoint {
            axis: Vector3::new(0.1, 1.0, -0.08).normalize(),
            origin: Point3::new(0.02, 0.0, 1.18),
            ..truth
        };
        let mut joint = JointEstimate::new(rough, &view, 0);
        joint.q = q.iter().map(|q| 0.9 * q).collect();
        joint.known = vec![true; 30];
        let all: Vec<usize> = (0..12).collect();
        joint.members.clone_from(&all);
        refine(&mut joint, &view, &all, 16.0, 12);
        assert!(line_angle(&joint.dof.axis, &truth.axis).to_degrees() < 0.5);
        let offset =
            crate::math::rigid::distance_to_line(&joint.dof.origin, &truth.axis, &truth.origin);
        assert!(offset < 0.003, "{offset}");
        assert!((joint.q[29] - joint.q[0] - q[29]).abs() < 0.01);
        assert_eq!(joint.uncovered_ratio(&view), 0.0);
        // Tracks that go on where the configuration is unknown are not covered.
        joint.known[15..].fill(false);
        assert_eq!(joint.uncovered_ratio(&view), 0.5);
        joint.known.fill(true);
        let covariance = covariance(&joint, &view, &all, 16.0);
        let sd = covariance.fixed_view::<3, 3>(0, 0).trace().sqrt().to_degrees();
        assert!(sd > 0.01 && sd < 0.5, "{sd}");
    }
}
