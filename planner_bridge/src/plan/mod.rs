//! A plan: the prediction that is published, and the exact motion in time that is streamed.
//!
//! In: what was learned of an object, where it was recognised (camera frame, metres), what is asked
//! for, and the rig's limits. Out: a [`Plan`]; or why there is none, as a sentence.

mod certainty;
mod error;
mod joint_motions;
mod part_paths;
mod prediction;
mod request;
#[cfg(test)]
pub(crate) mod test_data;

pub use error::PlanError;
pub use prediction::{PREDICTION_SCHEMA, PlannedJoint, PlannedPart, Prediction};
pub use request::Request;

use crate::limits::Rig;
use crate::trajectory::knots;
use joint_motions::{asked_for, coming_to_rest};
use linkage_realtime::{JointMotion, Motion, MotionError, Moving};
use linkage_skill::object::ObjectModel;
use linkage_skill::predict::PredictionContext;
use linkage_skill::recognise::Recognised;
use part_paths::PartPaths;

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

#[cfg(test)]
mod tests {
    use super::test_data::fridge;
    use super::*;
    use crate::limits::Synchronisation;
    use linkage_skill::internals::covariance_rows;
    use linkage_skill::object::{Joint, Part};
    use linkage_skill::predict::Target;
    use linkage_skill::recognise::JointState;
    use nalgebra::{Matrix6, Point3, Vector3};

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
        assert!(refusal(|j| j.undecided = true).contains("its type, revolute, is not sure"));
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
