//! An object for tests, and what makes a new store one of an earlier version.

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

/// Takes back what versions 6 to 8 brought.
pub const AS_IN_VERSION_5: &str = "
    DROP TRIGGER object_added;
    DROP TRIGGER object_changed;
    DROP TRIGGER object_removed;
    DROP TABLE total;
    DROP TABLE listed;
    DROP TABLE postings;
    DROP INDEX unlisted;
    ALTER TABLE words RENAME TO numbered;
    CREATE TABLE words (
        object TEXT PRIMARY KEY REFERENCES object (name) ON DELETE CASCADE,
        words BLOB NOT NULL
    );
    INSERT INTO words SELECT object, words FROM numbered;
    DROP TABLE numbered;
    ALTER TABLE object DROP COLUMN room;
    PRAGMA user_version = 5;";

/// Takes back what versions 7 and 8 brought.
pub const AS_IN_VERSION_6: &str = "
    DROP TRIGGER object_added;
    DROP TRIGGER object_changed;
    DROP TRIGGER object_removed;
    DROP TABLE total;
    DROP TABLE listed;
    ALTER TABLE words DROP COLUMN content;
    ALTER TABLE words DROP COLUMN checksum;
    ALTER TABLE postings DROP COLUMN checksum;
    ALTER TABLE object DROP COLUMN room;
    PRAGMA user_version = 6;";
