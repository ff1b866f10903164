//! Where the moving parts are, and what a gripper holds on them, along a motion.
//!
//! In: the object as it was encountered, the motions of its joints, a grasp in the camera frame or the
//! demonstrator's in the part's. Out: poses camera_from_part at the knots of the longest motion, metres,
//! with their times in seconds from its beginning.

use super::error::PlanError;
use super::prediction::PlannedPart;
use super::request::Request;
use crate::trajectory::{Knot, knots};
use linkage_realtime::JointMotion;
use linkage_skill::predict::PredictionContext;
use linkage_skill::{Pose, pose_to_array};
use nalgebra::{Point3, Translation3};

/// Where all parts are at the knots of the longest motion.
pub struct PartPaths<'e> {
    encountered: &'e PredictionContext<'e>,
    /// Parts that any of the moving joints carries.
    moved: Vec<bool>,
    /// Seconds, and camera_from_part of every part.
    knots: Vec<(f64, Vec<Pose>)>,
}

impl<'e> PartPaths<'e> {
    pub fn new(encountered: &'e PredictionContext<'e>, motions: &[(usize, JointMotion)]) -> Self {
        let model = encountered.model();
        let mut moved = vec![false; model.parts.len()];
        for (i, joint) in model.joints.iter().enumerate() {
            moved[joint.child] = moved[joint.parent] || motions.iter().any(|(j, _)| *j == i);
        }
        let longest = motions.iter().max_by(|a, b| a.1.duration().total_cmp(&b.1.duration()));
        let at = |knot: Knot| {
            let q: Vec<(usize, f64)> =
                motions.iter().map(|(j, motion)| (*j, motion.at(knot.t).position)).collect();
            (knot.t, encountered.part_poses(&q))
        };
        let knots = longest
            .map_or_else(Vec::new, |(_, motion)| knots(motion).into_iter().map(at).collect());
        Self { encountered, moved, knots }
    }

    /// Poses of the parts that move.
    pub fn parts(&self) -> Vec<PlannedPart> {
        let moved = self.encountered.model().parts.iter().filter(|p| self.moved[p.id]);
        moved.map(|p| self.path(p.id, &Point3::origin())).collect()
    }

    /// Paths of what a gripper holds: the request's grasp, or the demonstrator's on each part.
    pub fn handles(
        &self,
        request: &Request,
        motions: &[(usize, JointMotion)],
    ) -> Result<Vec<PlannedPart>, PlanError> {
        let model = self.encountered.model();
        let Some(grasp) = request.grasp else {
            let held = model.parts.iter().filter(|p| self.moved[p.id]);
            return Ok(held
                .filter_map(|p| Some(self.path(p.id, &Point3::from(p.grasp?))))
                .collect());
        };
        let [(joint, _)] = motions else {
            return Err(PlanError::WhoseGrasp { joints: motions.len() });
        };
        let part = model.joints[*joint].child;
        let camera_from_part = &self.encountered.part_poses(&[])[part];
        Ok(vec![self.path(part, &camera_from_part.inverse_transform_point(&grasp))])
    }

    /// The path of a point of a part.
    fn path(&self, part: usize, point: &Point3<f64>) -> PlannedPart {
        let to_point = Translation3::from(point.coords);
        let pose = |(t, camera_from_parts): &(f64, Vec<Pose>)| {
            let [x, y, z, qx, qy, qz, qw] = pose_to_array(&(camera_from_parts[part] * to_point));
            [*t, x, y, z, qx, qy, qz, qw]
        };
        let name = self.encountered.model().parts[part].name.clone();
        PlannedPart { part, name, poses: self.knots.iter().map(pose).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_data::fridge;
    use super::*;
    use crate::limits::Rig;
    use crate::trajectory::time_optimal;
    use linkage_skill::object::{Joint, ObjectModel, Part};
    use linkage_skill::predict::Target;
    use linkage_skill::recognise::JointState;

    /// A fridge with a drawer behind its door, and a flap on the door.
    fn larger_fridge() -> (ObjectModel, linkage_skill::recognise::Recognised) {
        let (mut model, mut recognised) = fridge();
        for (number, parent) in [(2, 1), (3, 0)] {
            model.parts.push(Part::new(number, format!("part{number}"), 9));
            let name = format!("joint{number}");
            let joint =
                Joint { name: name.clone(), parent, child: number, ..model.joints[0].clone() };
            model.joints.push(joint);
            recognised.joints.push(JointState { name, ..recognised.joints[0].clone() });
            recognised.assumed.push(0.3);
        }
        (model, recognised)
    }

    fn motion(name: &str, to: f64) -> JointMotion {
        let kind = linkage_skill::object::JointKind::Revolute;
        time_optimal(name, 0.3, to, Rig::default().limits(kind)).unwrap()
    }

    fn to_open(grasp: Option<Point3<f64>>) -> Request<'static> {
        Request { grasp, ..Request::to(Target::Open) }
    }

    #[test]
    fn what_hangs_on_a_part_goes_with_it_and_what_does_not_stays() {
        let (model, recognised) = larger_fridge();
        let encountered = PredictionContext::new(&model, &recognised).unwrap();
        let moved = |joint: usize| {
            let motions = [(joint, motion("a joint", 1.0))];
            let parts = PartPaths::new(&encountered, &motions).parts();
            parts.iter().map(|p| p.name.clone()).collect::<Vec<_>>()
        };
        assert_eq!(moved(0), ["part1", "part2"]);
        assert_eq!(moved(1), ["part2"]);
        assert_eq!(moved(2), ["part3"]);
    }

    #[test]
    fn all_parts_have_the_knots_of_the_longest_motion() {
        let (model, recognised) = larger_fridge();
        let encountered = PredictionContext::new(&model, &recognised).unwrap();
        let (long, short) = (motion("joint1", 1.5), motion("joint3", 0.4));
        assert!(long.duration() > short.duration());
        let times: Vec<f64> = knots(&long).iter().map(|k| k.t).collect();
        for part in PartPaths::new(&encountered, &[(2, short), (0, long)]).parts() {
            assert_eq!(part.poses.iter().map(|pose| pose[0]).collect::<Vec<_>>(), times);
        }
    }

    #[test]
    fn a_path_begins_where_the_part_is_seen_and_keeps_to_its_hinge() {
        let (model, recognised) = fridge();
        let encountered = PredictionContext::new(&model, &recognised).unwrap();
        let paths = PartPaths::new(&encountered, &[(0, motion("joint1", 1.5))]);
        let [door] = &paths.parts()[..] else { panic!("one part") };
        let expected = pose_to_array(&encountered.part_poses(&[(0, 0.3)])[1]);
        assert!(door.poses[0][1..].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9));
        let last = pose_to_array(&encountered.part_poses(&[(0, 1.5)])[1]);
        let end = door.poses.last().unwrap();
        assert!(end[1..].iter().zip(last).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn without_motions_nothing_moves_and_nothing_is_held() {
        let (model, recognised) = fridge();
        let encountered = PredictionContext::new(&model, &recognised).unwrap();
        let paths = PartPaths::new(&encountered, &[]);
        assert!(paths.parts().is_empty());
        assert!(paths.handles(&to_open(None), &[]).unwrap().is_empty());
    }

    #[test]
    fn a_grasp_is_on_the_part_of_one_joint_and_refused_where_several_move() {
        let (model, recognised) = larger_fridge();
        let encountered = PredictionContext::new(&model, &recognised).unwrap();
        let one = vec![(2, motion("joint3", 1.0))];
        let grasp = Some(Point3::new(-0.1, 0.1, 1.3));
        let held = PartPaths::new(&encountered, &one).handles(&to_open(grasp), &one).unwrap();
        assert_eq!((held.len(), held[0].part), (1, 3));
        let two = [one, vec![(0, motion("joint1", 1.0))]].concat();
        let refused = PartPaths::new(&encountered, &two).handles(&to_open(grasp), &two);
        assert!(matches!(refused, Err(PlanError::WhoseGrasp { joints: 2 })));
    }
}
