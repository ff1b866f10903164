//! Configurations of joints of a recognised object one side of which shows few features: the contour of that side tells
//! where it is.
//!
//! In: a detection by features, and the contours of the object and of the image.
//! Out: the detection with further configurations and their standard deviations, radians or metres.
//! From: ours; measured on the encounters of five lists (`README.md`).

use super::ambiguity::told_by_surface;
use super::evidence::{Detection, RefinedPose, told_within};
use super::hypothesis::Hypothesis;
use super::refine::Refiner;
use super::shape::{Contours, ends_in_sight};
use super::shape_search::placed_by_shape;
use super::verdict::PartVerdict;
use super::verify::verify;
use crate::math::rigid::Pose;

/// Largest standard deviation of a configuration that is added, as a share of the largest error of a configuration that
/// is reported. Six right ones had up to 0.33. Of a fridge whose base was not in sight, the two doors, which hang on
/// nearly one line, were both 2.5 degrees off, and had 0.44 and 0.46.
const WELL_TOLD: f64 = 0.4;
/// Largest distance between two poses of a part that count as one pose, metres.
const SAME_PLACE_M: f64 = 0.03;
/// Largest rotation between two poses of a part that count as one pose, radians.
const SAME_TURN_RAD: f64 = 0.06;

/// Adds configurations that the contour tells. What was determined before stays; nothing is added if the contour
/// contradicts it, or moves the part that features placed. (Where the contour replaced what features determined, one of
/// 80 configurations became better and two worse.)
pub fn add_configurations(refiner: &Refiner, contours: Contours, found: &mut Detection) {
    let Refiner { scene, articulated, cloud, .. } = *refiner;
    let Some(part) = (0..articulated.parts).find(|part| found.placed[*part]) else { return };
    let camera_from_part = articulated.poses(&found.state)[part];
    let Some(told) = with_contour(refiner, contours, found, part) else { return };
    let told_poses = articulated.poses(&told.state);
    let added = added_joints(refiner, &told, found);
    if added.is_empty() || !is_same_pose(&told_poses[part], &camera_from_part) {
        return;
    }
    let mut q = found.state.q.clone();
    added.iter().for_each(|joint| q[*joint] = told.state.q[*joint]);
    let state = articulated.state_with(part, &camera_from_part, q);
    let verdict = verify(scene, articulated, cloud, &state);
    if verdict.parts.iter().skip(1).any(PartVerdict::is_missing) {
        return;
    }
    for joint in added {
        found.deviations[joint] = told.deviations[joint];
        found.evident[joint] = true;
    }
    for (part, pose) in articulated.poses(&state).iter().enumerate() {
        found.placed[part] |= told.placed[part] && is_same_pose(pose, &told_poses[part]);
    }
    (found.state, found.verdict) = (state, verdict);
}

/// The detection aligned with the contours too, starting from a part that features placed; `None` if another object is
/// seen there.
fn with_contour(
    refiner: &Refiner,
    contours: Contours,
    found: &Detection,
    part: usize,
) -> Option<Detection> {
    let Refiner { scene, articulated, cloud, .. } = *refiner;
    let camera_from_part = articulated.poses(&found.state)[part];
    let hypothesis =
        Hypothesis { part, camera_from_part, state: found.state.clone(), support: found.inliers };
    let state = refiner.settle(&hypothesis)?;
    let verdict = verify(scene, articulated, cloud, &state);
    let in_sight = ends_in_sight(scene, articulated, cloud, contours.shape, &state);
    let by_shape = placed_by_shape(&verdict, &in_sight);
    tracing::debug!(q = ?state.q, ?by_shape, ?in_sight, ?verdict, "aligned with contours");
    let placed = found.placed.iter().zip(by_shape).map(|(was, is)| *was || is).collect();
    let refined = RefinedPose { state, score: found.score, inliers: found.inliers, verdict };
    Some(told_by_surface(refiner, refined, placed))
}

/// Joints that contours determine and features do not; none if one of them is not precise, or if the contours
/// contradict what features determined.
fn added_joints(refiner: &Refiner, told: &Detection, found: &Detection) -> Vec<usize> {
    let joints = &refiner.articulated.joints;
    let largest_error = |joint: usize| told_within(joints[joint].geometry.kind);
    let is_kept = |joint: &usize| {
        let apart = (told.state.q[*joint] - found.state.q[*joint]).abs();
        told.evident[*joint] && apart <= largest_error(*joint)
    };
    let is_well_told = |joint: &usize| {
        told.deviations[*joint].is_some_and(|d| d < WELL_TOLD * largest_error(*joint))
    };
    let (known, unknown): (Vec<usize>, Vec<usize>) =
        (0..joints.len()).partition(|joint| found.evident[*joint]);
    let added: Vec<usize> = unknown.into_iter().filter(|joint| told.evident[*joint]).collect();
    let is_certain = known.iter().all(is_kept) && added.iter().all(is_well_told);
    if is_certain { added } else { Vec::new() }
}

/// True if two poses of a part are the same up to their errors.
fn is_same_pose(a: &Pose, b: &Pose) -> bool {
    let apart = a.inverse() * b;
    apart.translation.vector.norm() < SAME_PLACE_M && apart.rotation.angle() < SAME_TURN_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recognise::kinematics::State;
    use crate::recognise::matching::Match;
    use crate::recognise::shape::test_data::look_for_plain_slider;
    use crate::recognise::test_data::{PLATE_M, detection};
    use nalgebra::{Point3, Vector3};

    /// Half the height of the plain board, metres, and how far it was slid.
    const BOARD: (f64, f64) = (0.2, 0.06);

    /// Twenty features of the plate, where they were learned.
    fn features_of_plate() -> Vec<Match> {
        let place = |k: u32| {
            let (x, y) = (-0.33 + 0.04 * f64::from(k % 5), -0.08 + 0.05 * f64::from(k / 5));
            Point3::new(x, y, PLATE_M)
        };
        let at = |place: Point3<f64>| Match {
            part: 0,
            model_point: place,
            model_normal: -Vector3::z(),
            seen_point: Some(place),
            seen_normal: -Vector3::z(),
            pixel: [0.0; 2],
            distance: 0.2,
            ratio: 0.5,
            tolerance: 0.01,
        };
        (0..20).map(place).map(at).collect()
    }

    /// What is determined of the slider, whose plate was seen by features `off` metres to the right of where it is, and
    /// whose board was taken to be at 0.03 m.
    fn completed(off: f64, is_board_told: bool) -> Detection {
        let (half, slid) = BOARD;
        let matches = features_of_plate();
        look_for_plain_slider(Some(half), slid, |refiner, contours| {
            let refiner = Refiner { matches: &matches, ..*refiner };
            let camera_from_object = Pose::translation(off, 0.0, 0.0);
            let state = State { camera_from_object, q: vec![0.03] };
            let verdict = verify(refiner.scene, refiner.articulated, refiner.cloud, &state);
            let mut found = detection(state, verdict, vec![true, is_board_told]);
            found.evident = vec![is_board_told];
            add_configurations(&refiner, contours, &mut found);
            found
        })
    }

    #[test]
    fn features_of_the_base_and_the_contour_of_a_plain_board_tell_how_far_it_is() {
        let found = completed(0.0, false);
        assert_eq!((&found.evident[..], &found.placed[..]), (&[true][..], &[true, true][..]));
        assert!((found.state.q[0] - BOARD.1).abs() < 0.01, "{:?}", found.state.q);
    }

    #[test]
    fn what_features_determined_is_not_replaced() {
        assert_eq!(completed(0.0, true).state.q, [0.03]);
    }

    #[test]
    fn nothing_is_added_where_the_contour_moves_the_part_that_features_placed() {
        let found = completed(0.05, false);
        assert_eq!((&found.evident[..], found.state.q[0]), (&[false][..], 0.03));
    }

    #[test]
    fn nothing_is_added_that_is_not_precise_or_that_contradicts_what_is_known() {
        let (half, slid) = BOARD;
        look_for_plain_slider(Some(half), slid, |refiner, _| {
            let state = |q: f64| State { camera_from_object: Pose::identity(), q: vec![q] };
            let at = |q: f64, is_told: bool, deviation: f64| {
                let verdict = verify(refiner.scene, refiner.articulated, refiner.cloud, &state(q));
                let mut found = detection(state(q), verdict, vec![true, is_told]);
                (found.evident, found.deviations) = (vec![is_told], vec![Some(deviation)]);
                found
            };
            let unknown = at(0.03, false, 1.0);
            assert_eq!(added_joints(refiner, &at(0.06, true, 0.005), &unknown), [0]);
            assert!(added_joints(refiner, &at(0.06, true, 0.012), &unknown).is_empty());
            assert!(
                added_joints(refiner, &at(0.06, true, 0.005), &at(0.03, true, 0.005)).is_empty()
            );
        });
    }
}
