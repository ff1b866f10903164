//! How far a learned model is from the truth, by the rules in the data's README: predicted
//! joints are matched to true ones by axis angle, and where that says little, as of two drawers,
//! by what they did over time; the distance of an axis is taken where it is nearest to the part.

use crate::truth::{TrueJoint, Truth};
use linkage_skill::internals::{distance_to_line, line_angle, nearest_on_line, orthonormal_basis};
use linkage_skill::object::{Joint, JointKind};
use linkage_skill::{ObjectModel, pose_from_array};
use nalgebra::{DMatrix, DVector, Point3, Vector3};
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
    /// The model says that the motion was too short to tell the type.
    pub undecided: bool,
    /// What was found; `None`: missed.
    pub found_kind: Option<JointKind>,
    /// Angle between the axes, degrees.
    pub axis_deg: Option<f64>,
    /// Distance of the axes at the part, centimetres; 0 for slides.
    pub position_cm: Option<f64>,
    /// Difference of the pitches of a screw, centimetres a turn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pitch_cm: Option<f64>,
    /// Found range as a share of the true one.
    pub range_share: Option<f64>,
    /// Right parent part.
    pub right_tree: bool,
    /// Probability that the model gives to the true kind, where it gives any.
    pub true_kind_probability: Option<f64>,
    /// Squared Mahalanobis distance of the true line from the found one, where the model tells
    /// its covariance.
    pub line_distance_sq: Option<f64>,
}

impl JointScore {
    /// The true line lies within the ellipsoid that should hold 95 % of all.
    pub fn inside_95(&self) -> Option<bool> {
        // Quantiles of chi-squared with two and four degrees of freedom.
        let limit = if self.true_kind == JointKind::Prismatic { 5.991 } else { 9.488 };
        self.line_distance_sq.map(|d| d < limit)
    }
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
            && self.joints.iter().all(|j| j.right_tree)
            && self.finds_joints(max_deg, max_cm)
    }

    /// Each true joint found with its kind, the axis within the limits, whatever else was
    /// found.
    pub fn finds_joints(&self, max_deg: f64, max_cm: f64) -> bool {
        self.joints.iter().all(|j| {
            j.found_kind == Some(j.true_kind)
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
                        + 0.1 * another_course(moved[i], found, truth)
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

/// Angle between the axes, radians.
fn axis_angle(truth: &TrueJoint, found: &Joint) -> f64 {
    line_angle(&Vector3::from(truth.axis), &Vector3::from(found.axis))
}

/// 0 to 1: the configuration is another one over time. Two drawers slide along one direction.
fn another_course(truth: &TrueJoint, found: &Joint, all: &Truth) -> f64 {
    let span = truth.range_observed[1] - truth.range_observed[0];
    mean_difference(found, truth, all).map_or(1.0, |mean| (mean / span.max(1e-9)).min(1.0))
}

/// Mean absolute difference of configurations, aligned at the first frame, signs following the
/// axes; `None` where none is known.
pub fn mean_difference(found: &Joint, true_joint: &TrueJoint, truth: &Truth) -> Option<f64> {
    let along = Vector3::from(found.axis).dot(&Vector3::from(true_joint.axis)).signum();
    let pairs: Vec<(f64, f64)> = found
        .configuration
        .iter()
        .filter_map(|[t, q]| {
            let frame = truth.frame_at((t * 1e6).round() as i64)?;
            Some((along * q, *true_joint.configuration.get(frame)?))
        })
        .filter(|(_, truly)| truly.is_finite())
        .collect();
    let (found_first, true_first) = *pairs.first()?;
    let sum: f64 = pairs.iter().map(|(q, t)| ((q - found_first) - (t - true_first)).abs()).sum();
    Some(sum / pairs.len() as f64)
}

/// Distance between the axes where they are nearest to the part, metres.
fn axis_distance(joint: &TrueJoint, found: &Joint, truth: &Truth) -> f64 {
    if joint.kind == JointKind::Prismatic {
        return 0.0;
    }
    let Some(centroid) = truth.part(&joint.child).and_then(|part| {
        let first_seen = part.camera_from_part.iter().find_map(pose_from_array)?;
        Some(first_seen * Point3::from(part.centroid))
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
        undecided: found.is_some_and(|f| f.undecided),
        found_kind: found.map(|f| f.kind),
        axis_deg: found.map(|f| axis_angle(joint, f).to_degrees()),
        position_cm: found.map(|f| 100.0 * axis_distance(joint, f, truth)),
        pitch_cm: found
            .filter(|_| joint.kind == JointKind::Helical)
            .map(|f| 100.0 * (f.pitch - joint.pitch).abs()),
        range_share: found.map(|f| (f.range[1] - f.range[0]) / true_span.max(1e-9)),
        right_tree: found.is_some_and(|f| Some(f.parent) == expected_parent),
        true_kind_probability: found.and_then(|f| f.type_probabilities.get(&joint.kind).copied()),
        line_distance_sq: found
            .filter(|f| f.kind == joint.kind)
            .and_then(|f| line_distance_sq(joint, f)),
    }
}

/// Squared Mahalanobis distance of the true line from the found one: two degrees of freedom for the
/// direction of a slide, two more for the position of a hinge.
fn line_distance_sq(truth: &TrueJoint, found: &Joint) -> Option<f64> {
    let axis = Vector3::from(found.axis).normalize();
    let mut true_axis = Vector3::from(truth.axis).normalize();
    if true_axis.dot(&axis) < 0.0 {
        true_axis = -true_axis;
    }
    let origin = Vector3::from(found.origin);
    let true_origin = Vector3::from(truth.origin);
    // Where the true line meets the plane across the found one.
    let along = axis.dot(&(origin - true_origin)) / axis.dot(&true_axis);
    let aside = true_origin + true_axis * along - origin;
    let (u, v) = orthonormal_basis(&axis);
    let free = if found.kind == JointKind::Prismatic { 2 } else { 4 };
    let mut directions = DMatrix::zeros(free, 6);
    for (row, side) in [u, v, u, v].into_iter().take(free).enumerate() {
        let first = if row < 2 { 0 } else { 3 };
        directions.fixed_view_mut::<1, 3>(row, first).copy_from(&side.transpose());
    }
    let known = found.known_covariance()?;
    let covariance = DMatrix::from_fn(6, 6, |r, c| known[(r, c)]);
    let mut difference = DVector::zeros(6);
    difference.rows_mut(0, 3).copy_from(&(true_axis - axis));
    difference.rows_mut(3, 3).copy_from(&aside);
    let across = &directions * difference;
    let spread = &directions * covariance * directions.transpose();
    Some(across.dot(&spread.cholesky()?.solve(&across)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::{JointGeometry, ReferenceFrame};
    use nalgebra::UnitVector3;

    const FRAMES: usize = 40;

    /// A drawer that is pulled this far out from a frame on.
    fn drawn(frame: usize, by: f64, from: usize) -> f64 {
        by * (frame.saturating_sub(from) as f64 / 10.0).min(1.0)
    }

    fn true_slide(name: &str, by: f64, from: usize) -> TrueJoint {
        TrueJoint {
            name: name.to_owned(),
            kind: JointKind::Prismatic,
            parent: "body".to_owned(),
            child: name.to_owned(),
            axis: [0.0, 0.0, -1.0],
            origin: [0.0; 3],
            axis_last: [0.0, 0.0, -1.0],
            origin_last: [0.0; 3],
            pitch: 0.0,
            configuration: (0..FRAMES).map(|f| drawn(f, by, from)).collect(),
            range_observed: [0.0, by],
            moved: true,
            grasp: None,
        }
    }

    fn found_slide(axis: Vector3<f64>, by: f64, from: usize) -> Joint {
        let geometry = JointGeometry {
            kind: JointKind::Prismatic,
            ..JointGeometry::hinge(UnitVector3::new_normalize(axis), Point3::origin())
        };
        Joint {
            range: [0.0, by],
            configuration: (0..FRAMES).map(|f| [f as f64 / 30.0, drawn(f, by, from)]).collect(),
            ..Joint::of(&geometry)
        }
    }

    #[test]
    fn two_drawers_are_told_apart_by_when_they_were_opened() {
        let truth = Truth {
            object: "cabinet".to_owned(),
            category: "drawers".to_owned(),
            texture: "rich".to_owned(),
            hand: true,
            moving_camera: false,
            encounter: false,
            unknown: false,
            frames: (0..FRAMES).map(|f| f as f64 / 30.0).collect(),
            world_from_camera: Vec::new(),
            parts: Vec::new(),
            solids: Vec::new(),
            joints: vec![true_slide("upper", 0.30, 5), true_slide("lower", 0.28, 20)],
        };
        // The upper one's direction happens to be nearer to that of the lower one.
        let upper = found_slide(Vector3::new(0.002, 0.0, -1.0), 0.30, 5);
        let lower = found_slide(Vector3::new(0.001, 0.0, -1.0), 0.28, 20);
        let model = ObjectModel {
            schema: linkage_skill::object::MODEL_SCHEMA.to_owned(),
            object: "cabinet".to_owned(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: Vec::new(),
            joints: vec![lower, upper],
            demonstrations: 1,
            profile: "default".to_owned(),
            version: String::new(),
        };
        let found: Vec<_> = score_model(&model, &truth).joints.iter().map(|j| j.found).collect();
        assert_eq!(found, [Some(1), Some(0)]);
    }
}
