//! From the joints of a search to learned ones: numbered parents first, carried into the object frame,
//! with configuration 0 at the first frame. The object frame is the base frame at the first frame.

use super::estimate::{JointEstimate, base_from_part};
use super::search_state::SearchState;
use super::tracks_in_part_frame::TracksInFrame;
use super::{bundle_adjustment, type_selection};
use crate::learn::learned_joint::{LearnedJoint, orient, range_of};
use crate::learn::tracking::Trajectory;
use crate::math::rigid::Pose;
use crate::object::model::{Joint, covariance_rows, is_undecided};
use nalgebra::{DMatrix, Matrix3, Point3, Vector3};
use rayon::prelude::*;

/// Factor on covariances. It was measured together with [`SYSTEMATIC_RAD`] and [`SYSTEMATIC_M`], so
/// that 95 % ellipsoids hold 95 % of the true axes.
const COVARIANCE_INFLATION: f64 = 4.0;
/// Error of an axis's direction that all readings of a depth camera share, so that many tracks do not
/// average it out, radians.
const SYSTEMATIC_RAD: f64 = 0.0025;
/// The same error of an axis's place, metres.
const SYSTEMATIC_M: f64 = 0.002;
/// Tracks that a covariance is taken over.
const COVARIANCE_TRACKS: usize = 300;

/// The learned joints, parents before children.
pub fn learned_joints(search: &SearchState) -> Vec<LearnedJoint> {
    let joints = &search.joints;
    let order = parents_first(joints);
    let number_of = |joint: usize| order.iter().position(|&j| j == joint).map_or(0, |n| n + 1);
    order
        .par_iter()
        .enumerate()
        .map(|(n, &i)| {
            let members = joints[i].members.iter();
            LearnedJoint {
                joint: Joint {
                    name: format!("joint{}", n + 1),
                    parent: joints[i].parent.map_or(0, number_of),
                    child: n + 1,
                    ..joint_in_object(search, i)
                },
                base_from_part: trajectory(search, i),
                tracks: members.map(|&t| search.base_view.track_numbers[t]).collect(),
                plain_surface: Vec::new(),
            }
        })
        .collect()
}

/// A joint in the object frame, which is the base frame at the first frame; not yet numbered. A moving
/// parent's line is carried to where the parent is then.
fn joint_in_object(search: &SearchState, index: usize) -> Joint {
    let joint = &search.joints[index];
    let view = search.view_from(joint.parent);
    let frames = joint.known_frames();
    let base_from_parent =
        joint.parent.map_or_else(Pose::identity, |p| base_from_part(&search.joints, p, 0));
    let mut geometry = joint.dof.geometry().transformed(&base_from_parent);
    let before = geometry.axis;
    let first = joint.filled[0];
    let mut configuration: Vec<f64> = frames.iter().map(|&f| joint.q[f] - first).collect();
    configuration.insert(0, 0.0);
    orient(&mut geometry, &mut configuration);
    configuration.remove(0);
    if !joint.dof.hinge {
        geometry.origin = base_from_parent * mean_point(joint);
    }
    let some: Vec<usize> = joint.members.iter().copied().take(COVARIANCE_TRACKS).collect();
    let spread = bundle_adjustment::covariance(joint, &view, &some, bundle_adjustment::OUTLIER_CUT);
    let covariance = carried(
        &(spread * COVARIANCE_INFLATION + systematic(joint)),
        &base_from_parent,
        before.dot(&geometry.axis) < 0.0,
    );
    let type_probabilities = type_selection::type_probabilities(joint, &view);
    Joint {
        range: range_of(&configuration),
        covariance: covariance_rows(&covariance),
        observations: frames.len(),
        bic: -2.0 * joint.gain,
        log_likelihood: joint.gain,
        position_rmse: position_rmse(joint, &view),
        configuration: search.recording.tracks.timed(&frames, &configuration),
        undecided: is_undecided(&type_probabilities),
        type_probabilities,
        ..Joint::of(&geometry)
    }
}

/// The poses of a joint's part in the base frame since the first frame, where they are known.
fn trajectory(search: &SearchState, index: usize) -> Trajectory {
    let joints = &search.joints;
    let rest = base_from_part(joints, index, 0).inverse();
    let mut trajectory: Trajectory = vec![None; search.recording.ego_motion.camera_from_base.len()];
    for f in joints[index].known_frames() {
        trajectory[f] = Some(base_from_part(joints, index, f) * rest);
    }
    trajectory
}

/// Covariance of (axis, origin) from errors that all of a camera's readings share.
fn systematic(joint: &JointEstimate) -> DMatrix<f64> {
    let across = Matrix3::identity() - joint.dof.axis * joint.dof.axis.transpose();
    let mut covariance = DMatrix::zeros(6, 6);
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&(across * SYSTEMATIC_RAD.powi(2)));
    if joint.dof.hinge {
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&(across * SYSTEMATIC_M.powi(2)));
    }
    covariance
}

/// A covariance of (axis, origin) in another frame; `reversed`: the axis points the other way there.
fn carried(covariance: &DMatrix<f64>, other_from_this: &Pose, reversed: bool) -> DMatrix<f64> {
    let rotation = other_from_this.rotation.to_rotation_matrix().into_inner();
    let mut turn = DMatrix::zeros(6, 6);
    for r in 0..3 {
        for c in 0..3 {
            turn[(r, c)] = if reversed { -rotation[(r, c)] } else { rotation[(r, c)] };
            turn[(r + 3, c + 3)] = rotation[(r, c)];
        }
    }
    &turn * covariance * turn.transpose()
}

fn mean_point(joint: &JointEstimate) -> Point3<f64> {
    let sum: Vector3<f64> = joint.members.iter().map(|&t| joint.points[t].coords).sum();
    Point3::from(sum / joint.members.len().max(1) as f64)
}

fn position_rmse(joint: &JointEstimate, view: &TracksInFrame) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for &t in &joint.members {
        for (f, s) in view.life(t).filter(|(f, _)| joint.known[*f]) {
            let moved = joint.dof.move_point(joint.q[f], &joint.points[t]);
            if s.distance_sq(&moved) < 16.0 {
                sum += (moved - s.point).norm_squared();
                count += 1;
            }
        }
    }
    (sum / f64::from(count.max(1))).sqrt()
}

fn parents_first(joints: &[JointEstimate]) -> Vec<usize> {
    let depth = |mut i: usize| {
        let mut depth = 0;
        while let Some(p) = joints[i].parent {
            depth += 1;
            i = p;
        }
        depth
    };
    let mut order: Vec<usize> = (0..joints.len()).collect();
    order.sort_by_key(|&i| depth(i));
    order
}
