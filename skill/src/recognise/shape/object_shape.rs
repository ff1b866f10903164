//! Shape of a known object, and the contour of the image in which it is searched.
//!
//! In: the edges of an object and its surface (object frame at configuration 0, metres).
//! Out: its contour, and the surface of each part alone.

use super::super::kinematics::{Articulated, State};
use super::super::render_cloud::{Cloud, CloudPoint, KnownEdge};
use super::contour::{ContourPoint, contour_of_object};
use super::contour_grid::ContourGrid;

/// Shape of a known object, by part (object frame at configuration 0, metres).
pub struct ObjectShape {
    /// Contour: where the surface of the object is known to end.
    pub contour: Vec<ContourPoint>,
    /// Surface of each part alone.
    pub clouds: Vec<Cloud>,
}

impl ObjectShape {
    /// Shape of all edges of an object and of its thinned surface.
    pub fn new(edges: &[KnownEdge], coarse: &Cloud, parts: usize) -> Self {
        let of_part = |part: usize| {
            let own: Vec<CloudPoint> =
                coarse.surfels.iter().filter(|s| s.part == part).copied().collect();
            Cloud::of(own)
        };
        let clouds = (0..parts).map(of_part).collect();
        Self { contour: contour_of_object(edges), clouds }
    }

    /// Contour points that are known at the configurations of a state.
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

/// Shape of an object and the contour of the image in which it is searched.
#[derive(Clone, Copy)]
pub struct Contours<'c> {
    /// Shape of the object.
    pub shape: &'c ObjectShape,
    /// Contour of the image.
    pub seen: &'c ContourGrid,
}
