//! An object of the store, prepared once for matching against many scenes.
//!
//! In: its model and its appearance (object frame at configuration 0, metres).
//! Out: tables of features for matching, the surface, a thinned copy of the surface to compare many configurations
//! roughly, and the edges of the surface.

use super::matching::FeatureTable;
use super::render_cloud::{Cloud, known_edges};
use super::shape::ObjectShape;
use crate::object::appearance::{Appearance, Edge};
use crate::object::model::ObjectModel;
use std::sync::OnceLock;

/// An object with its appearance prepared for matching.
pub struct KnownObject {
    /// Parts and joints.
    pub model: ObjectModel,
    pub(super) table: FeatureTable,
    /// Features of what stood around the object, not its own.
    pub(super) room: FeatureTable,
    pub(super) cloud: Cloud,
    pub(super) coarse: Cloud,
    /// All known edges of the surface, as stored; `cloud` holds some of them.
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

    /// Creates an object of prepared features and surface, and all its edges; without a room.
    pub(super) fn of(
        model: ObjectModel,
        table: FeatureTable,
        cloud: Cloud,
        edges: Vec<Edge>,
    ) -> Self {
        let room = FeatureTable::new(&[]);
        Self { model, table, room, coarse: cloud.thinned(), cloud, edges, shape: OnceLock::new() }
    }

    /// Shape of the object, computed on first use.
    pub(super) fn shape(&self) -> &ObjectShape {
        let new =
            || ObjectShape::new(&known_edges(&self.edges), &self.coarse, self.model.parts.len());
        self.shape.get_or_init(new)
    }
}
