//! An object as a store keeps it: its motion, its appearance and its demonstrations.

use crate::object::appearance::Appearance;
use crate::object::model::ObjectModel;

/// Where an object's knowledge comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Provenance {
    /// Recording.
    pub source: String,
    /// When it was learned, microseconds since 1970.
    pub learned_utime: i64,
}

/// An object as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredObject {
    /// Motion.
    pub model: ObjectModel,
    /// Looks.
    pub appearance: Appearance,
    /// Demonstrations, oldest first.
    pub provenance: Vec<Provenance>,
}
