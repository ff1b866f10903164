//! What an object looks like, kept for recognition: described features with their places in
//! space and a thinned cloud of its surface, part by part (paper, section III-E, extended).
//!
//! All places are in the object frame with every joint at configuration 0.

use crate::features::FeatureKind;
use serde::{Deserialize, Serialize};

/// A described feature of a part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelFeature {
    /// The part it lies on.
    pub part: u16,
    /// How it was described.
    pub kind: FeatureKind,
    /// Place, metres.
    pub point: [f32; 3],
    /// Unit surface normal; zero where unknown.
    pub normal: [f32; 3],
    /// Diameter of what is described, metres.
    pub size_m: f32,
    /// RootSIFT scaled to bytes.
    pub descriptor: Vec<u8>,
}

/// A small piece of surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Surfel {
    /// The part it lies on.
    pub part: u16,
    /// Place, metres.
    pub point: [f32; 3],
    /// Unit normal.
    pub normal: [f32; 3],
    /// CIE L*a*b*, slightly blurred.
    pub lab: [f32; 3],
}

/// An edge of a part's surface; places in the object frame at configuration 0, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Edge {
    /// The part.
    pub part: u16,
    /// A place on its surface.
    pub surface: [f32; 3],
    /// The unit normal there.
    pub normal: [f32; 3],
    /// A place in the tangent plane where nothing is.
    pub beyond: [f32; 3],
    /// Configurations of the part's joint between which that is known; 0 for the base.
    pub configurations: [f32; 2],
}

/// The appearance of an object.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Appearance {
    /// Features.
    pub features: Vec<ModelFeature>,
    /// Surface.
    pub surfels: Vec<Surfel>,
    /// Where that is known to end. The store keeps it apart: older ones have none.
    #[serde(skip)]
    pub edges: Vec<Edge>,
    /// Features of what stood around the object and is not its own, as features of part 0: they tell
    /// where to look in the same room again, and decide nothing. Kept apart as well.
    #[serde(skip)]
    pub room: Vec<ModelFeature>,
}
