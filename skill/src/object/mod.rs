//! What is known of an object: its parts and joints, and what it looks like.

pub(crate) mod appearance;
pub(crate) mod check;
pub(crate) mod joint_geometry;
pub(crate) mod model;
pub(crate) mod stored_object;
pub(crate) mod surface_end;

pub use appearance::Appearance;
pub use check::InvalidModel;
pub use joint_geometry::{JointGeometry, JointKind};
pub use model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
pub use stored_object::{Provenance, StoredObject};
