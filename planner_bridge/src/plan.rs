//! A prediction: the recognition, each joint's trajectory, and where the moving parts are
//! along it. Its JSON form is `linkage.prediction/1`.

use crate::joint_deviation::{axis_deviation_rad, hinge_deviation_m};
use crate::limits::{Rig, Safety};
use crate::trajectory::{Knot, Task, TrajectoryError, knots, together};
use linkage_realtime::{JointMotion, Motion, MotionError, Moving};
use linkage_skill::object::{Joint, JointKind, ObjectModel};
use linkage_skill::predict::{PredictError, PredictionContext, Target};
use linkage_skill::recognise::{JointState, Recognised};
use linkage_skill::{Pose, internals, pose_to_array};
use nalgebra::{Point3, Translation3};
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
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// Another object moves.
    #[error("{object} moves; it comes to rest first")]
    OtherMoves {
        /// What moves.
        object: String,
    },
    /// What was learned is not sure enough for a robot.
    #[error("{joint} is not known well enough: {what}; demonstrate it again, over more of its way")]
    Uncertain {
        /// The joint.
        joint: String,
        /// What is not.
        what: String,
    },
    /// Where it is now was not seen well enough for a robot.
    #[error("the present configuration of {joint} is not known well enough: {what}")]
    Unclear {
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
    /// What is commanded now, where the object is being moved: the plan goes on from there.
    pub moving: Option<&'r Moving>,
}

impl Request<'_> {
    /// All joints that were seen, from rest to a target.
    pub fn to(target: Target) -> Self {
        Self { joint: None, target, grasp: None, moving: None }
    }
}

/// A prediction with its exact motion in time.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// What is published.
    pub prediction: Prediction,
    /// What is streamed: joints that move.
    pub motions: Vec<JointMotion>,
    /// When it begins, microseconds of the stream's clock, where it goes on from a motion.
    pub start_us: Option<u64>,
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
    #[serde(default = "internals::yes", skip_serializing_if = "internals::is_yes")]
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
    /// [`MotionError`] for more joints than it has room for, or an object of too long a name.
    pub fn motion(&self) -> Result<Motion, MotionError> {
        let mut motion = Motion::new(&self.prediction.object)?;
        self.motions.iter().try_for_each(|joint| motion.push(joint.clone()))?;
        Ok(motion)
    }
}

/// Plans the motion of one joint (or of all that were seen) to a target, as the rig has it: each
/// joint as fast as it may, or all arriving at once. Where the object is being moved, joints go on
/// from what is commanded, and those that are not asked for come to rest.
///
/// # Errors
/// [`PlanError`].
pub fn predict(
    model: &ObjectModel,
    recognised: &Recognised,
    request: &Request,
    rig: &Rig,
) -> Result<Plan, PlanError> {
    if let Some(moving) = request.moving
        && moving.object() != recognised.object
    {
        return Err(PlanError::OtherMoves { object: moving.object().to_owned() });
    }
    let encountered = PredictionContext::new(model, recognised)?;
    let asked = asked_for(&encountered, recognised, request, rig)?;
    let stopped = coming_to_rest(model, request, &asked, rig)?;
    let moved = [asked.as_slice(), &stopped].concat();
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
    let paths = PartPaths::new(&encountered, &moved);
    let prediction = Prediction {
        schema: PREDICTION_SCHEMA.to_owned(),
        object: recognised.object.clone(),
        score: recognised.score,
        inliers: recognised.inliers,
        camera_from_object: recognised.camera_from_object,
        base_known: recognised.base_known,
        joints: planned_joints,
        handles: paths.handles(request, &asked)?,
        parts: paths.parts(),
    };
    let motions = moved.into_iter().map(|(_, motion)| motion).collect();
    Ok(Plan { prediction, motions, start_us: request.moving.map(Moving::at_us) })
}

/// Motions of the joints that are asked for, with their numbers in the model.
fn asked_for(
    encountered: &PredictionContext,
    recognised: &Recognised,
    request: &Request,
    rig: &Rig,
) -> Result<Vec<(usize, JointMotion)>, PlanError> {
    let model = encountered.model();
    let wanted = encountered.motions(request.joint, request.target)?;
    let mut tasks = Vec::with_capacity(wanted.len());
    for m in &wanted {
        let joint = &model.joints[m.joint];
        assure(joint, &rig.safety)?;
        assure_configuration(joint, recognised.joints[m.joint].deviation, &rig.safety)?;
        let limits = *rig.limits(joint.kind);
        tasks.push(match request.moving.and_then(|moving| moving.joint(&joint.name)) {
            Some(now) => Task::within(&joint.name, now, m.to, limits, joint.range),
            None => Task::between(&joint.name, m.from, m.to, limits),
        });
    }
    let motions = together(&tasks, rig.streaming.synchronisation)?;
    Ok(wanted.iter().map(|m| m.joint).zip(motions).collect())
}

/// Motions of the joints that move, or have just come to rest, and are not asked for.
fn coming_to_rest(
    model: &ObjectModel,
    request: &Request,
    asked: &[(usize, JointMotion)],
    rig: &Rig,
) -> Result<Vec<(usize, JointMotion)>, PlanError> {
    let mut stopped = Vec::new();
    for (motion, now) in request.moving.into_iter().flat_map(Moving::unsettled) {
        let number = model.joints.iter().position(|j| j.name == motion.name());
        let Some(number) = number.filter(|n| asked.iter().all(|(a, _)| a != n)) else { continue };
        let joint = &model.joints[number];
        let limits = *rig.limits(joint.kind);
        let task = Task::within(&joint.name, now, now.position, limits, motion.bounds().range);
        stopped.push((number, task.stopping()?));
    }
    Ok(stopped)
}

/// Refuses a joint that was not learned well enough.
fn assure(joint: &Joint, safety: &Safety) -> Result<(), PlanError> {
    let uncertain = |what: String| PlanError::Uncertain { joint: joint.name.clone(), what };
    if joint.undecided {
        return Err(uncertain(format!("{} is only its likeliest type", joint.kind.name())));
    }
    if joint.kind == JointKind::Fixed {
        return Ok(());
    }
    let axis = axis_deviation_rad(joint)
        .ok_or_else(|| uncertain("how far its axis deviates is not known".to_owned()))?;
    if axis > safety.axis_deviation {
        let (is, limit) = (axis.to_degrees(), safety.axis_deviation.to_degrees());
        return Err(uncertain(format!("its axis deviates by {is:.1}°, {limit:.1}° are allowed")));
    }
    if joint.kind == JointKind::Prismatic {
        return Ok(());
    }
    let hinge = hinge_deviation_m(joint)
        .ok_or_else(|| uncertain("how far its hinge deviates is not known".to_owned()))?;
    if hinge > safety.hinge_deviation {
        let (is, limit) = (100.0 * hinge, 100.0 * safety.hinge_deviation);
        return Err(uncertain(format!("its hinge deviates by {is:.1} cm, {limit:.1} are allowed")));
    }
    Ok(())
}

/// Refuses a joint whose present configuration was not seen well enough.
fn assure_configuration(
    joint: &Joint,
    deviation: Option<f64>,
    safety: &Safety,
) -> Result<(), PlanError> {
    let unclear = |what: String| PlanError::Unclear { joint: joint.name.clone(), what };
    let deviation = deviation
        .filter(|deviation| deviation.is_finite() && *deviation > 0.0)
        .ok_or_else(|| unclear("how far it deviates is not known".to_owned()))?;
    match joint.kind {
        JointKind::Revolute | JointKind::Helical if deviation > safety.angle_deviation => {
            let (is, limit) = (deviation.to_degrees(), safety.angle_deviation.to_degrees());
            Err(unclear(format!("it deviates by {is:.1}°, {limit:.1}° are allowed")))
        }
        JointKind::Prismatic | JointKind::Nonparametric if deviation > safety.offset_deviation => {
            let (is, limit) = (100.0 * deviation, 100.0 * safety.offset_deviation);
            Err(unclear(format!("it deviates by {is:.1} cm, {limit:.1} are allowed")))
        }
        _ => Ok(()),
    }
}

/// Where all parts are at the knots of the longest motion.
struct PartPaths<'e> {
    encountered: &'e PredictionContext<'e>,
    /// Parts that any of the moving joints carries.
    moved: Vec<bool>,
    /// Seconds, and camera_from_part of every part.
    knots: Vec<(f64, Vec<Pose>)>,
}

impl<'e> PartPaths<'e> {
    fn new(encountered: &'e PredictionContext<'e>, motions: &[(usize, JointMotion)]) -> Self {
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
pub(crate) mod tests {
    use super::*;
    use crate::limits::Synchronisation;
    use linkage_skill::internals::covariance_rows;
    use linkage_skill::object::{
        Joint, JointGeometry, JointKind, MODEL_SCHEMA, Part, ReferenceFrame,
    };
    use nalgebra::{Matrix6, Vector3};

    pub fn fridge() -> (ObjectModel, Recognised) {
        let hinge = JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.4, 0.0, 1.1));
        let joint = Joint {
            range: [0.0, 1.5],
            observations: 100,
            covariance: covariance_rows(&(Matrix6::identity() * 1e-6)),
            ..Joint::of(&hinge)
        };
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
    fn a_covariance_that_says_nothing_is_refused_and_is_not_certainty() {
        let nothing: [fn(&mut Joint); 8] = [
            |j| j.covariance.clear(),
            |j| j.covariance.truncate(3),
            |j| j.covariance = vec![[0.0; 6]; 6],
            |j| j.covariance[0][0] = 0.0,
            |j| j.covariance[2][2] = -1e-6,
            |j| j.covariance[5][5] = 0.0,
            |j| j.covariance[3][3] = f64::NAN,
            |j| j.covariance[1][1] = f64::INFINITY,
        ];
        for (i, change) in nothing.into_iter().enumerate() {
            let (mut model, recognised) = fridge();
            change(&mut model.joints[0]);
            let plan = predict(&model, &recognised, &Request::to(Target::Open), &Rig::default());
            let said = plan.map(|_| i).unwrap_err().to_string();
            assert!(said.contains("is not known"), "{i}: {said}");
        }
    }

    #[test]
    fn a_covariance_without_extent_along_the_axis_is_one() {
        // An axis is a unit vector, and a point may lie anywhere along it: neither has a variance
        // in that direction.
        let (mut model, recognised) = fridge();
        let across = Vector3::new(1e-6, 0.0, 1e-6);
        let rows = Matrix6::from_diagonal(&nalgebra::Vector6::new(
            across.x, across.y, across.z, across.x, across.y, across.z,
        ));
        model.joints[0].covariance = covariance_rows(&rows);
        let request = Request::to(Target::Open);
        assert!(predict(&model, &recognised, &request, &Rig::default()).is_ok());
    }

    #[test]
    fn a_configuration_that_was_not_seen_well_is_refused_with_how_far_it_deviates() {
        let (model, _) = fridge();
        let hinge = &model.joints[0];
        let slide = Joint { kind: JointKind::Prismatic, ..hinge.clone() };
        let safety = Rig::default().safety;
        let said = |joint: &Joint, deviation: f64| {
            assure_configuration(joint, Some(deviation), &safety).map_err(|e| e.to_string())
        };
        assert_eq!(said(hinge, 0.04), Ok(()));
        assert!(said(hinge, 0.2).unwrap_err().contains("deviates by 11.5°, 2.9° are allowed"));
        assert_eq!(said(&slide, 0.01), Ok(()));
        assert!(said(&slide, 0.04).unwrap_err().contains("deviates by 4.0 cm, 2.0 are allowed"));
        for nothing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(said(hinge, nothing).unwrap_err().contains("is not known"));
        }
        assert!(assure_configuration(hinge, None, &safety).is_err());
    }

    /// What the fridge is commanded to do half a second after its opening began.
    fn opening() -> Moving {
        let (model, recognised) = fridge();
        let request = Request::to(Target::Open);
        let plan = predict(&model, &recognised, &request, &Rig::default()).unwrap();
        Moving::new(plan.motion().unwrap(), 0.5, 7_000_000)
    }

    #[test]
    fn another_target_while_it_moves_goes_on_from_what_is_commanded() {
        // The camera lags behind: the plan starts from the command, not from the frame.
        let (model, recognised) = fridge();
        let moving = opening();
        let request = Request { moving: Some(&moving), ..Request::to(Target::Closed) };
        let plan = predict(&model, &recognised, &request, &Rig::default()).unwrap();
        let now = moving.joint("joint1").unwrap();
        assert!(now.velocity > 0.2);
        assert_eq!(plan.motions[0].at(0.0), now);
        assert_eq!((plan.motions[0].target(), plan.start_us), (0.0, Some(7_000_000)));
        assert_eq!(plan.prediction.joints[0].trajectory[0][2], now.velocity);
    }

    #[test]
    fn a_joint_that_moves_and_is_not_asked_for_comes_to_rest() {
        let (mut model, mut recognised) = fridge();
        let second =
            Joint { name: "joint2".into(), parent: 1, child: 2, ..model.joints[0].clone() };
        model.parts.push(Part::new(2, "part2", 9));
        model.joints.push(second);
        let mut state = recognised.joints[0].clone();
        state.name = "joint2".into();
        recognised.joints.push(state);
        let moving = opening();
        let request =
            Request { joint: Some("joint2"), moving: Some(&moving), ..Request::to(Target::Open) };
        let plan = predict(&model, &recognised, &request, &Rig::default()).unwrap();
        let names: Vec<&str> = plan.motions.iter().map(JointMotion::name).collect();
        assert_eq!(names, ["joint2", "joint1"]);
        let stop = &plan.motions[1];
        assert_eq!(stop.at(0.0), moving.joint("joint1").unwrap());
        assert!(stop.duration() < 1.0 && stop.target() < 1.0);
    }

    #[test]
    fn joints_move_together_as_the_rig_has_it() {
        let (mut model, mut recognised) = fridge();
        let hinge = model.joints[0].clone();
        let second = Joint { name: "joint2".into(), child: 2, range: [0.0, 0.5], ..hinge };
        model.parts.push(Part::new(2, "part2", 9));
        model.joints.push(second);
        let state = recognised.joints[0].clone();
        recognised.joints.push(JointState { name: "joint2".into(), range: [0.0, 0.5], ..state });
        let durations = |synchronisation: Synchronisation| {
            let mut rig = Rig::default();
            rig.streaming.synchronisation = synchronisation;
            let plan = predict(&model, &recognised, &Request::to(Target::Open), &rig).unwrap();
            [plan.motions[0].duration(), plan.motions[1].duration()]
        };
        let [far, near] = durations(Synchronisation::Independent);
        assert!(far > 2.0 * near, "{far} s and {near} s");
        for together in [Synchronisation::Time, Synchronisation::Phase] {
            let [first, second] = durations(together);
            assert!((first - second).abs() < 1e-9 && first >= far - 1e-9);
        }
    }

    #[test]
    fn nothing_is_planned_while_another_object_moves() {
        let (model, recognised) = fridge();
        let moving = Moving::new(Motion::new("drawer").unwrap(), 0.0, 0);
        let request = Request { moving: Some(&moving), ..Request::to(Target::Open) };
        let refused = predict(&model, &recognised, &request, &Rig::default()).unwrap_err();
        assert!(refused.to_string().contains("drawer moves"), "{refused}");
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
