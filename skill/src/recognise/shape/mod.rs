//! Recognition by shape, for plain objects without features: the contour of a part (where its surface is known to
//! end) is laid on the contour in the image.
//!
//! In: a scene and a known object.
//! Out: hypotheses of each part's pose, like those that `hypothesis` makes of matches; refinement and verification
//! are shared.
//! From: ours; compare the edge-based point-pair features of Drost & Ilic 2012, which need pairs. A contour point
//! has a normal and a direction outward, so that one point of the model and one of the image give a whole pose.
//! Along a straight edge that pose is ambiguous; the other edges determine it.

mod contour;
mod contour_grid;
mod end_profile;
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
