//! Configurations of a recognised object whose base is not in sight, by the room in which it was learned: a fridge
//! whose door is shut may show nothing but the door.
//!
//! The room counts only if the object was not moved since. Then the seen part is where its joint allows it to be, seen
//! from the place that the room gives; an object that was pushed or turned is there only by chance.
//!
//! In: a detection of which a moving part is seen and the base is not, and matches of the base and of its room.
//! Out: the detection with further configurations and their standard deviations (rad or m).
//! From: ours.

use super::evidence::Detection;
use super::kinematics::ChainJoint;
use super::matching::Match;
use super::refine::Refiner;
use super::room_search::by_room;
use super::verify::verify;
use crate::math::rigid::{Pose, rigid_fit};
use crate::object::joint_geometry::JointKind;
use nalgebra::{Point3, Vector3};

/// Largest distance between the seen part and the nearest place that its joint allows, metres, for an object that was
/// not moved: errors of the room's place and of the part's.
const STAYED_M: f64 = 0.025;
/// Largest rotation between the seen part and the nearest pose that its joint allows, radians.
const STAYED_RAD: f64 = 0.05;
/// Standard deviation of a hinge's configuration by a room that agrees exactly, radians.
const TURN_DEVIATION: f64 = 0.02;
/// Standard deviation of a slide's configuration by a room that agrees exactly, metres.
const SLIDE_DEVIATION: f64 = 0.006;

/// Adds the configurations that follow from the place of the base in its room. `matches`: those of the room and of the
/// object's own base.
pub fn add_by_room(refiner: &Refiner, matches: &[Match], seed: u64, found: &mut Detection) {
    let bases: Vec<Pose> =
        by_room(refiner, matches, seed).filter_map(|(_, room)| fitted(&room)).collect();
    for joint in 0..refiner.articulated.joints.len() {
        if let Some(told) = bases.iter().find_map(|base| told_from(refiner, found, joint, base)) {
            *found = told;
        }
    }
}

/// Pose of the base (camera_from_object) that fits the matches best, by their places.
fn fitted(matches: &[Match]) -> Option<Pose> {
    let of_match = |m: &Match| Some(((m.model_point, m.seen_point?), m.tolerance.powi(-2)));
    let (places, weights): (Vec<_>, Vec<f64>) = matches.iter().filter_map(of_match).unzip();
    let (model, seen): (Vec<_>, Vec<_>) = places.into_iter().unzip();
    rigid_fit(&model, &seen, &weights)
}

/// The detection with the configuration of one joint of the base, if a part that it moves is seen where the joint
/// allows it to be, and the image does not contradict the base there.
fn told_from(
    refiner: &Refiner,
    found: &Detection,
    joint: usize,
    camera_from_object: &Pose,
) -> Option<Detection> {
    let Refiner { scene, articulated, cloud, .. } = *refiner;
    let chained = &articulated.joints[joint];
    let part = chained.child;
    if found.evident[joint] || chained.parent != 0 || found.placed[0] || !found.placed[part] {
        return None;
    }
    let camera_from_part = articulated.poses(&found.state)[part];
    let centre = centre_of(part, refiner)?;
    let seen_from_base = camera_from_object.inverse() * camera_from_part;
    let (q, deviation) = configuration(chained, &seen_from_base, &centre)?;
    let mut configurations = found.state.q.clone();
    configurations[joint] = q;
    let state = articulated.state_with(part, &camera_from_part, configurations);
    let verdict = verify(scene, articulated, cloud, &state);
    if verdict.parts[0].is_missing() {
        return None;
    }
    let mut told = Detection {
        state,
        score: found.score,
        inliers: found.inliers,
        verdict,
        placed: found.placed.clone(),
        evident: found.evident.clone(),
        deviations: found.deviations.clone(),
    };
    told.deviations[joint] = Some(deviation);
    told.evident[joint] = true;
    tracing::debug!(joint, q, deviation, "by its room");
    Some(told)
}

/// Middle of the surface of a part at configuration 0, object frame.
fn centre_of(part: usize, refiner: &Refiner) -> Option<Point3<f64>> {
    let own = refiner.cloud.surfels.iter().filter(|s| s.part == part).map(|s| s.point.coords);
    let (sum, count) = own.fold((Vector3::zeros(), 0), |(sum, n), p| (sum + p, n + 1));
    (count > 0).then(|| Point3::from(sum / f64::from(count)))
}

/// Configuration at which a joint puts its part nearest to where it is seen, rad or m, and its standard deviation;
/// `None` if that is too far from where it is seen, or outside the joint's range. `centre`: of the part at
/// configuration 0, object frame, metres.
fn configuration(
    joint: &ChainJoint,
    object_from_part: &Pose,
    centre: &Point3<f64>,
) -> Option<(f64, f64)> {
    let geometry = &joint.geometry;
    let slides = geometry.kind == JointKind::Prismatic;
    let q = if slides {
        (object_from_part * centre - centre).dot(&geometry.axis)
    } else {
        object_from_part.rotation.scaled_axis().dot(&geometry.axis)
    };
    let beside = geometry.motion(q).inverse() * object_from_part;
    let turned = beside.rotation.angle();
    let moved = (beside * centre - centre).norm();
    let is_near = turned <= STAYED_RAD && moved <= STAYED_M;
    let deviation =
        if slides { SLIDE_DEVIATION.hypot(moved) } else { TURN_DEVIATION.hypot(turned) };
    (is_near && (joint.low..=joint.high).contains(&q)).then_some((q, deviation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::UnitQuaternion;

    /// A door 0.6 m wide, hinged at the left.
    fn door() -> (ChainJoint, Point3<f64>) {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(-0.3, 0.0, 1.5));
        (ChainJoint::new(hinge, [0, 1], [0.0, 1.4]), Point3::new(0.0, 0.0, 1.5))
    }

    fn pushed(by: Vector3<f64>, turned: f64) -> Pose {
        Pose::from_parts(by.into(), UnitQuaternion::from_scaled_axis(turned * Vector3::y()))
    }

    #[test]
    fn a_door_on_its_circle_stands_as_far_open_as_it_is_seen() {
        let (joint, centre) = door();
        for q in [0.0, 0.7, 1.4] {
            let seen = pushed(Vector3::new(0.004, 0.003, 0.0), 0.0) * joint.geometry.motion(q);
            let (told, deviation) = configuration(&joint, &seen, &centre).unwrap();
            assert!((told - q).abs() < 0.02 && deviation < 0.03, "{told} ± {deviation}");
        }
    }

    #[test]
    fn a_door_beside_its_circle_was_moved_with_its_fridge() {
        let (joint, centre) = door();
        let of =
            |moved: Pose| configuration(&joint, &(moved * joint.geometry.motion(0.3)), &centre);
        assert!(of(Pose::identity()).is_some());
        assert_eq!(of(pushed(0.05 * Vector3::z(), 0.0)), None);
        // The fridge was turned about its own middle, which does not lie on the hinge.
        let middle = Vector3::new(0.0, 0.0, 1.8);
        let about_middle = pushed(middle, 0.3) * Pose::translation(0.0, 0.0, -1.8);
        assert_eq!(of(about_middle), None);
    }

    #[test]
    fn outside_its_range_a_door_is_not_on_its_hinge() {
        let (joint, centre) = door();
        assert_eq!(configuration(&joint, &joint.geometry.motion(-0.4), &centre), None);
    }

    #[test]
    fn a_drawer_is_as_far_out_as_it_is_seen() {
        let line = JointGeometry::slide(-Vector3::z_axis(), Point3::origin());
        let (joint, centre) =
            (ChainJoint::new(line, [0, 1], [0.0, 0.4]), Point3::new(0.1, 0.2, 1.0));
        let seen = pushed(Vector3::new(0.003, 0.0, -0.2), 0.01);
        let (told, deviation) = configuration(&joint, &seen, &centre).unwrap();
        assert!((told - 0.2).abs() < 0.003 && deviation < 0.015, "{told} ± {deviation}");
        assert_eq!(configuration(&joint, &pushed(0.1 * Vector3::x(), 0.0), &centre), None);
    }
}
