//! An object of the store, prepared once for matching against many scenes.
//!
//! In: its model and its appearance (object frame at configuration 0, metres). Out: its features in
//! a table that is compared at once, its surface, and a thinned copy of the surface for the many
//! configurations that are only compared roughly.

use super::matching::FeatureTable;
use super::render_cloud::Cloud;
use crate::object::appearance::Appearance;
use crate::object::model::ObjectModel;

/// An object with its appearance prepared for matching.
pub struct KnownObject {
    /// Motion.
    pub model: ObjectModel,
    pub(super) table: FeatureTable,
    pub(super) cloud: Cloud,
    pub(super) coarse: Cloud,
}

impl KnownObject {
    /// Prepares an object.
    pub fn new(model: ObjectModel, appearance: &Appearance) -> Self {
        let cloud = Cloud::new(appearance);
        Self { model, table: FeatureTable::new(appearance), coarse: cloud.thinned(), cloud }
    }
}
