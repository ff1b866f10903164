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
mod part_alignment;
mod pose_search;

use super::kinematics::{Articulated, State};
use super::render_cloud::{Cloud, CloudPoint, KnownEdge};
use super::scene::Scene;
use contour::{ContourPoint, contour_of_object, contour_of_scene};
pub use contour_grid::ContourGrid;
pub use ends::{EndsInSight, ends_in_sight};
pub use part_alignment::add_contour;
pub use pose_search::shape_hypotheses;

/// Shape of a known object, part by part (object frame at configuration 0, metres).
pub struct ObjectShape {
    /// Where its surface is known to end.
    pub contour: Vec<ContourPoint>,
    /// The surface of each part alone.
    clouds: Vec<Cloud>,
}

impl ObjectShape {
    /// Of all edges of an object, and its surface, thinned.
    pub fn new(edges: &[KnownEdge], coarse: &Cloud, parts: usize) -> Self {
        let of_part = |part: usize| {
            let own: Vec<CloudPoint> =
                coarse.surfels.iter().filter(|s| s.part == part).copied().collect();
            Cloud::of(own)
        };
        let clouds = (0..parts).map(of_part).collect();
        Self { contour: contour_of_object(edges), clouds }
    }

    /// The contour that is known at the configurations of a state.
    pub fn known_at<'s>(
        &'s self,
        articulated: &Articulated,
        state: &State,
    ) -> impl Iterator<Item = &'s ContourPoint> {
        let configuration: Vec<Option<f64>> = (0..articulated.parts)
            .map(|part| articulated.joints.iter().position(|j| j.child == part).map(|j| state.q[j]))
            .collect();
        self.contour.iter().filter(move |c| {
            let [low, high] = c.configurations;
            configuration[c.part].is_none_or(|q| q >= low && q <= high)
        })
    }
}

/// The contour of a picture.
pub fn contour_grid(scene: &Scene) -> ContourGrid {
    let camera = &scene.frame.camera;
    ContourGrid::new(contour_of_scene(scene), camera.depth_sensor, camera.fx)
}
