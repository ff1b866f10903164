//! Occlusion-edge test: an object with the appearance of the learned one, but whose surface continues beyond the
//! learned edges, is another object.
//!
//! In: the learned edges (object frame at configuration 0, metres), a state, and a depth buffer of the object's own
//! visible surface in that state.
//! Out: by part, the number of edges that end as learned, and of those beyond which the surface continues.

use super::kinematics::{Articulated, State};
use super::render_cloud::{DepthBuffer, KnownEdge, NEAREST_M};
use super::scene::Scene;
use crate::object::surface_end::is_empty;
use nalgebra::{Point2, Point3, Vector3, center};

/// Edges of a part, counted by what is seen beyond them.
#[derive(Debug, Clone, Copy, Default)]
pub struct EdgeCounts {
    /// Number of edges beyond which there is free space, as learned.
    pub as_learned: usize,
    /// Number of edges beyond which the surface continues.
    pub goes_on: usize,
}

/// Number of edges added to those of the base, so that a few that continue prove nothing: furniture may stand flush
/// with it.
const BY_CHANCE_OF_BASE: f64 = 40.0;
/// Number of edges added to those of a moving part, so that a few that continue prove nothing.
const BY_CHANCE: f64 = 10.0;
/// Share of edges that continue from which they count against the part.
const LEAST_SHARE: f64 = 0.4;
/// Share of edges that continue from which the part is not the learned one.
const MOST_SHARE: f64 = 0.6;

impl EdgeCounts {
    /// Likeness of the edges, 0 to 1: 1 if the part ends as learned, 0 if its surface continues.
    pub fn likeness(&self, of_base: bool) -> f64 {
        let by_chance = if of_base { BY_CHANCE_OF_BASE } else { BY_CHANCE };
        let share = self.goes_on as f64 / ((self.as_learned + self.goes_on) as f64 + by_chance);
        ((MOST_SHARE - share) / (MOST_SHARE - LEAST_SHARE)).clamp(0.0, 1.0)
    }
}

/// Counts what is seen beyond those edges whose own surface is seen, by part. `buffer`: depth buffer of the object's
/// visible surface.
pub fn test_edges(
    scene: &Scene,
    articulated: &Articulated,
    edges: &[KnownEdge],
    state: &State,
    buffer: &DepthBuffer,
) -> Vec<EdgeCounts> {
    let poses = articulated.poses(state);
    let configuration: Vec<Option<f64>> = (0..articulated.parts)
        .map(|part| articulated.joints.iter().position(|j| j.child == part).map(|j| state.q[j]))
        .collect();
    let mut counts = vec![EdgeCounts::default(); articulated.parts];
    for e in edges {
        let [low, high] = e.configurations;
        if configuration[e.part].is_some_and(|q| q < low || q > high) {
            continue;
        }
        let pose = &poses[e.part];
        let (surface, beyond, normal) = (pose * e.surface, pose * e.beyond, pose * e.normal);
        let at = |place: &Point3<f64>| at(scene, place, &normal);
        let is_own = pixel_of(scene, &beyond)
            .is_none_or(|pixel| buffer.shows_another_part(pixel, e.part, beyond.z));
        if is_own || at(&surface) != Some(There::Surface) {
            continue;
        }
        match at(&beyond) {
            Some(There::Nothing) => counts[e.part].as_learned += 1,
            Some(There::Surface) if at(&center(&surface, &beyond)) == Some(There::Surface) => {
                counts[e.part].goes_on += 1;
            }
            _ => {}
        }
    }
    counts
}

/// What is seen at a place.
#[derive(PartialEq)]
enum There {
    /// Free space: the camera sees through the place.
    Nothing,
    /// A surface with the requested normal.
    Surface,
}

/// What is seen at a place in the camera frame: free space, or a surface with this normal on either side; `None` if
/// something else is there or occludes it.
fn at(scene: &Scene, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<There> {
    if is_empty(&scene.frame, place, normal)? {
        return Some(There::Nothing);
    }
    let (u, v) = pixel_of(scene, place)?;
    let surface = scene.surface(u, v)?;
    (surface.normal.dot(normal).abs() > PARALLEL).then_some(There::Surface)
}

/// Smallest absolute cosine between two normals of one surface.
const PARALLEL: f64 = 0.87;

/// Pixel at which a place is seen; `None` if it is outside the image or too near.
fn pixel_of(scene: &Scene, place: &Point3<f64>) -> Option<(usize, usize)> {
    let camera = &scene.frame.camera;
    let near: Option<Point2<f64>> = (place.z >= NEAREST_M).then(|| camera.project(place)).flatten();
    near.filter(|p| camera.sees(p, 2.0)).map(|p| ((p.x + 0.5) as usize, (p.y + 0.5) as usize))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::test_data::{board, seen};

    /// A learned board of 40 cm with an edge on its right, before a board this wide.
    fn before_a_board(half: f64) -> EdgeCounts {
        let edge = KnownEdge {
            part: 0,
            surface: Point3::new(0.17, 0.0, 1.5),
            normal: -Vector3::z(),
            beyond: Point3::new(0.21, 0.0, 1.5),
            configurations: [0.0; 2],
        };
        let scene = Scene::plain(&seen(1, board(half, 1.5, 2.5))).unwrap();
        let alone = Articulated { parts: 1, joints: Vec::new() };
        let state = State { camera_from_object: Pose::identity(), q: Vec::new() };
        test_edges(&scene, &alone, &[edge], &state, &DepthBuffer::of(&[]))[0]
    }

    #[test]
    fn a_board_ends_where_the_learned_one_does_or_goes_on() {
        let counts = |edges: EdgeCounts| (edges.as_learned, edges.goes_on);
        assert_eq!(counts(before_a_board(0.20)), (1, 0));
        assert_eq!(counts(before_a_board(0.27)), (0, 1));
        // If the surface itself is not seen, what is beyond is no evidence.
        assert_eq!(counts(before_a_board(0.10)), (0, 0));
    }

    #[test]
    fn what_goes_on_at_most_edges_is_another_thing() {
        let likeness = |as_learned, goes_on| EdgeCounts { as_learned, goes_on }.likeness(false);
        assert_eq!(likeness(100, 3), 1.0);
        assert_eq!(likeness(2, 60), 0.0);
    }

    #[test]
    fn a_few_edges_prove_nothing() {
        assert_eq!(EdgeCounts { as_learned: 0, goes_on: 5 }.likeness(false), 1.0);
        assert_eq!(EdgeCounts { as_learned: 8, goes_on: 24 }.likeness(true), 1.0);
    }
}
