//! How far a learned model is from the truth, by the rules in the data's README: predicted
//! joints are matched to true ones by axis angle; the distance of an axis is taken where it
//! is nearest to the part.

use super::truth::{TrueJoint, Truth};
use linkage_skill::ObjectModel;
use linkage_skill::articulate::JointKind;
use linkage_skill::geometry::{distance_to_line, line_angle, nearest_on_line, pose_from_array};
use linkage_skill::model::Joint;
use nalgebra::{Point3, Vector3};
use serde::Serialize;

/// One true joint and what was found of it.
#[derive(Debug, Clone, Serialize)]
pub struct JointScore {
    /// The true joint.
    pub name: String,
    /// Its kind.
    pub true_kind: JointKind,
    /// Index of the found joint in the model.
    #[serde(skip)]
    pub found: Option<usize>,
    /// What was found; `None`: missed.
    pub found_kind: Option<JointKind>,
    /// Angle between the axes, degrees.
    pub axis_deg: Option<f64>,
    /// Distance of the axes at the part, centimetres; 0 for slides.
    pub position_cm: Option<f64>,
    /// Found range as a share of the true one.
    pub range_share: Option<f64>,
    /// Right parent part.
    pub right_tree: bool,
}

/// A whole recording.
#[derive(Debug, Clone, Serialize)]
pub struct LearnScore {
    /// Each true joint that moved.
    pub joints: Vec<JointScore>,
    /// Found joints that match none.
    pub spurious: usize,
    /// Parts found, base included.
    pub parts: usize,
}

impl LearnScore {
    /// Right number, kinds and tree, each axis within the limits.
    pub fn succeeds(&self, max_deg: f64, max_cm: f64) -> bool {
        self.spurious == 0
            && self.joints.iter().all(|j| {
                j.found_kind == Some(j.true_kind)
                    && j.right_tree
                    && j.axis_deg.is_some_and(|d| d < max_deg)
                    && j.position_cm.is_some_and(|d| d < max_cm)
            })
    }
}

/// Scores a model learned from a recording.
pub fn score_model(model: &ObjectModel, truth: &Truth) -> LearnScore {
    let moved = truth.moved();
    let assignment = assign(model, &moved, truth);
    let joints = moved
        .iter()
        .enumerate()
        .map(|(i, t)| score_joint(t, assignment[i], &assignment, model, &moved, truth))
        .collect();
    let matched = assignment.iter().flatten().count();
    LearnScore { joints, spurious: model.joints.len() - matched, parts: model.parts.len() }
}

/// For each true joint the number of the found one; every assignment of so few is tried.
fn assign(model: &ObjectModel, moved: &[&TrueJoint], truth: &Truth) -> Vec<Option<usize>> {
    fn best(
        i: usize,
        moved: &[&TrueJoint],
        model: &ObjectModel,
        truth: &Truth,
        used: &mut Vec<bool>,
    ) -> (f64, Vec<Option<usize>>) {
        const MISSED: f64 = 10.0;
        if i == moved.len() {
            return (0.0, Vec::new());
        }
        let mut result: Option<(f64, Vec<Option<usize>>)> = None;
        let choices = std::iter::once(None).chain((0..model.joints.len()).map(Some));
        for choice in choices {
            let cost = match choice {
                None => MISSED,
                Some(k) if used[k] => continue,
                Some(k) => {
                    used[k] = true;
                    let found = &model.joints[k];
                    axis_angle(moved[i], found)
                        + 0.5 * axis_distance(moved[i], found, truth).min(1.0)
                        + if found.kind == moved[i].kind { 0.0 } else { 1.0 }
                }
            };
            let (rest, mut tail) = best(i + 1, moved, model, truth, used);
            if let Some(k) = choice {
                used[k] = false;
            }
            if result.as_ref().is_none_or(|(c, _)| cost + rest < *c) {
                tail.insert(0, choice);
                result = Some((cost + rest, tail));
            }
        }
        result.unwrap_or_default()
    }
    best(0, moved, model, truth, &mut vec![false; model.joints.len()]).1
}

fn axis_angle(truth: &TrueJoint, found: &Joint) -> f64 {
    line_angle(&Vector3::from(truth.axis), &Vector3::from(found.axis))
}

fn axis_distance(joint: &TrueJoint, found: &Joint, truth: &Truth) -> f64 {
    if joint.kind == JointKind::Prismatic {
        return 0.0;
    }
    let Some(centroid) = truth.part(&joint.child).and_then(|part| {
        Some(pose_from_array(part.camera_from_part.first()?)? * Point3::from(part.centroid))
    }) else {
        return f64::INFINITY;
    };
    let axis = Vector3::from(joint.axis).normalize();
    let at = nearest_on_line(&Point3::from(joint.origin), &axis, &centroid);
    let found_axis = Vector3::from(found.axis).normalize();
    distance_to_line(&Point3::from(found.origin), &found_axis, &at)
}

fn score_joint(
    joint: &TrueJoint,
    index: Option<usize>,
    assignment: &[Option<usize>],
    model: &ObjectModel,
    moved: &[&TrueJoint],
    truth: &Truth,
) -> JointScore {
    let found = index.map(|k| &model.joints[k]);
    // The parent must be the part that the found counterpart of the true parent joint moves.
    let true_parent = moved.iter().position(|t| t.child == joint.parent);
    let expected_parent = match true_parent {
        None => Some(0),
        Some(i) => assignment[i].map(|k| model.joints[k].child),
    };
    let true_span = joint.range_observed[1] - joint.range_observed[0];
    JointScore {
        name: joint.name.clone(),
        true_kind: joint.kind,
        found: index,
        found_kind: found.map(|f| f.kind),
        axis_deg: found.map(|f| axis_angle(joint, f).to_degrees()),
        position_cm: found.map(|f| 100.0 * axis_distance(joint, f, truth)),
        range_share: found.map(|f| (f.range[1] - f.range[0]) / true_span.max(1e-9)),
        right_tree: found.is_some_and(|f| Some(f.parent) == expected_parent),
    }
}
