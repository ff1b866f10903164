//! Configurations of hinges of a recognised object whose base is not in sight, by the room in which it was learned: a
//! fridge whose door is shut may show nothing but the door.
//!
//! The room counts only if the object was not moved since. If it was pushed or turned, its door is seen beside the
//! circle on which the hinge lets it move, unless the object was turned about the hinge itself. A drawer is not
//! treated: a cabinet that was pushed along the drawer looks like a cabinet whose drawer was moved.
//!
//! In: a detection of which moving parts are seen and the base is not, and matches of the base and of its room.
//! Out: the detection with further configurations and their standard deviations, radians.
//! From: ours.

use super::evidence::{Detection, told_within};
use super::kinematics::{Articulated, ChainJoint};
use super::matching::Match;
use super::refine::Refiner;
use super::render_cloud::Cloud;
use super::room_search::base_hypotheses;
use super::verdict::PartVerdict;
use super::verify::verify;
use crate::math::rigid::{Pose, rigid_fit};
use crate::object::joint_geometry::JointKind;
use nalgebra::{Point3, Vector3};
use std::f64::consts::TAU;

/// Largest distance between the seen part and the nearest place that its hinge allows, metres, for an object that was
/// not moved. The errors of the room's place and of the part's are about 1 cm each, 2 to 3 m away.
const STAYED_M: f64 = 0.025;
/// Largest rotation between the seen part and the nearest pose that its hinge allows, radians: errors as above, of
/// features that are some decimetres apart.
const STAYED_RAD: f64 = 0.05;
/// Standard deviation of a configuration by a room that agrees exactly, radians. Larger than the errors seen on
/// simulated things (0.001), because a real room's features are less exact.
const LEAST_DEVIATION: f64 = 0.02;

/// Adds the configurations that follow from the place of the base in its room. `matches`: those of the room and of the
/// object's own base.
pub fn add_configurations(refiner: &Refiner, matches: &[Match], seed: u64, found: &mut Detection) {
    let Refiner { scene, articulated, cloud, .. } = *refiner;
    for (_, room) in base_hypotheses(refiner, matches, seed) {
        let Some(camera_from_object) = fitted(&room) else { continue };
        let told = configurations(articulated, cloud, found, &camera_from_object);
        let Some(&(first, _, _)) = told.first() else { continue };
        let mut q = found.state.q.clone();
        told.iter().for_each(|&(joint, configuration, _)| q[joint] = configuration);
        let seen = articulated.joints[first].child;
        let camera_from_seen = articulated.poses(&found.state)[seen];
        let state = articulated.state_with(seen, &camera_from_seen, q);
        let verdict = verify(scene, articulated, cloud, &state);
        if verdict.parts.iter().any(PartVerdict::is_missing) {
            continue;
        }
        tracing::debug!(?told, "by its room");
        (found.state, found.verdict) = (state, verdict);
        for (joint, _, deviation) in told {
            found.deviations[joint] = Some(deviation);
            found.evident[joint] = true;
        }
        return;
    }
}

/// Pose of the base (camera_from_object) that fits the matches best, by their places.
fn fitted(matches: &[Match]) -> Option<Pose> {
    let of_match = |m: &Match| Some(((m.model_point, m.seen_point?), m.tolerance.powi(-2)));
    let (places, weights): (Vec<_>, Vec<f64>) = matches.iter().filter_map(of_match).unzip();
    let (model, seen): (Vec<_>, Vec<_>) = places.into_iter().unzip();
    rigid_fit(&model, &seen, &weights)
}

/// Each joint of an unseen base whose configuration is unknown and whose part is seen where the hinge allows it to be,
/// with its configuration and standard deviation, radians. Empty if the base is seen.
fn configurations(
    articulated: &Articulated,
    cloud: &Cloud,
    found: &Detection,
    camera_from_object: &Pose,
) -> Vec<(usize, f64, f64)> {
    let poses = articulated.poses(&found.state);
    let told = |(number, joint): (usize, &ChainJoint)| {
        let part = joint.child;
        let is_asked = !found.evident[number] && joint.parent == 0;
        if !is_asked || found.placed[0] || !found.placed[part] {
            return None;
        }
        let object_from_part = camera_from_object.inverse() * poses[part];
        let (q, deviation) = configuration(joint, &object_from_part, &centre_of(cloud, part)?)?;
        Some((number, q, deviation))
    };
    articulated.joints.iter().enumerate().filter_map(told).collect()
}

/// Middle of the surface of a part at configuration 0, object frame.
fn centre_of(cloud: &Cloud, part: usize) -> Option<Point3<f64>> {
    let own = cloud.surfels.iter().filter(|s| s.part == part).map(|s| s.point.coords);
    let (sum, count) = own.fold((Vector3::zeros(), 0), |(sum, n), p| (sum + p, n + 1));
    (count > 0).then(|| Point3::from(sum / f64::from(count)))
}

/// Configuration at which a hinge puts its part nearest to where it is seen, and its standard deviation, radians.
/// `None` if the joint is no hinge, if that is too far from where the part is seen, or if none or several turns of it
/// lie in the joint's range. `centre`: of the part at configuration 0, object frame, metres.
fn configuration(
    joint: &ChainJoint,
    object_from_part: &Pose,
    centre: &Point3<f64>,
) -> Option<(f64, f64)> {
    let hinge = &joint.geometry;
    if hinge.kind != JointKind::Revolute {
        return None;
    }
    let turn = object_from_part.rotation.scaled_axis().dot(&hinge.axis);
    let all = [-TAU, 0.0, TAU].map(|whole| turn + whole);
    let mut in_range = all.into_iter().filter(|q| (joint.low..=joint.high).contains(q));
    let (Some(q), None) = (in_range.next(), in_range.next()) else { return None };
    let beside = hinge.motion(q).inverse() * object_from_part;
    let (turned, moved) = (beside.rotation.angle(), (beside * centre - centre).norm());
    let lever = hinge.velocity(centre).norm();
    let deviation = LEAST_DEVIATION.hypot(turned).hypot(moved / lever);
    let is_told = turned <= STAYED_RAD && moved <= STAYED_M && deviation < told_within(hinge.kind);
    is_told.then_some((q, deviation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::kinematics::State;
    use crate::recognise::render_cloud::CloudPoint;
    use crate::recognise::verdict::Verdict;
    use nalgebra::UnitQuaternion;

    /// A door 0.6 m wide, hinged at the left, and its middle.
    fn door(range: [f64; 2]) -> (ChainJoint, Point3<f64>) {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(-0.3, 0.0, 1.5));
        (ChainJoint::new(hinge, [0, 1], range), Point3::new(0.0, 0.0, 1.5))
    }

    fn pushed(by: Vector3<f64>, turned: f64) -> Pose {
        Pose::from_parts(by.into(), UnitQuaternion::from_scaled_axis(turned * Vector3::y()))
    }

    #[test]
    fn a_door_on_its_circle_stands_as_far_open_as_it_is_seen() {
        let (joint, centre) = door([0.0, 3.8]);
        for q in [0.0, 0.7, 1.4, 3.8] {
            let seen = pushed(Vector3::new(0.004, 0.003, 0.0), 0.0) * joint.geometry.motion(q);
            let (told, deviation) = configuration(&joint, &seen, &centre).unwrap();
            assert!((told - q).abs() < 0.02 && deviation < 0.03, "{told} ± {deviation}");
        }
    }

    #[test]
    fn a_door_beside_its_circle_was_moved_with_its_fridge() {
        let (joint, centre) = door([0.0, 1.4]);
        let of =
            |moved: Pose| configuration(&joint, &(moved * joint.geometry.motion(0.3)), &centre);
        assert!(of(Pose::identity()).is_some());
        assert_eq!(of(pushed(0.05 * Vector3::z(), 0.0)), None);
        // The fridge was turned about its own middle, which does not lie on the hinge.
        let about_middle =
            pushed(Vector3::new(0.0, 0.0, 1.8), 0.3) * pushed(-1.8 * Vector3::z(), 0.0);
        assert_eq!(of(about_middle), None);
    }

    #[test]
    fn what_is_out_of_range_or_may_have_turned_once_more_or_slides_is_not_told() {
        let (joint, centre) = door([0.0, 1.4]);
        assert_eq!(configuration(&joint, &joint.geometry.motion(-0.4), &centre), None);
        let (wheel, centre) = door([0.0, 7.0]);
        assert_eq!(configuration(&wheel, &wheel.geometry.motion(0.3), &centre), None);
        let line = JointGeometry::slide(-Vector3::z_axis(), Point3::origin());
        let drawer = ChainJoint::new(line, [0, 1], [0.0, 0.4]);
        assert_eq!(configuration(&drawer, &line.motion(0.2), &centre), None);
    }

    /// Configurations of two doors of one cabinet, of which these parts are seen and these joints are known.
    fn told_of_doors(placed: [bool; 3], evident: [bool; 2]) -> Vec<usize> {
        let (left, _) = door([0.0, 1.4]);
        let hinge = JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.9, 0.0, 1.5));
        let right = ChainJoint::new(hinge, [0, 2], [0.0, 1.4]);
        let articulated = Articulated { parts: 3, joints: vec![left, right] };
        let surfel = |part, x| CloudPoint {
            part,
            point: Point3::new(x, 0.0, 1.5),
            normal: -Vector3::z(),
            lab: [50.0, 0.0, 0.0],
        };
        let found = Detection {
            state: State { camera_from_object: Pose::identity(), q: vec![0.2, 0.5] },
            score: 0.9,
            inliers: 9,
            verdict: Verdict::default(),
            placed: placed.to_vec(),
            evident: evident.to_vec(),
            deviations: vec![None; 2],
        };
        let cloud = Cloud::of(vec![surfel(1, 0.0), surfel(2, 0.6)]);
        let told = configurations(&articulated, &cloud, &found, &Pose::identity());
        assert!(told.iter().all(|(joint, q, _)| (q - [0.2, 0.5][*joint]).abs() < 1e-9), "{told:?}");
        told.into_iter().map(|(joint, _, _)| joint).collect()
    }

    #[test]
    fn each_seen_door_of_an_unseen_cabinet_is_told_unless_it_is_known() {
        assert_eq!(told_of_doors([false, true, true], [false, false]), [0, 1]);
        assert_eq!(told_of_doors([false, true, true], [false, true]), [0]);
        assert_eq!(told_of_doors([false, false, true], [false, false]), [1]);
        assert!(told_of_doors([true, true, true], [false, false]).is_empty());
    }
}
