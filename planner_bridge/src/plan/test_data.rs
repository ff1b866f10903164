//! A fridge for tests: its door turns about a vertical line, 0 to 1.5 rad, and stands open
//! by 0.3 rad.

use linkage_skill::internals::covariance_rows;
use linkage_skill::object::{
    Joint, JointGeometry, JointKind, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame,
};
use linkage_skill::recognise::{JointState, Recognised};
use nalgebra::{Matrix6, Point3, Vector3};

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
        evidence: Vec::new(),
        assumed: vec![0.3],
    };
    (model, recognised)
}
