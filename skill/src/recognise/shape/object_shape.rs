//! Shape of a known object, and a picture's contour beside it.
//!
//! In: the edges of an object and its surface (object frame at configuration 0, metres). Out: its contour
//! and the surface of each part alone.

use super::super::kinematics::{Articulated, State};
use super::super::render_cloud::{Cloud, CloudPoint, KnownEdge};
use super::contour::{ContourPoint, contour_of_object};
use super::contour_grid::ContourGrid;

/// Shape of a known object, part by part (object frame at configuration 0, metres).
pub struct ObjectShape {
    /// Where its surface is known to end.
    pub contour: Vec<ContourPoint>,
    /// The surface of each part alone.
    pub clouds: Vec<Cloud>,
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

/// An object's shape and the contour of the picture in which it is looked for.
#[derive(Clone, Copy)]
pub struct Contours<'c> {
    /// The object's.
    pub shape: &'c ObjectShape,
    /// The picture's.
    pub seen: &'c ContourGrid,
}
