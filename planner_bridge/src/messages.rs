//! Domain types to messages. A message is not a domain type: this is the only place that
//! knows both.

use crate::plan::{Plan, PlannedJoint, PlannedPart, Prediction};
use crate::trajectory::{Knot, knots};
use linkage_lcm::messages::{articulation, drake, linkage};
use linkage_realtime::JointMotion;
use linkage_skill::Pose;
use linkage_skill::internals::Trajectory;
use linkage_skill::learn::Demonstration;
use linkage_skill::object::{Joint, JointKind, ObjectModel};
use linkage_skill::recognise::{JointState, Recognised, Recognition};

/// Version of `linkage.model_t`: 2 has joints with a deviation and a reason.
pub const MODEL_MESSAGE_SCHEMA: i32 = 2;
/// Version of `linkage.status_t`: 2 tells the session.
pub const STATUS_MESSAGE_SCHEMA: i32 = 2;
/// Version of `linkage.recognition_t`: 2 tells whether the base is known, and why a configuration
/// is not; 3 tells each configuration's deviation.
pub const RECOGNITION_MESSAGE_SCHEMA: i32 = 3;
/// Version of `linkage.prediction_t`: 2 has handles, 3 a recognition of version 2, 4 one of
/// version 3 and the time at which it was made.
pub const PREDICTION_MESSAGE_SCHEMA: i32 = 4;

/// What a message says of a deviation that is not known.
const UNKNOWN_DEVIATION: f64 = -1.0;

/// Bytes of the long lists of a message: with the rest it stays below the 64 KiB that a UDP
/// datagram holds, beyond which losing any fragment would lose it all.
const LIST_BYTES: usize = 56 * 1024;
/// Bytes of a knot of a joint's trajectory, of a pose of a part's path, and of an original track.
const KNOT_BYTES: usize = 32;
const PATH_POSE_BYTES: usize = 64;
const TRACK_POSE_BYTES: usize = 76;

/// A given number of items of a list, evenly chosen, with both ends.
fn thinned<T: Copy>(list: &[T], keep: usize) -> Vec<T> {
    let keep = keep.max(2);
    if list.len() <= keep {
        return list.to_vec();
    }
    (0..keep).map(|i| list[i * (list.len() - 1) / (keep - 1)]).collect()
}

/// A number too large for its message stays the largest.
fn count(n: usize) -> i32 {
    i32::try_from(n).unwrap_or(i32::MAX)
}

/// A learned object.
pub fn model(model: &ObjectModel, utime: i64) -> linkage::Model {
    linkage::Model {
        utime,
        schema: MODEL_MESSAGE_SCHEMA,
        object: model.object.clone(),
        demonstrations: count(model.demonstrations),
        part_names: model.parts.iter().map(|p| p.name.clone()).collect(),
        joints: model.joints.iter().map(joint).collect(),
    }
}

fn joint(joint: &Joint) -> linkage::Joint {
    // Nothing is known where it is missing, which is not the same as nothing deviating.
    let mut covariance = [f64::INFINITY; 36];
    for (slot, value) in covariance.iter_mut().zip(joint.covariance.iter().flatten()) {
        *slot = *value;
    }
    linkage::Joint {
        name: joint.name.clone(),
        kind: joint.kind.name().to_owned(),
        parent: count(joint.parent),
        child: count(joint.child),
        axis: joint.axis,
        origin: joint.origin,
        pitch: joint.pitch,
        range: joint.range,
        configuration_known: joint.configuration.last().is_some(),
        configuration: joint.configuration.last().map_or(0.0, |c| c[1]),
        covariance,
        configuration_deviation: UNKNOWN_DEVIATION,
        reason: String::new(),
    }
}

/// A recognised object with its model, which knows the tree.
pub fn recognised(recognised: &Recognised, model: Option<&ObjectModel>) -> linkage::Match {
    let joints = recognised
        .joints
        .iter()
        .map(|state| joint_state(state, model.and_then(|m| m.joint(&state.name))))
        .collect();
    linkage::Match {
        object: recognised.object.clone(),
        score: recognised.score,
        inliers: count(recognised.inliers),
        camera_from_object: recognised.camera_from_object,
        base_known: recognised.base_known,
        joints,
        reasons: recognised.joints.iter().map(|j| j.reason.clone().unwrap_or_default()).collect(),
    }
}

fn joint_state(state: &JointState, learned: Option<&Joint>) -> linkage::Joint {
    let base = learned.map(joint).unwrap_or_default();
    linkage::Joint {
        name: state.name.clone(),
        kind: state.kind.name().to_owned(),
        axis: state.axis,
        origin: state.origin,
        pitch: state.pitch,
        range: state.range,
        configuration_known: state.configuration.is_some(),
        configuration: state.configuration.unwrap_or(0.0),
        configuration_deviation: state.deviation.unwrap_or(UNKNOWN_DEVIATION),
        reason: state.reason.clone().unwrap_or_default(),
        ..base
    }
}

/// All that was recognised.
pub fn recognition<'m>(
    recognition: &Recognition,
    model_of: impl Fn(&str) -> Option<&'m ObjectModel>,
    utime: i64,
) -> linkage::Recognition {
    linkage::Recognition {
        utime,
        schema: RECOGNITION_MESSAGE_SCHEMA,
        matches: recognition.matches.iter().map(|m| recognised(m, model_of(&m.object))).collect(),
    }
}

fn microseconds(seconds: f64) -> i64 {
    (seconds * 1e6).round() as i64
}

/// When a prediction comes from; microseconds since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    /// When the frame that it starts from was captured, by the camera's clock.
    pub captured: i64,
    /// When it was made, by the host's clock.
    pub made: i64,
}

/// A prediction; of long motions only as many knots as keep the message small.
pub fn prediction(
    prediction: &Prediction,
    model: &ObjectModel,
    stamps: Stamps,
) -> linkage::Prediction {
    let states: Vec<JointState> = prediction.joints.iter().map(|j| j.state.clone()).collect();
    let as_recognised = Recognised {
        object: prediction.object.clone(),
        score: prediction.score,
        inliers: prediction.inliers,
        camera_from_object: prediction.camera_from_object,
        base_known: prediction.base_known,
        joints: states,
        evidence: Vec::new(),
        assumed: Vec::new(),
    };
    let moving = || prediction.joints.iter().filter(|j| !j.trajectory.is_empty());
    let paths = || prediction.parts.iter().chain(&prediction.handles);
    let bytes: usize = moving().map(|j| KNOT_BYTES * j.trajectory.len()).sum::<usize>()
        + paths().map(|p| PATH_POSE_BYTES * p.poses.len()).sum::<usize>();
    let keep = |length: usize| (length * LIST_BYTES).checked_div(bytes).unwrap_or(length);
    let path = |part: &PlannedPart| {
        let poses = thinned(&part.poses, keep(part.poses.len()));
        linkage::PartPath {
            part: part.name.clone(),
            time_from_start_us: poses.iter().map(|k| microseconds(k[0])).collect(),
            poses: poses
                .iter()
                .map(|k| linkage::Pose {
                    position: [k[1], k[2], k[3]],
                    quaternion: [k[4], k[5], k[6], k[7]],
                })
                .collect(),
        }
    };
    let trajectory = |joint: &PlannedJoint| {
        let knots = thinned(&joint.trajectory, keep(joint.trajectory.len()));
        linkage::JointTrajectory {
            joint: joint.state.name.clone(),
            kind: joint.state.kind.name().to_owned(),
            time_from_start_us: knots.iter().map(|k| microseconds(k[0])).collect(),
            position: knots.iter().map(|k| k[1]).collect(),
            velocity: knots.iter().map(|k| k[2]).collect(),
            acceleration: knots.iter().map(|k| k[3]).collect(),
        }
    };
    linkage::Prediction {
        utime: stamps.captured,
        schema: PREDICTION_MESSAGE_SCHEMA,
        recognition: recognised(&as_recognised, Some(model)),
        trajectories: moving().map(trajectory).collect(),
        paths: prediction.parts.iter().map(path).collect(),
        handles: prediction.handles.iter().map(path).collect(),
        made_utime: stamps.made,
    }
}

/// A plan that a robot must not be given.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum PlanMessageError {
    /// Drake discards plans of fewer than two states.
    #[error("a plan needs two knots, this one has {found}")]
    TooFewKnots {
        /// Knots.
        found: usize,
    },
    /// Times must increase from 0, as microseconds.
    #[error("the time of knot {knot} does not increase")]
    Times {
        /// Its number.
        knot: usize,
    },
}

/// Drake's plan of the object's joints, named `<object>/<joint>`: at least two knots, times
/// from 0 and strictly increasing, positions rounded to single floats inside the range. Stamped, as
/// Drake's own, with the time at which it was made: the prediction that goes with it has the same.
///
/// # Errors
/// [`PlanMessageError`].
pub fn robot_plan(plan: &Plan, stamps: Stamps) -> Result<drake::LcmtRobotPlan, PlanMessageError> {
    let object = &plan.prediction.object;
    let longest = plan.motions.iter().max_by(|a, b| a.duration().total_cmp(&b.duration()));
    let knots = longest.map_or_else(Vec::new, knots);
    if knots.len() < 2 {
        return Err(PlanMessageError::TooFewKnots { found: knots.len() });
    }
    let names: Vec<String> =
        plan.motions.iter().map(|m| format!("{object}/{}", m.name())).collect();
    let state = |knot: &Knot| drake::LcmtRobotState {
        utime: microseconds(knot.t),
        joint_name: names.clone(),
        joint_position: plan.motions.iter().map(|m| single_inside(m, knot.t)).collect(),
    };
    let states: Vec<drake::LcmtRobotState> = knots.iter().map(state).collect();
    for (knot, pair) in states.windows(2).enumerate() {
        if pair[1].utime <= pair[0].utime || states[0].utime != 0 {
            return Err(PlanMessageError::Times { knot: knot + 1 });
        }
    }
    Ok(drake::LcmtRobotPlan { utime: stamps.made, plan: states })
}

/// A joint's configuration at a time as a single float, rounded towards the inside of what it moves
/// between: its ends, or its range where it goes beyond them.
fn single_inside(motion: &JointMotion, t: f64) -> f32 {
    let (from, to, exact) = (motion.at(0.0).position, motion.target(), motion.at(t).position);
    let ends = [from.min(to), from.max(to)];
    let is_between = (ends[0]..=ends[1]).contains(&exact);
    let [low, high] = if is_between { ends } else { motion.bounds().range };
    let rounded = exact as f32;
    if f64::from(rounded) > high {
        rounded.next_down()
    } else if f64::from(rounded) < low {
        rounded.next_up()
    } else {
        rounded
    }
}

/// The original system's message: parts as tracks of poses, joints as models with named parameters;
/// of long demonstrations only as many poses as keep the message small.
pub fn articulated_object(demonstration: &Demonstration) -> articulation::ArticulatedObjectMsg {
    let model = &demonstration.model;
    let tracks = model.parts.len() + model.joints.len();
    let keep = LIST_BYTES / (TRACK_POSE_BYTES * tracks);
    let parts: Vec<articulation::TrackMsg> = demonstration
        .camera_from_part
        .iter()
        .enumerate()
        .map(|(id, trajectory)| articulation::TrackMsg {
            id: id as i64,
            ..track(trajectory, &demonstration.frame_utimes, keep)
        })
        .collect();
    let models = model
        .joints
        .iter()
        .map(|j| articulation::ModelMsg {
            id: count(j.parent * model.parts.len() + j.child),
            name: original_name(j.kind).to_owned(),
            params: parameters(j),
            track: parts.get(j.child).cloned().unwrap_or_default(),
        })
        .collect();
    articulation::ArticulatedObjectMsg { parts, params: Vec::new(), models, markers: Vec::new() }
}

fn track(trajectory: &Trajectory, utimes: &[i64], keep: usize) -> articulation::TrackMsg {
    let known: Vec<(i64, Pose)> = utimes
        .iter()
        .zip(trajectory)
        .filter_map(|(utime, pose)| Some((*utime, (*pose)?)))
        .collect();
    let mut track = articulation::TrackMsg::default();
    for (utime, pose) in thinned(&known, keep) {
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        track.pose.push(articulation::PoseMsg {
            utime,
            id: track.pose.len() as i64,
            pos: t.into(),
            orientation: [q.w, q.i, q.j, q.k],
        });
        track.pose_flags.push(i32::from(articulation::TrackMsg::POSE_VISIBLE));
    }
    track
}

fn original_name(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Fixed => "rigid",
        JointKind::Prismatic => "prismatic",
        JointKind::Revolute | JointKind::Helical => "rotational",
        JointKind::Nonparametric => "pca_gp",
    }
}

fn parameters(joint: &Joint) -> Vec<articulation::ModelParamMsg> {
    let parameter = |name: &str, value: f64, kind: i8| articulation::ModelParamMsg {
        name: name.to_owned(),
        value: value as f32,
        r#type: kind,
    };
    let learned = articulation::ModelParamMsg::PARAM;
    let mut list = Vec::new();
    let mut vector = |name: &str, v: [f64; 3]| {
        for (axis, value) in ["x", "y", "z"].iter().zip(v) {
            list.push(parameter(&format!("{name}.{axis}"), value, learned));
        }
    };
    match joint.kind {
        JointKind::Prismatic => vector("prismatic_dir", joint.axis),
        JointKind::Revolute | JointKind::Helical => {
            vector("rot_center", joint.origin);
            // The original keeps the axis as the quaternion that turns z onto it.
            let z = nalgebra::Vector3::z();
            let axis = nalgebra::Vector3::from(joint.axis);
            let turn = nalgebra::UnitQuaternion::rotation_between(&z, &axis).unwrap_or_else(|| {
                nalgebra::UnitQuaternion::from_axis_angle(
                    &nalgebra::Vector3::x_axis(),
                    std::f64::consts::PI,
                )
            });
            vector("rot_axis", turn.imag().into());
            list.push(parameter("rot_axis.w", turn.w, learned));
            if joint.kind == JointKind::Helical {
                // The original knows no screws: what advances as it turns is said beside.
                list.push(parameter("rot_pitch", joint.pitch, learned));
            }
        }
        JointKind::Fixed | JointKind::Nonparametric => {}
    }
    let eval = articulation::ModelParamMsg::EVAL;
    list.push(parameter("q_min[0]", joint.range[0], eval));
    list.push(parameter("q_max[0]", joint.range[1], eval));
    list.push(parameter("bic", joint.bic, eval));
    list.push(parameter("loglikelihood", joint.log_likelihood, eval));
    list.push(parameter("avg_error_position", joint.position_rmse, eval));
    list.push(parameter("avg_error_orientation", joint.orientation_rmse, eval));
    list
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::Rig;
    use crate::plan::{Request, predict, test_data::fridge};
    use linkage_skill::predict::Target;
    use proptest::prelude::*;

    const STAMPS: Stamps = Stamps { captured: 77, made: 99 };

    /// A fridge's door from somewhere to somewhere, under limits.
    fn planned(from: f64, to: f64, rig: &Rig) -> Plan {
        let (model, mut recognised) = fridge();
        recognised.joints[0].configuration = Some(from);
        predict(&model, &recognised, &Request::to(Target::Value(to)), rig).unwrap()
    }

    #[test]
    fn what_is_not_known_is_told_with_its_reason() {
        let (model, mut found) = fridge();
        let told = recognised(&found, Some(&model));
        assert!(told.base_known && told.joints[0].configuration_known);
        assert_eq!(told.reasons, [""]);
        found.base_known = false;
        found.joints[0].configuration = None;
        found.joints[0].reason = Some("hidden".to_owned());
        let told = recognised(&found, Some(&model));
        assert!(!told.base_known && !told.joints[0].configuration_known);
        assert_eq!(told.reasons, ["hidden"]);
        assert_eq!(told.joints[0].reason, "hidden");
    }

    proptest! {
        #[test]
        fn a_plan_follows_drakes_rules_and_the_limits_as_it_is_received(
            from in 0.0..1.5_f64, to in 0.0..1.5_f64,
            velocity in 0.1..2.0_f64, acceleration in 0.2..4.0_f64, jerk in 1.0..20.0_f64,
        ) {
            let revolute = crate::limits::MotionLimits { velocity, acceleration, jerk };
            let rig = Rig { revolute, ..Rig::default() };
            let plan = robot_plan(&planned(from, to, &rig), STAMPS).unwrap();
            prop_assert!(plan.plan.len() >= 2 && plan.plan[0].utime == 0);
            let names_fit = plan.plan.iter().all(|s| s.joint_name == ["fridge/joint1"]);
            prop_assert!(names_fit);
            let mut before: Vec<(f64, f64)> = plan
                .plan
                .iter()
                .map(|s| (s.utime as f64 * 1e-6, f64::from(s.joint_position[0])))
                .collect();
            let inside = |q: f64| (from.min(to)..=from.max(to)).contains(&q);
            prop_assert!(before.iter().all(|k| inside(k.1) || (from - to).abs() < 1e-6));
            // Velocity, acceleration and jerk as differences of what is received.
            for limit in [velocity, acceleration, jerk] {
                before = before
                    .windows(2)
                    .map(|w| ((w[0].0 + w[1].0) / 2.0, (w[1].1 - w[0].1) / (w[1].0 - w[0].0)))
                    .collect();
                prop_assert!(before.iter().all(|d| d.1.abs() <= limit), "{:?} > {}", before, limit);
            }
        }
    }

    #[test]
    fn a_prediction_without_motion_is_no_plan() {
        let mut plan = planned(0.3, 1.5, &Rig::default());
        plan.motions.clear();
        assert_eq!(robot_plan(&plan, STAMPS), Err(PlanMessageError::TooFewKnots { found: 0 }));
    }

    #[test]
    fn the_message_carries_what_the_prediction_says() {
        let (model, _) = fridge();
        let p = planned(0.3, 1.5, &Rig::default()).prediction;
        let message = prediction(&p, &model, STAMPS);
        assert_eq!((message.utime, message.made_utime), (77, 99));
        let plan = planned(0.3, 1.5, &Rig::default());
        assert_eq!(robot_plan(&plan, STAMPS).unwrap().utime, message.made_utime);
        assert_eq!(message.trajectories[0].position.len(), p.joints[0].trajectory.len());
        assert_eq!(message.recognition.joints[0].child, 1);
        let bytes = linkage_lcm::encode(&message).unwrap();
        assert_eq!(linkage_lcm::decode::<linkage::Prediction>(&bytes).unwrap(), message);
    }

    #[test]
    fn a_long_prediction_stays_within_a_datagram_and_keeps_its_ends() {
        let (model, _) = fridge();
        let mut p = planned(0.3, 1.5, &Rig::default()).prediction;
        p.parts[0].poses = vec![p.parts[0].poses[0]; 2000];
        p.parts[0].poses[1999][0] = 40.0;
        p.handles = vec![p.parts[0].clone(); 3];
        let message = prediction(&p, &model, STAMPS);
        assert!(linkage_lcm::encode(&message).unwrap().len() < 64 * 1024);
        assert_eq!(message.handles[2].time_from_start_us.last(), Some(&40_000_000));
        assert_eq!(message.trajectories[0].position.last(), Some(&1.5));
    }

    #[test]
    fn the_real_time_half_writes_the_same_setpoint() {
        use linkage_realtime::{OrderQueue, Orders, Reason, Shared, Stream, Tick, Watch};
        let plan = planned(0.3, 1.5, &Rig::default());
        let (mut queue, shared) = (OrderQueue::new(), Shared::default());
        let (given, taken) = queue.split();
        let watch =
            Watch { frame_age_us: 500_000, heartbeat_age_us: None, longest_gap_us: 1_000_000 };
        let mut stream = Stream::new(taken, &shared, crate::channel::SETPOINT, watch);
        let mut orders = Orders::new(given, &shared);
        let motion = plan.motion().unwrap();
        orders.run(&motion, None).unwrap();
        let mut at = |due_us: u64, utime| {
            shared.frame_seen(due_us);
            let mut out = [0; linkage_realtime::DATAGRAM_CAPACITY];
            let Tick::Send(length) = stream.tick(due_us, utime, &mut out).unwrap() else {
                panic!("it moves")
            };
            let body = 8 + crate::channel::SETPOINT.len() + 1;
            linkage_lcm::decode::<linkage::Setpoint>(&out[body..length]).unwrap()
        };
        at(1_000_000, 0);
        let mut expected = plan.motions[0].at(0.5);
        let mut setpoint = linkage::Setpoint {
            utime: 77,
            schema: linkage_realtime::SETPOINT_SCHEMA,
            sequence: 1,
            last: false,
            object: "fridge".into(),
            joint_name: vec!["joint1".into()],
            position: vec![expected.position],
            velocity: vec![expected.velocity],
            acceleration: vec![expected.acceleration],
            reason: String::new(),
        };
        assert_eq!(at(1_500_000, 77), setpoint);
        orders.brake(Reason::Cancelled);
        expected = plan.motions[0].at(0.6);
        setpoint.position = vec![expected.position];
        setpoint.velocity = vec![expected.velocity];
        setpoint.acceleration = vec![expected.acceleration];
        (setpoint.utime, setpoint.sequence) = (78, 2);
        setpoint.reason = "cancelled".into();
        assert_eq!(at(1_600_000, 78), setpoint);
    }
}
