//! Models from other programs, and damaged ones: each is refused as it is read, or harms nothing
//! that works with models.

use crate::export::{Description, mjcf, sdf, urdf, usd};
use crate::report::{Asked, prediction_page, recognition_page, save_prediction_picture, summary};
use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use linkage_planner_bridge::messages::Stamps;
use linkage_planner_bridge::{Request, Rig, messages, predict};
use linkage_skill::ObjectModel;
use linkage_skill::internals::Surfel;
use linkage_skill::learn::StageTimes;
use linkage_skill::object::{
    Appearance, Joint, JointGeometry, MODEL_SCHEMA, Part, Provenance, ReferenceFrame, StoredObject,
};
use linkage_skill::predict::Target;
use linkage_skill::recognise::{JointState, Recognised, Recognition};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A fridge's door, with a drawer in it that a hand held, and a lid that screws.
fn good() -> ObjectModel {
    let part = |(id, name): (usize, &str)| Part::new(id, name, 9);
    let mut parts: Vec<Part> =
        ["base", "door", "drawer", "lid"].into_iter().enumerate().map(part).collect();
    parts[2].grasp = Some([0.1, 0.1, 1.0]);
    let lines = [
        JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.4, 0.0, 1.1)),
        JointGeometry::slide(-Vector3::z_axis(), Point3::new(0.0, 0.2, 1.0)),
        JointGeometry::screw(Vector3::y_axis(), Point3::new(-0.3, 0.0, 1.2), 0.01),
    ];
    let joint = |(i, parent): (usize, usize)| Joint {
        name: format!("joint{}", i + 1),
        parent,
        child: i + 1,
        range: [-0.1, 0.8],
        configuration: vec![[0.0, 0.0], [0.5, 0.4]],
        type_probabilities: BTreeMap::from([(lines[i].kind, 0.97)]),
        ..Joint::of(&lines[i])
    };
    ObjectModel {
        schema: MODEL_SCHEMA.to_owned(),
        object: "fridge".to_owned(),
        reference_frame: ReferenceFrame::at_camera(1.0),
        parts,
        joints: [0, 1, 0].into_iter().enumerate().map(joint).collect(),
        demonstrations: 1,
        profile: "default".to_owned(),
        version: "0".to_owned(),
    }
}

/// What a field may be found to hold.
fn unexpected_value() -> impl Strategy<Value = Value> {
    let values = [
        json!(null),
        json!(true),
        json!(""),
        json!("\u{0}"),
        json!("fixed"),
        json!("nonparametric"),
        json!("helical"),
        json!("joint1"),
        json!([]),
        json!({}),
        json!([[0.0, 0.0]]),
        json!(-1),
        json!(0),
        json!(1),
        json!(2),
        json!(3),
        json!(4),
        json!(u64::MAX),
        json!(-0.5),
        json!(1e-320),
        json!(999.0),
        json!(-999.0),
        json!(1e5),
        json!(1e308),
        json!(-1e308),
    ];
    proptest::sample::select(values.to_vec())
}

/// All places in a value, as JSON pointers.
fn places(value: &Value, here: &str, all: &mut Vec<String>) {
    all.push(here.to_owned());
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(key, field)| places(field, &format!("{here}/{key}"), all));
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, item)| {
                places(item, &format!("{here}/{i}"), all);
            });
        }
        _ => {}
    }
}

/// A change of one place: something else in it, or it is not there, or it is there twice.
fn change(model: &mut Value, place: proptest::sample::Index, what: &Option<Value>) {
    let mut all = Vec::new();
    places(model, "", &mut all);
    let at = &all[1..][place.index(all.len() - 1)];
    let (within, last) = at.rsplit_once('/').expect("it has a slash");
    match (model.pointer_mut(within), what) {
        (_, Some(value)) => *model.pointer_mut(at).expect("it is there") = value.clone(),
        (Some(Value::Object(fields)), None) => drop(fields.remove(last)),
        (Some(Value::Array(items)), None) => {
            let item = items[last.parse::<usize>().expect("a number")].clone();
            items.insert(0, item);
        }
        _ => unreachable!("a place lies in an object or an array"),
    }
}

fn stored(model: ObjectModel) -> StoredObject {
    let surfel = |i: u16| Surfel {
        part: i % model.parts.len() as u16,
        point: [f32::from(i % 20) * 0.02 - 0.2, f32::from(i / 20) * 0.02 - 0.2, 1.0],
        normal: [0.0, 0.0, -1.0],
        lab: [50.0, 0.0, 0.0],
    };
    let surfels = (0..400).map(surfel).collect();
    let appearance = Appearance { surfels, ..Appearance::default() };
    let provenance = vec![Provenance { source: "test".to_owned(), learned_utime: 0 }];
    StoredObject { model, appearance, provenance }
}

/// The object where it was learned, every joint at the middle of its range.
fn recognised(model: &ObjectModel) -> Recognised {
    let state = |j: &Joint| JointState {
        name: j.name.clone(),
        kind: j.kind,
        axis: j.axis,
        origin: j.origin,
        pitch: j.pitch,
        configuration: Some(0.5 * (j.range[0] + j.range[1])),
        deviation: Some(0.01),
        reason: None,
        range: j.range,
    };
    Recognised {
        object: model.object.clone(),
        score: 0.9,
        inliers: 40,
        camera_from_object: model.reference_frame.camera_from_object,
        base_known: true,
        joints: model.joints.iter().map(state).collect(),
        evidence: Vec::new(),
        assumed: model.joints.iter().map(|j| j.range[0]).collect(),
    }
}

fn frame() -> RgbdFrame {
    let camera = PinholeCamera { width: 160, height: 120, ..PinholeCamera::kinect() };
    let color = ColorImage::new(160, 120, vec![99; 160 * 120 * 3]).unwrap();
    let depth = DepthImage::from_metres(160, 120, vec![1.0; 160 * 120]).unwrap();
    RgbdFrame::new(1, Arc::new(camera), color, depth).unwrap()
}

/// Uses a model in every way in which models from files are used. Errors are answers.
fn use_it(model: ObjectModel, scratch: &Path) {
    let found = recognised(&model);
    assert!(model.joints.is_empty() || !summary(&model).is_empty());
    let middle: Vec<f64> = found.joints.iter().filter_map(|j| j.configuration).collect();
    let finite = |x: &f64| x.is_finite();
    let motions = model.part_motions(&middle);
    assert!(motions.iter().all(|m| m.translation.vector.iter().all(finite)));
    let object = stored(model.clone());
    if let Ok(description) = Description::new(&object, &Rig::default()) {
        for write in [urdf, sdf, mjcf, usd] {
            if let Ok(text) = write(&description) {
                assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
            }
        }
    }
    messages::model(&model, 1);
    let (frame, rig, times) = (frame(), Rig::default(), StageTimes::default());
    for target in [Target::Open, Target::Closed, Target::Value(0.1)] {
        let Ok(plan) = predict(&model, &found, &Request::to(target), &rig) else { continue };
        let stamps = Stamps { captured: 1, made: 1 };
        messages::prediction(&plan.prediction, &model, stamps);
        let _ = messages::robot_plan(&plan, stamps);
        let picture = scratch.join("prediction.png");
        let prediction = &plan.prediction;
        save_prediction_picture(&frame, &found, prediction, &object, &picture).unwrap();
        prediction_page(&frame, &found, &object, Ok(prediction), &times).unwrap();
    }
    let asked = Asked { known: 1, min_score: 0.5, objects: &[object], times: &times };
    let recognition = Recognition { best_refused: 0.0, ..Recognition::new(vec![found]) };
    recognition_page(&frame, &recognition, &asked).unwrap();
}

#[test]
fn a_good_model_can_be_used() {
    let scratch = tempfile::tempdir().unwrap();
    assert_eq!(good().check(), Ok(()));
    use_it(good(), scratch.path());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn a_changed_model_is_refused_or_harms_nothing(
        changes in proptest::collection::vec(
            (any::<proptest::sample::Index>(), proptest::option::weighted(0.8, unexpected_value())), 1..4),
    ) {
        let scratch = tempfile::tempdir().unwrap();
        let mut json = serde_json::to_value(good()).unwrap();
        for (place, what) in &changes {
            if json.as_object().is_some_and(|fields| !fields.is_empty()) {
                change(&mut json, *place, what);
            }
        }
        if let Ok(model) = serde_json::from_value::<ObjectModel>(json) {
            let start = Instant::now();
            use_it(model, scratch.path());
            prop_assert!(start.elapsed() < Duration::from_secs(20), "it runs away");
        }
    }
}
