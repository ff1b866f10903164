//! Converts the joints of a search to learned joints: numbered parents first, in the object frame,
//! with configuration 0 at the first frame.
//!
//! In: joints in the frames of their parents, metres and radians.
//! Out: learned joints in the object frame, which is the base frame at the first frame, with the
//! covariance of (axis, origin); poses of the parts in the base frame.

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

/// Factor on covariances, measured together with [`SYSTEMATIC_RAD`] and [`SYSTEMATIC_M`] so that 95
/// % ellipsoids hold 95 % of the true axes.
const COVARIANCE_INFLATION: f64 = 4.0;
/// Standard deviation of an axis's direction due to errors that all readings of a depth camera
/// share, radians. More tracks do not reduce it.
const SYSTEMATIC_RAD: f64 = 0.0025;
/// Standard deviation of an axis's place due to errors that all readings of a depth camera share,
/// metres.
const SYSTEMATIC_M: f64 = 0.002;
/// Largest number of tracks from which a covariance is computed.
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

/// A joint in the object frame, not yet numbered. The line of a joint on a moving part is carried
/// to the part's place at the first frame.
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
        undecided: is_undecided(geometry.kind, &type_probabilities),
        type_probabilities,
        ..Joint::of(&geometry)
    }
}

/// Poses of a joint's part in the base frame relative to the first frame, where the configuration
/// is known.
fn trajectory(search: &SearchState, index: usize) -> Trajectory {
    let joints = &search.joints;
    let rest = base_from_part(joints, index, 0).inverse();
    let mut trajectory: Trajectory = vec![None; search.recording.ego_motion.camera_from_base.len()];
    for f in joints[index].known_frames() {
        trajectory[f] = Some(base_from_part(joints, index, f) * rest);
    }
    trajectory
}

/// Covariance of (axis, origin) due to errors that all readings of a camera share.
fn systematic(joint: &JointEstimate) -> DMatrix<f64> {
    let across = Matrix3::identity() - joint.dof.axis * joint.dof.axis.transpose();
    let mut covariance = DMatrix::zeros(6, 6);
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&(across * SYSTEMATIC_RAD.powi(2)));
    if joint.dof.hinge {
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&(across * SYSTEMATIC_M.powi(2)));
    }
    covariance
}

/// Transforms a covariance of (axis, origin) to another frame. `reversed` is true if the axis
/// points the other way there.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::config::{JointSearchConfig, SearchSettings};
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_along;
    use crate::learn::joint_search::warm_start::WarmStart;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::recording::Recording;
    use crate::learn::tracking::{Track, TrackId, TrackSet};
    use crate::math::rigid::line_angle;
    use crate::object::joint_geometry::JointKind;
    use std::sync::Arc;

    const FRAMES: usize = 40;
    /// Points of each part.
    const POINTS: usize = 12;

    /// A door that turns, with a bolt on it that slides down later.
    fn door() -> ScrewJoint {
        ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5))
    }

    fn bolt() -> ScrewJoint {
        ScrewJoint::slide(Vector3::x(), Point3::new(0.4, 0.0, 1.5))
    }

    fn turn(f: usize) -> f64 {
        0.2 - 0.05 * f.min(20) as f64
    }

    fn slid(f: usize) -> f64 {
        0.01 * f.saturating_sub(20) as f64
    }

    fn places() -> Vec<Point3<f64>> {
        let at = |i: usize, y: f64| {
            Point3::new(0.1 + 0.04 * (i % 12) as f64, y + 0.03 * (i % 5) as f64, 1.5)
        };
        (0..POINTS).map(|i| at(i, -0.3)).chain((0..POINTS).map(|i| at(i, 0.2))).collect()
    }

    fn recording() -> Recording {
        let path = |(i, place): (usize, &Point3<f64>)| -> Vec<Point3<f64>> {
            let at = |f: usize| {
                let on_door = if i < POINTS { *place } else { bolt().move_point(slid(f), place) };
                door().move_point(turn(f), &on_door)
            };
            (0..FRAMES).map(at).collect()
        };
        let paths: Vec<_> = places().iter().enumerate().map(path).collect();
        let track = |id| Track { id: TrackId(id), first_frame: 0, observations: Vec::new() };
        let frame_utimes = (0..FRAMES as i64).map(|f| 100_000 * f).collect();
        let tracks = TrackSet { frame_utimes, tracks: (0..2 * POINTS).map(track).collect() };
        Recording { tracks, ego_motion: seen_along(&paths), keyframes: Keyframes::new(FRAMES) }
    }

    fn estimate(
        view: &TracksInFrame,
        dof: ScrewJoint,
        q: fn(usize) -> f64,
        members: std::ops::Range<usize>,
        parent: Option<usize>,
    ) -> JointEstimate {
        let mut joint = JointEstimate::new(dof, view, 0);
        joint.q = (0..FRAMES).map(q).collect();
        joint.known = (0..FRAMES).map(|f| f != 5).collect();
        joint.points = places();
        joint.members = members.collect();
        joint.parent = parent;
        joint.gain = 50.0;
        joint.summarise();
        joint
    }

    /// The door and the bolt, the door found first or last.
    fn learned(door_first: bool) -> Vec<LearnedJoint> {
        let recording = recording();
        let joints = JointSearchConfig::default();
        let settings = SearchSettings { joints: &joints, seed: 1 };
        let nothing = WarmStart::default();
        let view = Arc::new(TracksInFrame::moving(&recording.ego_motion));
        let mut search = SearchState::new(&recording, settings, &view, &nothing, None);
        search.joints = vec![estimate(&view, door(), turn, 0..POINTS, None)];
        search.renew_views(0);
        let on_door = Some(0);
        search.joints.push(estimate(&view, bolt(), slid, POINTS..2 * POINTS, on_door));
        search.renew_views(0);
        if !door_first {
            // The order of the joints does not determine which part carries which.
            let other = ScrewJoint::slide(Vector3::z(), Point3::new(0.0, 0.5, 1.5));
            search.joints.push(estimate(&view, other, slid, 0..POINTS, None));
            search.renew_views(0);
        }
        learned_joints(&search)
    }

    #[test]
    fn parents_come_before_children_and_each_joint_has_a_part_of_its_own() {
        let joints = learned(false);
        let all: Vec<(&str, usize, usize)> =
            joints.iter().map(|j| (j.joint.name.as_str(), j.joint.parent, j.joint.child)).collect();
        assert_eq!(all, [("joint1", 0, 1), ("joint2", 0, 2), ("joint3", 1, 3)]);
        assert_eq!(joints[2].joint.kind, JointKind::Prismatic);
        assert_eq!(joints[2].tracks, (POINTS..2 * POINTS).collect::<Vec<_>>());
    }

    #[test]
    fn configurations_begin_at_zero_and_grow_with_the_first_motion() {
        let door_joint = &learned(true)[0].joint;
        // It was estimated from 0.2 rad downwards: the axis is turned round.
        assert!(line_angle(&door_joint.axis.into(), &Vector3::y()) < 1e-9);
        assert!(door_joint.axis[1] < 0.0);
        assert_eq!(door_joint.configuration[0], [0.0, 0.0]);
        let [time, q] = *door_joint.configuration.last().unwrap();
        assert!((time - 3.9).abs() < 1e-9 && (q - 1.0).abs() < 1e-9);
        assert_eq!(door_joint.observations, FRAMES - 1, "one frame is not known");
        assert!(door_joint.range[0].abs() < 1e-9 && (door_joint.range[1] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_joint_on_a_moving_part_lies_where_the_part_is_in_the_first_frame() {
        let bolt_joint = &learned(true)[1].joint;
        let at_first = door().geometry().motion(turn(0));
        let axis = at_first * Vector3::x();
        assert!((Vector3::from(bolt_joint.axis) - axis).norm() < 1e-9);
        let middle: Vector3<f64> =
            places()[POINTS..].iter().map(|p| p.coords).sum::<Vector3<f64>>() / POINTS as f64;
        let origin = at_first * Point3::from(middle);
        assert!(
            (Point3::from(bolt_joint.origin) - origin).norm() < 1e-9,
            "the middle of its points"
        );
    }

    #[test]
    fn the_poses_of_a_part_take_its_points_from_the_first_frame_to_the_others() {
        let joints = learned(true);
        assert_eq!(joints[0].base_from_part[5], None);
        for f in [0, 12, 39] {
            let place = places()[POINTS];
            let at = |f: usize| door().move_point(turn(f), &bolt().move_point(slid(f), &place));
            let carried = joints[1].base_from_part[f].unwrap() * at(0);
            assert!((carried - at(f)).norm() < 1e-9, "frame {f}");
        }
    }

    #[test]
    fn residuals_are_the_noise_of_the_tracks() {
        // Each coordinate is up to 2 mm off, evenly spread.
        for joint in learned(true) {
            let expected = 0.002;
            let rmse = joint.joint.position_rmse;
            assert!((rmse - expected).abs() < 0.5 * expected, "{rmse}");
        }
    }

    #[test]
    fn a_covariance_turns_with_its_frame_and_an_axis_that_is_reversed_keeps_its_spread() {
        let mut covariance = DMatrix::zeros(6, 6);
        (covariance[(0, 0)], covariance[(3, 3)], covariance[(0, 3)]) = (4.0, 9.0, 1.0);
        covariance[(3, 0)] = 1.0;
        let quarter =
            Pose::new(Vector3::new(5.0, 6.0, 7.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
        let turned = carried(&covariance, &quarter, false);
        assert!((turned[(1, 1)] - 4.0).abs() < 1e-9 && (turned[(4, 4)] - 9.0).abs() < 1e-9);
        assert!((turned[(1, 4)] - 1.0).abs() < 1e-9 && turned[(0, 0)].abs() < 1e-9);
        let reversed = carried(&covariance, &quarter, true);
        assert!((reversed[(1, 1)] - 4.0).abs() < 1e-9 && (reversed[(1, 4)] + 1.0).abs() < 1e-9);
    }

    #[test]
    fn errors_that_all_readings_share_widen_a_hinge_in_place_and_a_slide_in_direction_alone() {
        let recording = recording();
        let view = TracksInFrame::moving(&recording.ego_motion);
        let of = |dof| systematic(&estimate(&view, dof, slid, 0..POINTS, None));
        let (hinge, slide) = (of(door()), of(bolt()));
        assert!((hinge[(0, 0)] - SYSTEMATIC_RAD.powi(2)).abs() < 1e-15);
        assert!((hinge[(3, 3)] - SYSTEMATIC_M.powi(2)).abs() < 1e-15);
        assert_eq!([hinge[(1, 1)], hinge[(4, 4)]], [0.0, 0.0], "along the axis");
        assert!((slide[(1, 1)] - SYSTEMATIC_RAD.powi(2)).abs() < 1e-15);
        assert!((3..6).all(|k| slide[(k, k)] == 0.0), "a slide has no place");
    }

    #[test]
    fn nothing_found_is_nothing_learned() {
        let recording = recording();
        let joints = JointSearchConfig::default();
        let settings = SearchSettings { joints: &joints, seed: 1 };
        let nothing = WarmStart::default();
        let view = Arc::new(TracksInFrame::moving(&recording.ego_motion));
        let search = SearchState::new(&recording, settings, &view, &nothing, None);
        assert!(learned_joints(&search).is_empty());
    }
}
