//! An object for tests.

use crate::object::appearance::Appearance;
use crate::object::model::{MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use crate::object::stored_object::{Provenance, StoredObject};

/// An object without joints and without features.
pub fn object(name: &str) -> StoredObject {
    StoredObject {
        model: ObjectModel {
            schema: MODEL_SCHEMA.into(),
            object: name.into(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: vec![Part::new(0, "base", 1)],
            joints: Vec::new(),
            demonstrations: 1,
            profile: "default".into(),
            version: "0".into(),
        },
        appearance: Appearance::default(),
        provenance: vec![Provenance { source: "tum:x".into(), learned_utime: 5 }],
    }
}
