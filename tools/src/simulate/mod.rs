//! The RGB-D simulator: articulated things moved by a hand before a noisy camera, with exact
//! truth beside the recording.
//!
//! World frame: x right, y away from the viewer, z up; metres. Every part is described where
//! it is at configuration 0, so that a part's frame is the world at configuration 0.

mod devices;
mod film;
mod furniture;
mod home;
pub mod instances;
mod kit;
mod person;
mod record;
mod render;
mod scenes;
mod sensor;
mod tags;
mod texture;
mod world;

pub use film::{Shot, Take};
pub use home::{Surfaces, paint};
pub use record::record;
pub use scenes::{SCENES, add_common_clutter, repainted, reproportioned, scene};
pub use texture::TextureClass;
pub use world::Scene;
