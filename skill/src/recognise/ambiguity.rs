//! Detection of ambiguous configurations. A part may have the same appearance at each configuration of its joint,
//! like the round foot of a chair, or a plain board that slides in its own plane. Its configuration is reported only
//! if no other one explains the image about as well.
//!
//! In: a refined state and its evidence (camera frame, metres and radians).
//! Out: the evidence without the parts that could as well be elsewhere.

use super::evidence::{
    Detection, RefinedPose, configuration_deviations, evident_joints, told_within,
};
use super::hypothesis::fit_of_inliers;
use super::kinematics::State;
use super::refine::{FEATURE_WORTH, Refiner};
use super::shape::{EndsInSight, ends_in_sight};
use super::verdict::PartVerdict;
use super::verify::verify;
use rayon::prelude::*;

/// Number of configurations tried of a joint.
const STEPS: usize = 25;
/// Smallest share of the explained surfels at which another configuration counts as about as good.
const AS_GOOD: f64 = 0.9;

/// Detection of a state that was found by surface, in a room or by shape: a configuration is determined if the
/// surface gives it precisely and no other one explains the image about as well. `placed`: parts that are where the
/// state puts them.
pub fn told_by_surface(refiner: &Refiner, refined: RefinedPose, placed: Vec<bool>) -> Detection {
    let articulated = refiner.articulated;
    let RefinedPose { state, score, inliers, verdict } = refined;
    let deviations = configuration_deviations(articulated, &refiner.system(&state));
    let is_well_told: Vec<bool> = articulated
        .joints
        .iter()
        .zip(&deviations)
        .map(|(joint, deviation)| deviation.is_some_and(|d| d < told_within(joint.geometry.kind)))
        .collect();
    let well_told = |evident: Vec<bool>| -> Vec<bool> {
        evident.iter().zip(&is_well_told).map(|(evident, told)| *evident && *told).collect()
    };
    let evident = well_told(evident_joints(articulated, &placed));
    let mut found = Detection { state, score, inliers, verdict, placed, evident, deviations };
    if refiner.config.check_ambiguity {
        withdraw_ambiguous(refiner, &mut found, 0..articulated.joints.len());
        found.evident = well_told(std::mem::take(&mut found.evident));
    }
    found
}

/// Removes parts that could as well be elsewhere by one of these joints, and the configurations that depend on them.
pub fn withdraw_ambiguous(
    refiner: &Refiner,
    found: &mut Detection,
    joints: impl IntoIterator<Item = usize>,
) {
    for joint in joints {
        if found.evident[joint] {
            for part in ambiguous_parts(refiner, &found.state, joint) {
                found.placed[part] = false;
            }
        }
    }
    found.evident = evident_joints(refiner.articulated, &found.placed);
}

/// The parts on one side of a joint, if they fit the image about as well at another configuration; else none. The
/// side is the one that explains less, or the moving side if the room fixes the base.
fn ambiguous_parts(refiner: &Refiner, state: &State, joint: usize) -> Vec<usize> {
    let articulated = refiner.articulated;
    let j = &articulated.joints[joint];
    let moved = articulated.moved_by(joint);
    let (moving, resting): (Vec<usize>, Vec<usize>) =
        (0..articulated.parts).partition(|part| moved.contains(part));
    let by_part = explained(refiner, state);
    let of = |by_part: &[f64], parts: &[usize]| parts.iter().map(|&p| by_part[p]).sum::<f64>();
    let (of_moving, of_resting) = (of(&by_part, &moving), of(&by_part, &resting));
    let moving_is_weak = !refiner.room.is_empty() || of_moving < of_resting;
    let (weak, held) = if moving_is_weak { (moving, resting) } else { (resting, moving) };
    let camera_from_held = articulated.poses(state)[held[0]];
    let step = (j.high - j.low) / (STEPS - 1) as f64;
    let is_ambiguous = (0..STEPS)
        .into_par_iter()
        .map(|i| j.low + step * i as f64)
        .filter(|q| (q - state.q[joint]).abs() > told_within(j.geometry.kind))
        .any(|q| {
            let mut elsewhere = state.q.clone();
            elsewhere[joint] = q;
            let elsewhere = articulated.state_with(held[0], &camera_from_held, elsewhere);
            let explained = of(&explained(refiner, &elsewhere), &weak);
            // A configuration outside the demonstrated range is a weaker alternative.
            let penalty = articulated.range_penalty(&elsewhere) - articulated.range_penalty(state);
            explained - penalty.max(0.0) > AS_GOOD * of(&by_part, &weak)
        });
    if is_ambiguous { weak } else { Vec::new() }
}

/// How much of the image each part explains in a state, in surfels.
fn explained(refiner: &Refiner, state: &State) -> Vec<f64> {
    let Refiner { scene, articulated, cloud, matches, .. } = *refiner;
    let verdict = verify(scene, articulated, cloud, state);
    let by_features =
        |part: usize| FEATURE_WORTH * fit_of_inliers(articulated, matches, state, part);
    if let Some(contours) = refiner.shape {
        let in_sight = ends_in_sight(scene, articulated, cloud, contours.shape, state);
        let of_part = |(part, (seen, ends)): (usize, (&PartVerdict, &EndsInSight))| {
            // Furniture learned with the base may be missing now, so free space counts little against the base.
            let by_shape = seen.fit_of_shape(part == 0) + ends.closeness - ends.missing as f64;
            by_shape + by_features(part)
        };
        return verdict.parts.iter().zip(&in_sight).enumerate().map(of_part).collect();
    }
    let of_part = |(part, seen): (usize, &PartVerdict)| seen.fit() + by_features(part);
    verdict.parts.iter().enumerate().map(of_part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::config::RecogniseConfig;
    use crate::recognise::kinematics::{Articulated, ChainJoint};
    use crate::recognise::scene::Scene;
    use crate::recognise::test_data::{BOARD_M, PLATE_M, on_board, on_plate, slider_surface};
    use crate::test_data::seen;
    use nalgebra::{Point3, Vector3};

    /// The ambiguous parts of a board that slides to and fro before a plate, in a scene with this
    /// depth beside the board.
    fn ambiguous_beside(depth: impl Fn(f64, f64) -> f64) -> Vec<usize> {
        let frame = seen(0, |x, y| if on_board(x, y) { BOARD_M } else { depth(x, y) });
        let scene = Scene::plain(&frame).unwrap();
        let geometry = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let joints = vec![ChainJoint::new(geometry, [0, 1], [-0.1, 0.1])];
        let articulated = Articulated { parts: 2, joints };
        let cloud = slider_surface(|_| 50.0);
        let config = RecogniseConfig::default();
        let refiner = Refiner::by_surface(&scene, &articulated, &cloud, &config);
        let state = State { camera_from_object: Pose::identity(), q: vec![0.0] };
        ambiguous_parts(&refiner, &state, 0)
    }

    #[test]
    fn a_plate_that_ends_where_it_should_is_where_it_is() {
        let parts = ambiguous_beside(|x, y| if on_plate(x, y) { PLATE_M } else { 2.5 });
        assert!(parts.is_empty(), "{parts:?}");
    }

    #[test]
    fn a_plate_that_may_be_anywhere_on_a_wall_is_ambiguous() {
        assert_eq!(ambiguous_beside(|_, _| PLATE_M), [0]);
    }
}
