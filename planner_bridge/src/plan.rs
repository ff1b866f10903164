//! A prediction: the recognition, each joint's trajectory, and where the moving parts are
//! along it. Its JSON form is `linkage.prediction/1` (DESIGN 4.6).

use crate::limits::{Rig, Safety};
use crate::trajectory::{Knot, TrajectoryError, knots, time_optimal};
use linkage_realtime::{JointMotion, Motion, TooMuch};
use linkage_skill::articulate::JointKind;
use linkage_skill::geometry::{Pose, pose_to_array};
use linkage_skill::model::{Joint, ObjectModel};
use linkage_skill::predict::{Encountered, PredictError, Target};
use linkage_skill::recognise::{self, JointState, Recognised};
use nalgebra::{Matrix3, Point3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

/// Name and version of the JSON form.
pub const PREDICTION_SCHEMA: &str = "linkage.prediction/1";

/// A prediction that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The target or the joint.
    #[error(transparent)]
    Predict(#[from] PredictError),
    /// The motion in time.
    #[error("joint {joint}: {source}")]
    Trajectory {
        /// The joint.
        joint: String,
        /// Why.
        source: TrajectoryError,
    },
    /// What was learned is not sure enough for a robot.
    #[error("{joint} is not known well enough: {what}; demonstrate it again, over more of its way")]
    Uncertain {
        /// The joint.
        joint: String,
        /// What is not.
        what: String,
    },
    /// A grasp is given, and several parts move.
    #[error("{joints} joints move: name the one whose part the grasp is on")]
    WhoseGrasp {
        /// How many.
        joints: usize,
    },
}

/// What is to be predicted.
#[derive(Debug, Clone, Copy)]
pub struct Request<'r> {
    /// The joint to move; all whose configuration was seen where none is named.
    pub joint: Option<&'r str>,
    /// Where to.
    pub target: Target,
    /// What the gripper holds now, in the camera frame, metres; where the demonstrator's hand was
    /// if it is not given.
    pub grasp: Option<Point3<f64>>,
}

impl Request<'_> {
    /// All joints that were seen, to a target.
    pub fn to(target: Target) -> Self {
        Self { joint: None, target, grasp: None }
    }
}

/// A prediction with its exact motion in time.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// What is published.
    pub prediction: Prediction,
    /// What is streamed: joints that move.
    pub motions: Vec<JointMotion>,
}

/// A joint as recognised, with its planned motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedJoint {
    /// As recognised.
    #[serde(flatten)]
    pub state: JointState,
    /// `[t, q, qd, qdd]`; empty for a joint that stays as it is.
    pub trajectory: Vec<[f64; 4]>,
}

/// Where a part goes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedPart {
    /// Number of the part.
    pub part: usize,
    /// Its name.
    pub name: String,
    /// `[t, x, y, z, qx, qy, qz, qw]`: camera_from_part; part axes are the object's at
    /// configuration 0.
    pub poses: Vec<[f64; 8]>,
}

/// `linkage.prediction/1`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// [`PREDICTION_SCHEMA`].
    pub schema: String,
    /// The object.
    pub object: String,
    /// Score of the recognition.
    pub score: f64,
    /// Its inliers.
    pub inliers: usize,
    /// Pose of the object frame.
    pub camera_from_object: [f64; 7],
    /// As in [`Recognised`].
    #[serde(default = "recognise::yes", skip_serializing_if = "recognise::is_yes")]
    pub base_known: bool,
    /// Its joints.
    pub joints: Vec<PlannedJoint>,
    /// Its parts that move.
    pub parts: Vec<PlannedPart>,
    /// What a gripper holds on parts that move, with the parts' axes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub handles: Vec<PlannedPart>,
}

impl Plan {
    /// What the real-time half runs.
    ///
    /// # Errors
    /// [`TooMuch`] for more joints than it has room for, or an object of too long a name.
    pub fn motion(&self) -> Result<Motion, TooMuch> {
        let mut motion = Motion::new(&self.prediction.object)?;
        self.motions.iter().try_for_each(|joint| motion.push(joint.clone()))?;
        Ok(motion)
    }
}

/// Plans the motion of one joint (or of all that were seen) to a target. Joints move at the
/// same time, each as fast as the rig allows.
///
/// # Errors
/// [`PlanError`].
pub fn predict(
    model: &ObjectModel,
    recognised: &Recognised,
    request: &Request,
    rig: &Rig,
) -> Result<Plan, PlanError> {
    let encountered = Encountered::new(model, recognised)?;
    let mut moved: Vec<(usize, JointMotion)> = Vec::new();
    for m in encountered.motions(request.joint, request.target)? {
        let joint = &model.joints[m.joint];
        assure(joint, &rig.safety)?;
        let motion = time_optimal(&joint.name, m.from, m.to, rig.limits(joint.kind))
            .map_err(|source| PlanError::Trajectory { joint: joint.name.clone(), source })?;
        moved.push((m.joint, motion));
    }
    let planned_joints = recognised
        .joints
        .iter()
        .enumerate()
        .map(|(i, state)| PlannedJoint {
            state: state.clone(),
            trajectory: moved
                .iter()
                .find(|(j, _)| *j == i)
                .map(|(_, motion)| knots(motion).iter().map(|k| [k.t, k.q, k.qd, k.qdd]).collect())
                .unwrap_or_default(),
        })
        .collect();
    let ways = Ways::new(&encountered, &moved);
    let prediction = Prediction {
        schema: PREDICTION_SCHEMA.to_owned(),
        object: recognised.object.clone(),
        score: recognised.score,
        inliers: recognised.inliers,
        camera_from_object: recognised.camera_from_object,
        base_known: recognised.base_known,
        joints: planned_joints,
        handles: ways.handles(request, &moved)?,
        parts: ways.parts(),
    };
    Ok(Plan { prediction, motions: moved.into_iter().map(|(_, motion)| motion).collect() })
}

/// Refuses a joint that was not learned well enough.
fn assure(joint: &Joint, safety: &Safety) -> Result<(), PlanError> {
    let uncertain = |what: String| PlanError::Uncertain { joint: joint.name.clone(), what };
    if joint.undecided {
        return Err(uncertain(format!("{} is only its likeliest type", joint.kind.name())));
    }
    let block = |from: usize| {
        Matrix3::from_fn(|r, c| joint.covariance.get(from + r).map_or(0.0, |row| row[from + c]))
    };
    let deviation = |m: Matrix3<f64>| m.symmetric_eigenvalues().max().max(0.0).sqrt();
    let axis = deviation(block(0));
    if axis > safety.axis_deviation {
        let (is, limit) = (axis.to_degrees(), safety.axis_deviation.to_degrees());
        return Err(uncertain(format!("its axis deviates by {is:.1}°, {limit:.1}° are allowed")));
    }
    let along = Vector3::from(joint.axis);
    let across = Matrix3::identity() - along * along.transpose();
    let hinge = deviation(across * block(3) * across);
    if joint.kind != JointKind::Prismatic && hinge > safety.hinge_deviation {
        let (is, limit) = (100.0 * hinge, 100.0 * safety.hinge_deviation);
        return Err(uncertain(format!("its hinge deviates by {is:.1} cm, {limit:.1} are allowed")));
    }
    Ok(())
}

/// Where all parts are at the knots of the longest motion.
struct Ways<'e> {
    encountered: &'e Encountered<'e>,
    /// Parts that any of the moving joints carries.
    moved: Vec<bool>,
    /// Seconds, and camera_from_part of every part.
    knots: Vec<(f64, Vec<Pose>)>,
}

impl<'e> Ways<'e> {
    fn new(encountered: &'e Encountered<'e>, motions: &[(usize, JointMotion)]) -> Self {
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
    fn parts(&self) -> Vec<PlannedPart> {
        let moved = self.encountered.model().parts.iter().filter(|p| self.moved[p.id]);
        moved.map(|p| self.path(p.id, &Point3::origin())).collect()
    }

    /// Paths of what a gripper holds: the request's grasp, or the demonstrator's on each part.
    fn handles(
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

    /// The way of a point of a part.
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
pub(crate) mod tests {
    use super::*;
    use linkage_skill::articulate::{JointGeometry, JointKind};
    use linkage_skill::model::{Joint, MODEL_SCHEMA, Part, ReferenceFrame};

    pub fn fridge() -> (ObjectModel, Recognised) {
        let hinge = JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.4, 0.0, 1.1));
        let joint = Joint { range: [0.0, 1.5], observations: 100, ..Joint::of(&hinge) };
        let model = ObjectModel {
            schema: MODEL_SCHEMA.into(),
            object: "fridge".into(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: ["base", "part1"]
                .iter()
                .enumerate()
                .map(|(id, name)| Part::new(id, *name, 9))
                .collect(),
            joints: vec![joint],
            demonstrations: 1,
            profile: "default".into(),
            version: "0".into(),
        };
        let recognised = Recognised {
            object: "fridge".into(),
            score: 0.9,
            inliers: 40,
            camera_from_object: [0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0],
            base_known: true,
            joints: vec![JointState {
                name: "joint1".into(),
                kind: JointKind::Revolute,
                axis: [0.0, -1.0, 0.0],
                origin: [0.4, 0.0, 1.3],
                pitch: 0.0,
                configuration: Some(0.3),
                deviation: Some(0.01),
                reason: None,
                range: [0.0, 1.5],
            }],
            assumed: vec![0.3],
        };
        (model, recognised)
    }

    #[test]
    fn opening_starts_at_the_present_configuration_and_ends_at_the_range() {
        let (model, recognised) = fridge();
        let p = predict(&model, &recognised, &Request::to(Target::Open), &Rig::default())
            .unwrap()
            .prediction;
        let trajectory = &p.joints[0].trajectory;
        assert_eq!(trajectory[0], [0.0, 0.3, 0.0, 0.0]);
        assert_eq!(trajectory.last().unwrap()[1], 1.5);
        assert_eq!(p.parts.len(), 1);
        assert_eq!(p.parts[0].poses.len(), trajectory.len());
    }

    #[test]
    fn a_target_outside_the_learned_range_is_refused() {
        let (model, recognised) = fridge();
        let error = predict(&model, &recognised, &Request::to(Target::Value(2.5)), &Rig::default());
        let message = error.unwrap_err().to_string();
        assert!(message.contains("2.500 lies outside"), "{message}");
    }

    #[test]
    fn an_unknown_joint_is_named_with_what_there_is() {
        let (model, recognised) = fridge();
        let error = predict(
            &model,
            &recognised,
            &Request { joint: Some("lid"), ..Request::to(Target::Open) },
            &Rig::default(),
        );
        let message = error.unwrap_err().to_string();
        assert!(message.contains("\"lid\"") && message.contains("joint1"), "{message}");
    }

    #[test]
    fn a_target_outside_the_range_may_be_allowed() {
        let (model, recognised) = fridge();
        let request = Request::to(Target::Unseen(1.7));
        let plan = predict(&model, &recognised, &request, &Rig::default()).unwrap();
        assert_eq!(plan.prediction.joints[0].trajectory.last().unwrap()[1], 1.7);
    }

    #[test]
    fn a_joint_that_is_not_known_well_is_refused_with_what_is_not() {
        let refusal = |change: fn(&mut Joint)| {
            let (mut model, recognised) = fridge();
            change(&mut model.joints[0]);
            let plan = predict(&model, &recognised, &Request::to(Target::Open), &Rig::default());
            plan.unwrap_err().to_string()
        };
        assert!(refusal(|j| j.covariance[2][2] = 0.04).contains("axis deviates by 11.5°"));
        assert!(refusal(|j| j.covariance[5][5] = 0.0025).contains("hinge deviates by 5.0 cm"));
        assert!(refusal(|j| j.undecided = true).contains("revolute is only its likeliest type"));
    }

    #[test]
    fn a_handle_turns_about_the_hinge() {
        let (mut model, recognised) = fridge();
        let hinge = Vector3::new(0.4, 0.0, 1.3);
        let request = Request::to(Target::Open);
        let given = Request { grasp: Some(Point3::new(-0.1, 0.1, 1.3)), ..request };
        model.parts[1].grasp = Some([-0.1, 0.1, 1.1]);
        for request in [request, given] {
            let plan = predict(&model, &recognised, &request, &Rig::default()).unwrap();
            let [handle] = plan.prediction.handles.as_slice() else { panic!("one handle") };
            assert_eq!(handle.poses.len(), plan.prediction.joints[0].trajectory.len());
            let place = |k: &[f64; 8]| Vector3::new(k[1], k[2], k[3]);
            for pose in &handle.poses {
                let arm = place(pose) - hinge;
                assert!((arm.x.hypot(arm.z) - 0.5).abs() < 1e-9 && (arm.y - 0.1).abs() < 1e-9);
            }
            if request.grasp.is_some() {
                let start = place(&handle.poses[0]);
                assert!((start - Vector3::new(-0.1, 0.1, 1.3)).norm() < 1e-9);
            }
        }
    }
}
