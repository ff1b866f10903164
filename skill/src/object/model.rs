//! The learned object: parts, joints, and how each joint was seen to move. Its JSON form is
//! `linkage.model/1`.

use super::joint_geometry::{JointGeometry, JointKind};
use crate::math::rigid::{Pose, pose_from_array, pose_to_array};
use nalgebra::{Matrix6, Point3, SymmetricEigen, UnitVector3, Vector3};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::ops::Index;

/// Name and version of the JSON form.
pub const MODEL_SCHEMA: &str = "linkage.model/1";

/// Rounding that a covariance may show, as a share of its largest entry: its two halves differ by
/// no more, and no eigenvalue is further below 0.
pub(super) const ROUNDING: f64 = 1e-6;

/// Largest entry of a covariance; square metres, or square radians.
pub(super) const LARGEST_VARIANCE: f64 = 1e12;

/// A rigid part. Part 0 is the base: everything that does not move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Number, 0 for the base.
    pub id: usize,
    /// Name.
    pub name: String,
    /// Tracks that lay on it.
    pub features: usize,
    /// Where the demonstrator's hand held it: a point in the object frame, at configuration 0 of
    /// all joints, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grasp: Option<[f64; 3]>,
}

impl Part {
    /// A part of which no grasp is known.
    pub fn new(id: usize, name: impl Into<String>, features: usize) -> Self {
        Self { id, name: name.into(), features, grasp: None }
    }
}

/// A joint between two parts. Line and covariance are in the object frame, at the reference
/// frame's configuration of all joints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// Name, unique in the object.
    pub name: String,
    /// The part that carries it.
    pub parent: usize,
    /// The part that it moves.
    pub child: usize,
    /// Its kind.
    #[serde(rename = "type")]
    pub kind: JointKind,
    /// Unit direction.
    pub axis: [f64; 3],
    /// A point on the axis, metres.
    pub origin: [f64; 3],
    /// Metres a turn, for helical joints; else 0.
    pub pitch: f64,
    /// Least and greatest configuration seen; radians or metres.
    pub range: [f64; 2],
    /// Covariance of (axis, origin), 6 x 6; empty where it is not known.
    pub covariance: Vec<[f64; 6]>,
    /// Frames in which the configuration is known.
    pub observations: usize,
    /// Bayesian information criterion.
    pub bic: f64,
    /// Log likelihood.
    pub log_likelihood: f64,
    /// Root mean square distance to the model, metres.
    pub position_rmse: f64,
    /// Root mean square angle to the model, radians.
    pub orientation_rmse: f64,
    /// `[t, q]`: seconds and configuration, 0 at the reference frame.
    pub configuration: Vec<[f64; 2]>,
    /// Probability of each kind given the observations, where it was computed.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub type_probabilities: BTreeMap<JointKind, f64>,
    /// The motion does not tell the type: the probability of `kind` is below 0.95.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub undecided: bool,
}

/// Probability from which a type counts as told.
pub const DECIDED: f64 = 0.95;

/// True where `kind` is not likely enough to be called the type.
pub fn is_undecided(kind: JointKind, probabilities: &BTreeMap<JointKind, f64>) -> bool {
    !probabilities.is_empty() && probabilities.get(&kind).is_none_or(|p| p.is_nan() || *p < DECIDED)
}

impl Joint {
    /// The joint of a line in the object frame, of which nothing else is known: the first of the
    /// base.
    pub fn of(line: &JointGeometry) -> Self {
        Self {
            name: "joint1".to_owned(),
            parent: 0,
            child: 1,
            kind: line.kind,
            axis: line.axis.into_inner().into(),
            origin: line.origin.into(),
            pitch: line.pitch,
            range: [0.0, 0.0],
            covariance: vec![[0.0; 6]; 6],
            observations: 0,
            bic: 0.0,
            log_likelihood: 0.0,
            position_rmse: 0.0,
            orientation_rmse: 0.0,
            configuration: Vec::new(),
            type_probabilities: BTreeMap::new(),
            undecided: false,
        }
    }

    /// Its line, in the object frame.
    pub fn geometry(&self) -> JointGeometry {
        JointGeometry {
            kind: self.kind,
            axis: UnitVector3::new_normalize(Vector3::from(self.axis)),
            origin: Point3::from(self.origin),
            pitch: self.pitch,
        }
    }

    /// Lets its axis point the other way, with its covariance; its configurations have to be given anew.
    pub(crate) fn turn_round(&mut self) {
        self.axis = self.axis.map(|x| -x);
        for (r, row) in self.covariance.iter_mut().enumerate() {
            let with_origin = |c: &usize| (r < 3) != (*c < 3);
            (0..row.len()).filter(with_origin).for_each(|c| row[c] = -row[c]);
        }
    }

    /// Covariance of (axis, origin); `None` where it is not known.
    pub fn known_covariance(&self) -> Option<Matrix6<f64>> {
        let rows: &[[f64; 6]; 6] = self.covariance.as_slice().try_into().ok()?;
        Some(Matrix6::from_fn(|r, c| rows[r][c]))
    }
}

/// A covariance as the model's JSON holds it: exactly symmetric. It is empty where rounding or a
/// failed fit left no covariance.
pub fn covariance_rows(covariance: &impl Index<(usize, usize), Output = f64>) -> Vec<[f64; 6]> {
    let mean = |r: usize, c: usize| 0.5 * (covariance[(r, c)] + covariance[(c, r)]);
    let symmetric = Matrix6::from_fn(mean);
    if !is_covariance(&symmetric) {
        return Vec::new();
    }
    (0..6).map(|r| std::array::from_fn(|c| symmetric[(r, c)])).collect()
}

/// True for finite, symmetric and positive semidefinite matrices, except for rounding.
pub(super) fn is_covariance(matrix: &Matrix6<f64>) -> bool {
    if !matrix.iter().all(|x| x.is_finite() && x.abs() <= LARGEST_VARIANCE) {
        return false;
    }
    let allowed = ROUNDING * matrix.amax();
    let asymmetry = (matrix - matrix.transpose()).amax();
    let least = SymmetricEigen::new(0.5 * (matrix + matrix.transpose())).eigenvalues.min();
    asymmetry <= allowed && least >= -allowed
}

/// What is known of an object's motion. Whatever is read is checked: see [`ObjectModel::check`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct ObjectModel {
    /// [`MODEL_SCHEMA`].
    pub schema: String,
    /// Its name.
    pub object: String,
    /// The frame that all lines are given in.
    pub reference_frame: ReferenceFrame,
    /// Parts, the base first.
    pub parts: Vec<Part>,
    /// Joints, parents before children.
    pub joints: Vec<Joint>,
    /// Demonstrations it was learned from.
    pub demonstrations: usize,
    /// Profile it was learned with.
    pub profile: String,
    /// Version of the program that learned it.
    pub version: String,
}

/// When and where the object frame was chosen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReferenceFrame {
    /// Seconds.
    pub t: f64,
    /// Pose of the object frame in the camera of that frame.
    pub camera_from_object: [f64; 7],
}

impl ReferenceFrame {
    /// `camera_from_object` as a pose; `None` where the array is no pose.
    pub fn pose(&self) -> Option<Pose> {
        pose_from_array(&self.camera_from_object)
    }

    /// The object frame is the camera frame at `t` seconds.
    pub fn at_camera(t: f64) -> Self {
        Self { t, camera_from_object: pose_to_array(&Pose::identity()) }
    }
}

impl Serialize for ObjectModel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for ObjectModel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let model = Self::deserialize(deserializer)?;
        model.check().map_err(D::Error::custom)?;
        Ok(model)
    }
}

impl ObjectModel {
    /// The joint of a name.
    pub fn joint(&self, name: &str) -> Option<&Joint> {
        self.joints.iter().find(|j| j.name == name)
    }

    /// `object_from_part` relative to the reference frame for given configurations: what
    /// each part's points of the reference frame are moved by. Index by part; configurations
    /// in the order of `joints`.
    pub fn part_motions(&self, configurations: &[f64]) -> Vec<Pose> {
        let mut motions = vec![Pose::identity(); self.parts.len()];
        for (joint, &q) in self.joints.iter().zip(configurations) {
            motions[joint.child] = motions[joint.parent] * joint.geometry().motion(q);
        }
        motions
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) fn door() -> ObjectModel {
        ObjectModel {
            schema: MODEL_SCHEMA.to_owned(),
            object: "door".to_owned(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: vec![Part::new(0, "base", 10), Part::new(1, "part1", 10)],
            joints: vec![Joint {
                range: [0.0, 1.5],
                observations: 3,
                bic: -1.0,
                log_likelihood: 1.0,
                configuration: vec![[0.0, 0.0]],
                ..Joint::of(&JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.4, 0.0, 1.1)))
            }],
            demonstrations: 1,
            profile: "default".into(),
            version: "0".into(),
        }
    }

    #[test]
    fn the_json_form_follows_the_contract() {
        let json = serde_json::to_value(door()).unwrap();
        assert_eq!(json["schema"], "linkage.model/1");
        assert_eq!(json["joints"][0]["type"], "revolute");
        assert_eq!(json["reference_frame"]["camera_from_object"][6], 1.0);
        assert_eq!(serde_json::from_value::<ObjectModel>(json).unwrap(), door());
    }

    #[test]
    fn what_is_no_pose_is_not_taken_for_the_identity() {
        assert_eq!(ReferenceFrame::at_camera(0.0).pose(), Some(Pose::identity()));
        assert_eq!(ReferenceFrame { t: 0.0, camera_from_object: [0.0; 7] }.pose(), None);
    }

    #[test]
    fn a_type_is_undecided_where_it_is_not_likely_enough() {
        let of = |p: f64| {
            let probabilities = [(JointKind::Prismatic, 1.0 - p), (JointKind::Revolute, p)].into();
            is_undecided(JointKind::Revolute, &probabilities)
        };
        assert!(of(0.6) && !of(0.97));
        assert!(of(0.01), "another type is likelier");
        assert!(!is_undecided(JointKind::Revolute, &BTreeMap::new()));
    }

    #[test]
    fn a_half_turn_carries_the_part_to_the_other_side_of_its_hinge() {
        let motions = door().part_motions(&[std::f64::consts::PI]);
        let handle = motions[1] * Point3::new(0.0, 0.2, 1.1);
        assert!((handle - Point3::new(0.8, 0.2, 1.1)).norm() < 1e-12);
    }
}
