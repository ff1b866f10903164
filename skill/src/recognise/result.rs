//! The reported result of recognition: `linkage.recognition/1`.
//!
//! In: a [`Detection`].
//! Out: the pose of the object, and line and configuration of each of its joints (camera frame, metres and radians);
//! a configuration that is not determined is `null`, with the reason.

use super::evidence::{Detection, probability};
use super::kinematics::Articulated;
use super::known_object::KnownObject;
use super::verdict::PartVerdict;
use crate::math::rigid::{Pose, pose_to_array};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::{ObjectModel, Part};
use nalgebra::UnitVector3;
use serde::{Deserialize, Serialize};

/// Name and version of the JSON form.
pub const RECOGNITION_SCHEMA: &str = "linkage.recognition/1";

/// State of one joint in a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Name of the joint.
    pub name: String,
    /// Kind of the joint.
    #[serde(rename = "type")]
    pub kind: JointKind,
    /// Unit direction of the line, camera frame.
    pub axis: [f64; 3],
    /// A point on the line, camera frame, metres.
    pub origin: [f64; 3],
    /// Advance of a screw, metres per turn; 0 and left out for other kinds.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pitch: f64,
    /// Configuration, rad or m; `null` if it is not determined.
    pub configuration: Option<f64>,
    /// Standard deviation of the configuration, rad or m; left out if it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deviation: Option<f64>,
    /// Why the configuration is `null`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Range of configurations seen in the demonstrations, rad or m.
    pub range: [f64; 2],
}

/// Default of [`Recognised::base_known`] when it is left out.
pub fn yes() -> bool {
    true
}

/// True if [`Recognised::base_known`] is left out when written.
pub fn is_yes(known: &bool) -> bool {
    *known
}

fn is_zero(pitch: &f64) -> bool {
    *pitch == 0.0
}

impl JointState {
    /// Line of the joint, camera frame.
    pub fn geometry(&self) -> JointGeometry {
        JointGeometry {
            kind: self.kind,
            axis: UnitVector3::new_normalize(self.axis.into()),
            origin: self.origin.into(),
            pitch: self.pitch,
        }
    }
}

/// What the image shows of one part where the search put it. A configuration that what the image rules out tells
/// afterwards is not compared again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PartEvidence {
    /// Name of the part.
    pub part: String,
    /// True if the place of the part is determined: by what is seen of it, or for the base by the room.
    pub placed: bool,
    /// Number of surfels (points of the learned surface) that agree with the image in depth and normal.
    pub surface: usize,
    /// Number of surfels that the image sees through.
    pub seen_through: usize,
    /// Correlation of the colour with the learned one, -1 to 1; `None`, and left out of JSON, where too little surface
    /// is seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colour: Option<f64>,
}

/// A recognised object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recognised {
    /// Name of the object.
    pub object: String,
    /// Probability (0 to 1) that the object is in the image at this pose; reported from
    /// [`super::RecogniseConfig::min_score`] on.
    pub score: f64,
    /// Number of places with matches that agree geometrically; 0 where no features are used.
    pub inliers: usize,
    /// Pose of the object frame in the camera frame: x, y, z in metres, then the quaternion x, y, z, w.
    pub camera_from_object: [f64; 7],
    /// False if the pose of the base is not determined, e.g. if only parts are seen whose configuration is not
    /// known: `camera_from_object` is then a guess, while the axes of the joints that carry those parts are right.
    /// Left out if true.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub base_known: bool,
    /// Joints of the object.
    pub joints: Vec<JointState>,
    /// What is seen of each part, in the order of the model's parts; empty, and left out of JSON, where it was not
    /// compared with depth.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub evidence: Vec<PartEvidence>,
    /// Configurations that belong to the pose, rad or m, including those that are not determined; empty if they are
    /// not known. Not written to JSON.
    #[serde(skip)]
    pub assumed: Vec<f64>,
}

/// Everything that was recognised in a frame: `linkage.recognition/1`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recognition {
    /// Name and version of the JSON form: [`RECOGNITION_SCHEMA`].
    pub schema: String,
    /// Recognised objects, best first.
    pub matches: Vec<Recognised>,
    /// Largest probability of an object below the threshold, 0 if there is none. Not written to JSON.
    #[serde(skip)]
    pub best_refused: f64,
    /// Object with the probability [`Self::best_refused`], if there is one. Not written to JSON.
    #[serde(skip)]
    pub best_refused_object: Option<String>,
}

impl Recognition {
    /// Collects recognised objects and sorts them, best first.
    pub fn new(mut matches: Vec<Recognised>) -> Self {
        matches.sort_by(|a, b| b.score.total_cmp(&a.score));
        let schema = RECOGNITION_SCHEMA.to_owned();
        Self { schema, matches, best_refused: 0.0, best_refused_object: None }
    }

    /// Records an object below the threshold if its probability is the largest of these.
    pub(crate) fn refuse(&mut self, object: &str, score: f64) {
        if score > self.best_refused {
            self.best_refused = score;
            self.best_refused_object = Some(object.to_owned());
        }
    }
}

/// True if seen evidence fixes the base, or a part from which determined configurations lead to the base.
fn base_is_known(articulated: &Articulated, found: &Detection) -> bool {
    let leads = |part: usize| {
        (0..found.evident.len())
            .all(|j| found.evident[j] || !articulated.moved_by(j).contains(&part))
    };
    (0..articulated.parts).any(|part| found.placed[part] && leads(part))
}

/// Sentence for a user: why the configuration of a joint is not determined.
fn reason(
    model: &ObjectModel,
    articulated: &Articulated,
    found: &Detection,
    joint: usize,
) -> String {
    let moved = articulated.moved_by(joint);
    let is_hidden =
        |side: bool| (0..articulated.parts).all(|p| !found.placed[p] || moved.contains(&p) != side);
    let name = |part: usize| model.parts[part].name.as_str();
    let (parent, child) = (name(model.joints[joint].parent), name(model.joints[joint].child));
    match (is_hidden(true), is_hidden(false)) {
        (true, false) => format!("nothing seen of {child} tells where it is"),
        (false, true) => format!("nothing seen of {parent} tells where it is"),
        (true, true) => format!("nothing seen of {parent} and {child} tells where they are"),
        (false, false) => format!("what is seen of {child} does not tell how far it has moved"),
    }
}

/// Converts a detection to its reported form.
pub fn report(object: &KnownObject, articulated: &Articulated, found: &Detection) -> Recognised {
    let motions = object.model.part_motions(&found.state.q);
    let state_of = |joint: usize| {
        // The parent carries the line, from where it is at configuration 0.
        let camera_from_parent =
            found.state.camera_from_object * motions[object.model.joints[joint].parent];
        joint_state(&object.model, articulated, found, joint, &camera_from_parent)
    };
    Recognised {
        object: object.model.object.clone(),
        score: probability(found.score),
        inliers: found.inliers,
        camera_from_object: pose_to_array(&found.state.camera_from_object),
        base_known: base_is_known(articulated, found),
        joints: (0..object.model.joints.len()).map(state_of).collect(),
        evidence: part_evidence(&object.model.parts, found),
        assumed: found.state.q.clone(),
    }
}

/// What is seen of each part; empty where no surface was compared with depth.
fn part_evidence(parts: &[Part], found: &Detection) -> Vec<PartEvidence> {
    if found.verdict.judged == 0 {
        return Vec::new();
    }
    let seen = parts.iter().zip(&found.verdict.parts).zip(&found.placed);
    let of_part = |((part, verdict), placed): ((&Part, &PartVerdict), &bool)| PartEvidence {
        part: part.name.clone(),
        placed: *placed,
        surface: verdict.agree,
        seen_through: verdict.through,
        colour: verdict.correlation,
    };
    seen.map(of_part).collect()
}

/// Converts one joint of a detection to its reported form.
fn joint_state(
    model: &ObjectModel,
    articulated: &Articulated,
    found: &Detection,
    joint: usize,
    camera_from_parent: &Pose,
) -> JointState {
    let learned = &model.joints[joint];
    let line = learned.geometry().transformed(camera_from_parent);
    let is_told = found.evident[joint];
    JointState {
        name: learned.name.clone(),
        kind: learned.kind,
        axis: line.axis.into_inner().into(),
        origin: line.origin.into(),
        pitch: line.pitch,
        configuration: is_told.then_some(found.state.q[joint]),
        deviation: is_told.then_some(found.deviations[joint]).flatten(),
        reason: (!is_told).then(|| reason(model, articulated, found, joint)),
        range: learned.range,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recognise::kinematics::{ChainJoint, State};
    use crate::recognise::verdict::Verdict;
    use nalgebra::{Point3, Vector3};

    /// A door on its frame; `placed`: which of frame and door are seen.
    fn door(placed: [bool; 2]) -> (Articulated, Detection) {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let joints = vec![ChainJoint::new(hinge, [0, 1], [0.0, 1.0])];
        let found = Detection {
            state: State { camera_from_object: Pose::identity(), q: vec![0.5] },
            score: 1.0,
            inliers: 20,
            verdict: Verdict::default(),
            placed: placed.to_vec(),
            evident: vec![placed == [true; 2]],
            deviations: vec![None],
        };
        (Articulated { parts: 2, joints }, found)
    }

    #[test]
    fn the_base_is_known_where_it_is_seen_or_told_joints_lead_to_it() {
        let is_known = |placed| {
            let (articulated, found) = door(placed);
            base_is_known(&articulated, &found)
        };
        assert!(is_known([true, false]) && is_known([true, true]));
        // Only the door is seen, and how far it is open is not told.
        assert!(!is_known([false, true]));
    }

    #[test]
    fn what_is_seen_of_each_part_is_told_and_nothing_without_depth() {
        let (_, mut found) = door([true, false]);
        let named = |id, name: &str| Part { id, name: name.to_owned(), features: 0, grasp: None };
        let parts = [named(0, "base"), named(1, "door")];
        found.verdict = Verdict::nothing_yet(2);
        assert!(part_evidence(&parts, &found).is_empty());
        let seen = |agree, through, correlation| PartVerdict {
            agree,
            through,
            correlation,
            ..PartVerdict::default()
        };
        found.verdict.judged = 9;
        found.verdict.parts = vec![seen(7, 2, Some(0.5)), seen(0, 0, None)];
        let told = serde_json::to_value(part_evidence(&parts, &found)).unwrap();
        let expected = serde_json::json!([
            { "part": "base", "placed": true, "surface": 7, "seen_through": 2, "colour": 0.5 },
            { "part": "door", "placed": false, "surface": 0, "seen_through": 0 },
        ]);
        assert_eq!(told, expected);
    }

    #[test]
    fn of_what_is_refused_the_best_is_named_and_of_equals_the_first() {
        let mut found = Recognition::new(Vec::new());
        found.refuse("box", 0.0);
        assert_eq!((found.best_refused, &found.best_refused_object), (0.0, &None));
        for (object, score) in [("door", 0.2), ("drawer", 0.3), ("fridge", 0.3), ("lid", 0.1)] {
            found.refuse(object, score);
        }
        assert_eq!(
            (found.best_refused, found.best_refused_object.as_deref()),
            (0.3, Some("drawer"))
        );
    }
}
