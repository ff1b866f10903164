//! What is known of an object: its parts and joints, and what it looks like.

pub mod appearance;
pub mod check;
pub mod joint_geometry;
pub mod model;
