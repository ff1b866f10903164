//! Domain types to messages. A message is not a domain type: this is the only place that
//! knows both.

use crate::plan::Prediction;
use linkage_lcm::messages::{articulation, drake, linkage};
use linkage_skill::articulate::JointKind;
use linkage_skill::learn::Demonstration;
use linkage_skill::model::{Joint, ObjectModel};
use linkage_skill::recognise::{JointState, Recognised, Recognition};

/// Version of our own messages.
pub const MESSAGE_SCHEMA: i32 = 1;

/// A number too large for its message stays the largest.
fn count(n: usize) -> i32 {
    i32::try_from(n).unwrap_or(i32::MAX)
}

/// A learned object.
pub fn model(model: &ObjectModel, utime: i64) -> linkage::Model {
    linkage::Model {
        utime,
        schema: MESSAGE_SCHEMA,
        object: model.object.clone(),
        demonstrations: count(model.demonstrations),
        part_names: model.parts.iter().map(|p| p.name.clone()).collect(),
        joints: model.joints.iter().map(joint).collect(),
    }
}

fn joint(joint: &Joint) -> linkage::Joint {
    let mut covariance = [0.0; 36];
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
        joints,
    }
}

fn joint_state(state: &JointState, learned: Option<&Joint>) -> linkage::Joint {
    let base = learned.map(joint).unwrap_or_default();
    linkage::Joint {
        name: state.name.clone(),
        kind: state.kind.name().to_owned(),
        axis: state.axis,
        origin: state.origin,
        range: state.range,
        configuration_known: state.configuration.is_some(),
        configuration: state.configuration.unwrap_or(0.0),
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
        schema: MESSAGE_SCHEMA,
        matches: recognition.matches.iter().map(|m| recognised(m, model_of(&m.object))).collect(),
    }
}

fn microseconds(seconds: f64) -> i64 {
    (seconds * 1e6).round() as i64
}

/// A prediction.
pub fn prediction(prediction: &Prediction, model: &ObjectModel, utime: i64) -> linkage::Prediction {
    let states: Vec<JointState> = prediction.joints.iter().map(|j| j.state.clone()).collect();
    let as_recognised = Recognised {
        object: prediction.object.clone(),
        score: prediction.score,
        inliers: prediction.inliers,
        camera_from_object: prediction.camera_from_object,
        joints: states,
        assumed: Vec::new(),
    };
    linkage::Prediction {
        utime,
        schema: MESSAGE_SCHEMA,
        recognition: recognised(&as_recognised, Some(model)),
        trajectories: prediction
            .joints
            .iter()
            .filter(|j| !j.trajectory.is_empty())
            .map(|j| linkage::JointTrajectory {
                joint: j.state.name.clone(),
                kind: j.state.kind.name().to_owned(),
                time_from_start_us: j.trajectory.iter().map(|k| microseconds(k[0])).collect(),
                position: j.trajectory.iter().map(|k| k[1]).collect(),
                velocity: j.trajectory.iter().map(|k| k[2]).collect(),
                acceleration: j.trajectory.iter().map(|k| k[3]).collect(),
            })
            .collect(),
        paths: prediction
            .parts
            .iter()
            .map(|p| linkage::PartPath {
                part: p.name.clone(),
                time_from_start_us: p.poses.iter().map(|k| microseconds(k[0])).collect(),
                poses: p
                    .poses
                    .iter()
                    .map(|k| linkage::Pose {
                        position: [k[1], k[2], k[3]],
                        quaternion: [k[4], k[5], k[6], k[7]],
                    })
                    .collect(),
            })
            .collect(),
    }
}

/// A plan that a robot must not be given.
#[derive(Debug, thiserror::Error, PartialEq)]
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
/// from 0 and strictly increasing, positions rounded to single floats inside the range.
///
/// # Errors
/// [`PlanMessageError`].
pub fn robot_plan(
    prediction: &Prediction,
    utime: i64,
) -> Result<drake::LcmtRobotPlan, PlanMessageError> {
    let moving: Vec<_> = prediction.joints.iter().filter(|j| !j.trajectory.is_empty()).collect();
    let longest = moving
        .iter()
        .max_by_key(|j| j.trajectory.len())
        .map(|j| j.trajectory.as_slice())
        .unwrap_or_default();
    if longest.len() < 2 {
        return Err(PlanMessageError::TooFewKnots { found: longest.len() });
    }
    let names: Vec<String> =
        moving.iter().map(|j| format!("{}/{}", prediction.object, j.state.name)).collect();
    let plan: Vec<drake::LcmtRobotState> = longest
        .iter()
        .enumerate()
        .map(|(i, knot)| drake::LcmtRobotState {
            utime: microseconds(knot[0]),
            joint_name: names.clone(),
            joint_position: moving
                .iter()
                .map(|j| {
                    let k = j.trajectory.get(i).or(j.trajectory.last());
                    single_inside(k.map_or(0.0, |k| k[1]), &j.trajectory)
                })
                .collect(),
        })
        .collect();
    for (knot, pair) in plan.windows(2).enumerate() {
        if pair[1].utime <= pair[0].utime || plan[0].utime != 0 {
            return Err(PlanMessageError::Times { knot: knot + 1 });
        }
    }
    Ok(drake::LcmtRobotPlan { utime, plan })
}

/// Rounded to a single float, towards the inside of the trajectory's ends.
fn single_inside(q: f64, trajectory: &[[f64; 4]]) -> f32 {
    let low = trajectory.iter().map(|k| k[1]).fold(f64::INFINITY, f64::min);
    let high = trajectory.iter().map(|k| k[1]).fold(f64::NEG_INFINITY, f64::max);
    let rounded = q as f32;
    if f64::from(rounded) > high {
        rounded.next_down()
    } else if f64::from(rounded) < low {
        rounded.next_up()
    } else {
        rounded
    }
}

/// The original system's message: parts as tracks of poses, joints as models with named
/// parameters.
pub fn articulated_object(demonstration: &Demonstration) -> articulation::ArticulatedObjectMsg {
    let model = &demonstration.model;
    let parts: Vec<articulation::TrackMsg> = demonstration
        .camera_from_part
        .iter()
        .enumerate()
        .map(|(id, trajectory)| articulation::TrackMsg {
            id: id as i64,
            ..track(trajectory.iter().zip(&demonstration.frame_utimes))
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

fn track<'t>(
    poses: impl Iterator<Item = (&'t Option<linkage_skill::geometry::Pose>, &'t i64)>,
) -> articulation::TrackMsg {
    let mut track = articulation::TrackMsg::default();
    for (pose, utime) in poses {
        let Some(pose) = pose else { continue };
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        track.pose.push(articulation::PoseMsg {
            utime: *utime,
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
    use crate::plan::{predict, tests::fridge};
    use linkage_skill::predict::Target;

    #[test]
    fn a_plan_follows_drakes_rules() {
        let (model, recognised) = fridge();
        let p = predict(&model, &recognised, None, Target::Open, &Rig::default()).unwrap();
        let plan = robot_plan(&p, 5).unwrap();
        assert!(plan.plan.len() >= 2);
        assert_eq!(plan.plan[0].utime, 0);
        assert!(plan.plan.windows(2).all(|w| w[1].utime > w[0].utime));
        for state in &plan.plan {
            assert_eq!(state.joint_name, ["fridge/joint1"]);
            let q = f64::from(state.joint_position[0]);
            assert!((0.3..=1.5).contains(&q), "{q} leaves the range after rounding");
        }
    }

    #[test]
    fn a_prediction_without_motion_is_no_plan() {
        let (model, recognised) = fridge();
        let mut p = predict(&model, &recognised, None, Target::Open, &Rig::default()).unwrap();
        p.joints[0].trajectory.clear();
        assert_eq!(robot_plan(&p, 5), Err(PlanMessageError::TooFewKnots { found: 0 }));
    }

    #[test]
    fn the_message_carries_what_the_prediction_says() {
        let (model, recognised) = fridge();
        let p = predict(&model, &recognised, None, Target::Open, &Rig::default()).unwrap();
        let message = prediction(&p, &model, 77);
        assert_eq!(message.utime, 77);
        assert_eq!(message.trajectories[0].position.len(), p.joints[0].trajectory.len());
        assert_eq!(message.recognition.joints[0].child, 1);
        let bytes = linkage_lcm::encode(&message).unwrap();
        assert_eq!(linkage_lcm::decode::<linkage::Prediction>(&bytes).unwrap(), message);
    }
}
