//! An object of the store, prepared once for matching against many scenes.
//!
//! In: its model and its appearance (object frame at configuration 0, metres). Out: its features in
//! a table that is compared at once, its surface, a thinned copy of the surface for the many
//! configurations that are only compared roughly, and where the surface ends.

use super::matching::FeatureTable;
use super::render_cloud::{Cloud, known_edges};
use super::shape::ObjectShape;
use crate::object::appearance::{Appearance, Edge};
use crate::object::model::ObjectModel;
use std::sync::OnceLock;

/// An object with its appearance prepared for matching.
pub struct KnownObject {
    /// Motion.
    pub model: ObjectModel,
    pub(super) table: FeatureTable,
    /// Features of the room in which it was last seen.
    pub(super) room: FeatureTable,
    pub(super) cloud: Cloud,
    pub(super) coarse: Cloud,
    /// Where it is known to end, as stored.
    edges: Vec<Edge>,
    shape: OnceLock<ObjectShape>,
}

impl KnownObject {
    /// Prepares an object.
    pub fn new(model: ObjectModel, appearance: &Appearance) -> Self {
        let (table, cloud) = (FeatureTable::new(&appearance.features), Cloud::new(appearance));
        let room = FeatureTable::new(&appearance.room);
        Self { room, ..Self::of(model, table, cloud, appearance.edges.clone()) }
    }

    /// Of its prepared features and surface, and all its edges.
    pub(super) fn of(
        model: ObjectModel,
        table: FeatureTable,
        cloud: Cloud,
        edges: Vec<Edge>,
    ) -> Self {
        let room = FeatureTable::new(&[]);
        Self { model, table, room, coarse: cloud.thinned(), cloud, edges, shape: OnceLock::new() }
    }

    /// Its shape, worked out when it is first looked for by it.
    pub(super) fn shape(&self) -> &ObjectShape {
        let new =
            || ObjectShape::new(&known_edges(&self.edges), &self.coarse, self.model.parts.len());
        self.shape.get_or_init(new)
    }
}
