//! An object's columns as a store holds them: what is read can be prepared for recognition.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_skill::internals::Record;
use linkage_skill::object::{MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use linkage_skill::recognise::KnownObject;

fuzz_target!(|data: (Vec<u8>, Vec<u8>, Vec<u8>)| {
    let model = ObjectModel {
        schema: MODEL_SCHEMA.to_owned(),
        object: "door".to_owned(),
        reference_frame: ReferenceFrame::at_camera(0.0),
        parts: vec![Part::new(0, "base", 1)],
        joints: Vec::new(),
        demonstrations: 1,
        profile: "default".to_owned(),
        version: "0".to_owned(),
    };
    let model = serde_json::to_string(&model).expect("a model can be written");
    let (appearance, edges, room) = data;
    let record = Record { model, appearance, edges, room, provenance: Vec::new() };
    if let Ok(object) = record.object("door") {
        KnownObject::new(object.model, &object.appearance);
    }
});
