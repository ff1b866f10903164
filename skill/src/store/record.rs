//! An object as the store's columns hold it, and the checksum over them.

use super::{Provenance, StoredObject};
use crate::appearance::{Appearance, DESCRIPTOR_LENGTH, Edge};
use crate::model::{LARGEST_CONFIGURATION, ObjectModel};

/// Largest coordinate of a place on an object, and largest feature, metres.
const LARGEST_PLACE: f32 = 1e4;
/// Longest normal: unit vectors, but for rounding; zero where unknown.
const LONGEST_NORMAL: f32 = 1.01;
/// Largest value of a colour in CIE L*a*b*.
const LARGEST_COLOUR: f32 = 1e3;

/// An object's columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The model as JSON.
    pub model: String,
    /// Features and surface.
    pub appearance: Vec<u8>,
    /// Edges of the surface.
    pub edges: Vec<u8>,
    /// Demonstrations, oldest first.
    pub provenance: Vec<Provenance>,
}

impl Record {
    /// Of an object that can be read again.
    ///
    /// # Errors
    /// What is wrong with the object, in words.
    pub fn of(object: &StoredObject) -> Result<Self, String> {
        object.model.check().map_err(|e| e.to_string())?;
        check_appearance(&object.appearance, object.model.parts.len())?;
        Ok(Self {
            model: serde_json::to_string(&object.model).map_err(|e| e.to_string())?,
            appearance: postcard::to_stdvec(&object.appearance).map_err(|e| e.to_string())?,
            edges: postcard::to_stdvec(&object.appearance.edges).map_err(|e| e.to_string())?,
            provenance: object.provenance.clone(),
        })
    }

    /// The object of a name.
    ///
    /// # Errors
    /// What is wrong with the columns, in words: they cannot be decoded, hold another object, or
    /// one that nothing could work with.
    pub fn object(self, name: &str) -> Result<StoredObject, String> {
        let model: ObjectModel = serde_json::from_str(&self.model).map_err(|e| e.to_string())?;
        if model.object != name {
            return Err(format!("its model is that of \"{}\"", model.object));
        }
        let appearance: Appearance =
            postcard::from_bytes(&self.appearance).map_err(|e| format!("appearance: {e}"))?;
        let edges: Vec<Edge> =
            postcard::from_bytes(&self.edges).map_err(|e| format!("edges: {e}"))?;
        let appearance = Appearance { edges, ..appearance };
        check_appearance(&appearance, model.parts.len())?;
        Ok(StoredObject { model, appearance, provenance: self.provenance })
    }

    /// A checksum over all columns and the name.
    pub fn checksum(&self, name: &str) -> u32 {
        let mut sum = Checksum::default();
        sum.field(name.as_bytes());
        sum.field(self.model.as_bytes());
        sum.field(&self.appearance);
        sum.field(&self.edges);
        for p in &self.provenance {
            sum.field(p.source.as_bytes());
            sum.field(&p.learned_utime.to_le_bytes());
        }
        sum.finish()
    }
}

/// A CRC-32 over fields, each with its length, so that none is taken for a part of another.
#[derive(Default)]
pub struct Checksum(crc32fast::Hasher);

impl Checksum {
    /// Adds a field.
    pub fn field(&mut self, bytes: &[u8]) {
        self.0.update(&(bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }

    /// The sum.
    pub fn finish(self) -> u32 {
        self.0.finalize()
    }
}

/// Places, sizes and colours are numbers, and lie on parts of the model.
fn check_appearance(appearance: &Appearance, parts: usize) -> Result<(), String> {
    let is_part = |part: u16| usize::from(part) < parts;
    let is_place = |p: &[f32; 3]| p.iter().all(|x| x.abs() <= LARGEST_PLACE);
    let is_normal = |n: &[f32; 3]| n.iter().map(|x| x * x).sum::<f32>().sqrt() <= LONGEST_NORMAL;
    let is_configuration = |q: &f32| f64::from(q.abs()) <= LARGEST_CONFIGURATION;
    let place_of = |what: &str, i: usize| format!("{what} {i} has no place on a part");
    for (i, f) in appearance.features.iter().enumerate() {
        let is_sized = f.size_m > 0.0 && f.size_m <= LARGEST_PLACE;
        if !(is_part(f.part) && is_place(&f.point) && is_normal(&f.normal) && is_sized) {
            return Err(place_of("feature", i));
        }
        if f.descriptor.len() != DESCRIPTOR_LENGTH {
            return Err(format!("the descriptor of feature {i} has another length"));
        }
    }
    for (i, s) in appearance.surfels.iter().enumerate() {
        let is_colour = s.lab.iter().all(|x| x.abs() <= LARGEST_COLOUR);
        if !(is_part(s.part) && is_place(&s.point) && is_normal(&s.normal) && is_colour) {
            return Err(place_of("surfel", i));
        }
    }
    for (i, e) in appearance.edges.iter().enumerate() {
        let are_places = is_place(&e.surface) && is_place(&e.beyond) && is_normal(&e.normal);
        if !(is_part(e.part) && are_places && e.configurations.iter().all(is_configuration)) {
            return Err(place_of("edge", i));
        }
    }
    Ok(())
}
