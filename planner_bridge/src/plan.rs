//! A prediction: the recognition, each joint's trajectory, and where the moving parts are
//! along it. Its JSON form is `linkage.prediction/1` (DESIGN 4.6).

use crate::limits::Rig;
use crate::trajectory::{Knot, TrajectoryError, time_parameterise};
use linkage_skill::geometry::pose_to_array;
use linkage_skill::model::ObjectModel;
use linkage_skill::predict::{Encountered, PredictError, Target};
use linkage_skill::recognise::{JointState, Recognised};
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
    /// Its joints.
    pub joints: Vec<PlannedJoint>,
    /// Its parts that move.
    pub parts: Vec<PlannedPart>,
}

/// Plans the motion of one joint (or of all that were seen) to a target. Joints move at the
/// same time, each as fast as the rig allows.
///
/// # Errors
/// [`PlanError`].
pub fn predict(
    model: &ObjectModel,
    recognised: &Recognised,
    joint: Option<&str>,
    target: Target,
    rig: &Rig,
) -> Result<Prediction, PlanError> {
    let encountered = Encountered::new(model, recognised)?;
    let motions = encountered.motions(joint, target)?;
    let mut trajectories: Vec<(usize, Vec<Knot>)> = Vec::new();
    for m in &motions {
        let joint = &model.joints[m.joint];
        let knots = time_parameterise(m.from, m.to, rig.limits(joint.kind))
            .map_err(|source| PlanError::Trajectory { joint: joint.name.clone(), source })?;
        trajectories.push((m.joint, knots));
    }
    let planned_joints = recognised
        .joints
        .iter()
        .enumerate()
        .map(|(i, state)| PlannedJoint {
            state: state.clone(),
            trajectory: trajectories
                .iter()
                .find(|(j, _)| *j == i)
                .map(|(_, knots)| knots.iter().map(|k| [k.t, k.q, k.qd, k.qdd]).collect())
                .unwrap_or_default(),
        })
        .collect();
    Ok(Prediction {
        schema: PREDICTION_SCHEMA.to_owned(),
        object: recognised.object.clone(),
        score: recognised.score,
        inliers: recognised.inliers,
        camera_from_object: recognised.camera_from_object,
        joints: planned_joints,
        parts: part_paths(&encountered, &trajectories),
    })
}

/// Poses of the parts that any of the moving joints carries, at the longest trajectory's
/// knots.
fn part_paths(encountered: &Encountered, trajectories: &[(usize, Vec<Knot>)]) -> Vec<PlannedPart> {
    let model = encountered.model();
    let Some(longest) = trajectories
        .iter()
        .map(|(_, k)| k)
        .max_by(|a, b| a.last().map_or(0.0, |k| k.t).total_cmp(&b.last().map_or(0.0, |k| k.t)))
    else {
        return Vec::new();
    };
    let mut moved = vec![false; model.parts.len()];
    for (i, joint) in model.joints.iter().enumerate() {
        moved[joint.child] = moved[joint.parent] || trajectories.iter().any(|(j, _)| *j == i);
    }
    let mut parts: Vec<PlannedPart> = model
        .parts
        .iter()
        .filter(|p| moved[p.id])
        .map(|p| PlannedPart { part: p.id, name: p.name.clone(), poses: Vec::new() })
        .collect();
    for knot in longest {
        let q: Vec<(usize, f64)> =
            trajectories.iter().map(|(j, knots)| (*j, at(knots, knot.t))).collect();
        let poses = encountered.part_poses(&q);
        for part in &mut parts {
            let [x, y, z, qx, qy, qz, qw] = pose_to_array(&poses[part.part]);
            part.poses.push([knot.t, x, y, z, qx, qy, qz, qw]);
        }
    }
    parts
}

/// A trajectory's configuration at a time; the last one after its end.
fn at(knots: &[Knot], t: f64) -> f64 {
    let after = knots.partition_point(|k| k.t < t);
    match (after.checked_sub(1).and_then(|i| knots.get(i)), knots.get(after)) {
        (_, Some(b)) if b.t <= t => b.q,
        (Some(a), Some(b)) => a.q + (b.q - a.q) * (t - a.t) / (b.t - a.t),
        (None, Some(b)) => b.q,
        (Some(a), None) => a.q,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use linkage_skill::articulate::JointKind;
    use linkage_skill::model::{Joint, MODEL_SCHEMA, Part, ReferenceFrame};

    pub fn fridge() -> (ObjectModel, Recognised) {
        let joint = Joint {
            name: "joint1".into(),
            parent: 0,
            child: 1,
            kind: JointKind::Revolute,
            axis: [0.0, -1.0, 0.0],
            origin: [0.4, 0.0, 1.1],
            pitch: 0.0,
            range: [0.0, 1.5],
            covariance: vec![[0.0; 6]; 6],
            observations: 100,
            bic: 0.0,
            log_likelihood: 0.0,
            position_rmse: 0.0,
            orientation_rmse: 0.0,
            configuration: Vec::new(),
            type_probabilities: Default::default(),
            undecided: false,
        };
        let model = ObjectModel {
            schema: MODEL_SCHEMA.into(),
            object: "fridge".into(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: ["base", "part1"]
                .iter()
                .enumerate()
                .map(|(id, name)| Part { id, name: (*name).into(), features: 9 })
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
            joints: vec![JointState {
                name: "joint1".into(),
                kind: JointKind::Revolute,
                axis: [0.0, -1.0, 0.0],
                origin: [0.4, 0.0, 1.3],
                configuration: Some(0.3),
                range: [0.0, 1.5],
            }],
            assumed: vec![0.3],
        };
        (model, recognised)
    }

    #[test]
    fn opening_starts_at_the_present_configuration_and_ends_at_the_range() {
        let (model, recognised) = fridge();
        let p = predict(&model, &recognised, None, Target::Open, &Rig::default()).unwrap();
        let trajectory = &p.joints[0].trajectory;
        assert_eq!(trajectory[0], [0.0, 0.3, 0.0, 0.0]);
        assert_eq!(trajectory.last().unwrap()[1], 1.5);
        assert_eq!(p.parts.len(), 1);
        assert_eq!(p.parts[0].poses.len(), trajectory.len());
    }

    #[test]
    fn a_target_outside_the_learned_range_is_refused() {
        let (model, recognised) = fridge();
        let error = predict(&model, &recognised, None, Target::Value(2.5), &Rig::default());
        let message = error.unwrap_err().to_string();
        assert!(message.contains("2.500 lies outside"), "{message}");
    }

    #[test]
    fn an_unknown_joint_is_named_with_what_there_is() {
        let (model, recognised) = fridge();
        let error = predict(&model, &recognised, Some("lid"), Target::Open, &Rig::default());
        let message = error.unwrap_err().to_string();
        assert!(message.contains("\"lid\"") && message.contains("joint1"), "{message}");
    }
}
