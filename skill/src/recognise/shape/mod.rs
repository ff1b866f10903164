//! Recognition by shape: what is plain has no features, but it ends somewhere. The contour of a part
//! (where its surface is known to end) is laid on the contour that the picture shows.
//!
//! In: a scene and a known object. Out: hypotheses of each part's pose, as `hypothesis` gives them from
//! matches of features; refinement and verification are the same. Each place of a contour has a
//! normal and a direction outward, so that one place of the model and one of the picture give a
//! whole pose; that it is right along a straight edge, the other edges tell (compare the
//! edge-based point-pair features of Drost & Ilic 2012, which need pairs).

mod contour;
mod contour_grid;
mod ends;
mod object_shape;
mod part_alignment;
mod pose_search;
#[cfg(test)]
pub mod test_data;

pub use contour_grid::ContourGrid;
pub use ends::{EndsInSight, ends_in_sight};
pub use object_shape::{Contours, ObjectShape};
pub use part_alignment::add_contour;
pub use pose_search::shape_hypotheses;
