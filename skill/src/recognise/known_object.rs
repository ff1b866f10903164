//! An object of the store, prepared once for matching against many scenes.
//!
//! In: its model and its appearance (object frame at configuration 0, metres). Out: its features in
//! a table that is compared at once, its surface, a thinned copy of the surface for the many
//! configurations that are only compared roughly, and where the surface ends.

use super::matching::FeatureTable;
use super::render_cloud::{Cloud, known_edges};
use super::shape::ObjectShape;
use crate::object::appearance::Appearance;
use crate::object::model::ObjectModel;

/// An object with its appearance prepared for matching.
pub struct KnownObject {
    /// Motion.
    pub model: ObjectModel,
    pub(super) table: FeatureTable,
    pub(super) cloud: Cloud,
    pub(super) coarse: Cloud,
    pub(super) shape: ObjectShape,
}

impl KnownObject {
    /// Prepares an object.
    pub fn new(model: ObjectModel, appearance: &Appearance) -> Self {
        let cloud = Cloud::new(appearance);
        let coarse = cloud.thinned();
        let shape = ObjectShape::new(&known_edges(appearance), &coarse, model.parts.len());
        Self { model, table: FeatureTable::new(appearance), coarse, shape, cloud }
    }
}
