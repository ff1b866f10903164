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
