//! An object as the store's columns hold it, and the checksum over them.

use crate::features::DESCRIPTOR_LENGTH;
use crate::object::appearance::{Appearance, Edge, ModelFeature};
use crate::object::check::LARGEST_CONFIGURATION;
use crate::object::model::ObjectModel;
use crate::object::stored_object::{Provenance, StoredObject};

/// Largest coordinate of a place on an object, and largest feature, metres.
const LARGEST_PLACE: f32 = 1e4;
/// Longest normal: unit vectors, except for rounding; zero where unknown.
const LONGEST_NORMAL: f32 = 1.01;
/// Largest value of a colour in CIE L*a*b*.
const LARGEST_COLOUR: f32 = 1e3;

/// The column of an object without a room: an empty list.
const NO_ROOM: [u8; 1] = [0];

/// An object's columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The model as JSON.
    pub model: String,
    /// Features and surface.
    pub appearance: Vec<u8>,
    /// Edges of the surface.
    pub edges: Vec<u8>,
    /// Features of the room; one zero where none are known.
    pub room: Vec<u8>,
    /// Demonstrations, oldest first.
    pub provenance: Vec<Provenance>,
}

impl Record {
    /// The record of an object; it is checked that it can be read again.
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
            room: postcard::to_stdvec(&object.appearance.room).map_err(|e| e.to_string())?,
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
        let room: Vec<ModelFeature> =
            postcard::from_bytes(&self.room).map_err(|e| format!("room: {e}"))?;
        let appearance = Appearance { edges, room, ..appearance };
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
        // An object that was stored before rooms were known keeps its checksum.
        if self.room != NO_ROOM {
            sum.field(&self.room);
        }
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
    for (i, f) in appearance.features.iter().chain(&appearance.room).enumerate() {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::appearance::{Edge, Surfel};
    use crate::object::joint_geometry::JointGeometry;
    use crate::object::model::{Joint, Part};
    use crate::recognise::config::RecogniseConfig;
    use crate::recognise::retrieval::{Index, Words};
    use crate::recognise::{KnownObject, Scene, recognise};
    use crate::store::test_data::object;
    use crate::test_data::{board, features, seen};
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;
    use std::sync::{Arc, OnceLock};

    /// A board on a hinge, with surface and edges.
    fn flap() -> StoredObject {
        let mut flap = object("flap");
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(-0.2, 0.0, 1.5));
        flap.model.parts.push(Part::new(1, "board", 9));
        flap.model.joints.push(Joint { range: [0.0, 1.0], ..Joint::of(&line) });
        let normal = [0.0, 0.0, -1.0];
        let surfel = |i: u16| Surfel {
            part: i % 2,
            point: [f32::from(i % 20) * 0.02 - 0.2, f32::from(i / 20) * 0.02 - 0.2, 1.5],
            normal,
            lab: [50.0, 0.0, 0.0],
        };
        let edge = |i: u16| Edge {
            part: 1,
            surface: surfel(i).point,
            normal,
            beyond: [0.25, 0.0, 1.5],
            configurations: [0.0, 1.0],
        };
        flap.appearance = features(3);
        flap.appearance.surfels = (0..400).map(surfel).collect();
        flap.appearance.edges = (0..20).map(edge).collect();
        for (i, f) in flap.appearance.features.iter_mut().enumerate() {
            (f.part, f.point, f.normal) = ((i % 2) as u16, surfel(2 * i as u16).point, normal);
        }
        flap
    }

    /// Does with an object what recognition does.
    fn use_it(object: StoredObject) {
        static SCENE: OnceLock<Scene> = OnceLock::new();
        let scene = SCENE.get_or_init(|| Scene::new(&seen(1, board(0.2, 1.5, 1.5))).unwrap());
        let index = Index::new([Words::of(&object.appearance)]);
        index.rank(&scene.features, 1);
        let known = Arc::new(KnownObject::new(object.model, &object.appearance));
        let _ = recognise(scene, &[known], &RecogniseConfig::default(), 1);
    }

    #[test]
    fn an_object_comes_back_as_it_was_and_by_no_other_name() {
        let record = Record::of(&flap()).unwrap();
        assert_eq!(record.clone().object("flap").unwrap(), flap());
        assert!(record.clone().object("door").unwrap_err().contains("that of \"flap\""));
        assert_ne!(record.checksum("flap"), record.checksum("door"));
        use_it(flap());
    }

    #[test]
    fn what_nothing_could_read_again_is_not_stored() {
        let says = |change: fn(&mut StoredObject)| {
            let mut object = flap();
            change(&mut object);
            Record::of(&object).unwrap_err()
        };
        assert!(says(|o| o.model.joints[0].bic = f64::NAN).contains("joints[0].bic"));
        assert!(says(|o| o.appearance.features[7].part = 2).contains("feature 7"));
        assert!(says(|o| o.appearance.features[7].size_m = 0.0).contains("feature 7"));
        assert!(says(|o| o.appearance.features[7].descriptor.truncate(9)).contains("descriptor"));
        assert!(says(|o| o.appearance.surfels[5].point[1] = f32::NAN).contains("surfel 5"));
        assert!(says(|o| o.appearance.surfels[5].normal[1] = 3.0).contains("surfel 5"));
        assert!(says(|o| o.appearance.edges[1].beyond[0] = f32::INFINITY).contains("edge 1"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn bytes_that_nobody_wrote_are_refused_or_harm_nothing(
            appearance in proptest::collection::vec(any::<u8>(), 0..400),
            edges in proptest::collection::vec(any::<u8>(), 0..100),
        ) {
            let record = Record { appearance, edges, ..Record::of(&flap()).unwrap() };
            if let Ok(object) = record.object("flap") {
                use_it(object);
            }
        }

        #[test]
        fn a_byte_that_was_changed_is_refused_or_harms_nothing(
            place in any::<proptest::sample::Index>(), byte in any::<u8>(), in_edges in any::<bool>(),
        ) {
            let mut record = Record::of(&flap()).unwrap();
            let blob = if in_edges { &mut record.edges } else { &mut record.appearance };
            let place = place.index(blob.len());
            blob[place] = byte;
            if let Ok(object) = record.object("flap") {
                use_it(object);
            }
        }
    }
}
