//! Does the surface end where the learned one does? A thing that looks like the learned one and
//! goes on beyond its edges is another one.

use super::kinematics::{Articulated, State};
use super::scene::Scene;
use super::verify::{DepthBuffer, NEAREST_M};
use crate::learn::appearance::occlusion_edges::is_empty;
use crate::object::appearance::{Appearance, Edge};
use nalgebra::{Point2, Point3, Vector3, center};

/// What is beyond a part's edges.
#[derive(Debug, Clone, Copy, Default)]
pub struct Ends {
    /// Edges beyond which nothing is, as learned,
    pub as_learned: usize,
    /// and such where the surface goes on.
    pub goes_on: usize,
}

/// Edges of the base that prove nothing: furniture may stand flush with it,
const BY_CHANCE_OF_BASE: f64 = 40.0;
/// and of what moves.
const BY_CHANCE: f64 = 10.0;
/// Share of the edges beyond which a surface goes on from which that counts,
const FEW: f64 = 0.4;
/// and from which it is not the learned one.
const MANY: f64 = 0.6;

impl Ends {
    /// 1: the part ends as learned; 0: it goes on.
    pub fn likeness(&self, of_base: bool) -> f64 {
        let by_chance = if of_base { BY_CHANCE_OF_BASE } else { BY_CHANCE };
        let share = self.goes_on as f64 / ((self.as_learned + self.goes_on) as f64 + by_chance);
        ((MANY - share) / (MANY - FEW)).clamp(0.0, 1.0)
    }
}

/// An edge for looking at.
#[derive(Clone, Copy)]
pub struct KnownEdge {
    part: usize,
    surface: Point3<f64>,
    normal: Vector3<f64>,
    beyond: Point3<f64>,
    /// Configurations of the part's joint for which nothing is there.
    configurations: [f64; 2],
}

/// The edges of an appearance.
pub fn edges_of(appearance: &Appearance) -> Vec<KnownEdge> {
    let known = |e: &Edge| KnownEdge {
        part: usize::from(e.part),
        surface: e.surface.map(f64::from).into(),
        normal: e.normal.map(f64::from).into(),
        beyond: e.beyond.map(f64::from).into(),
        configurations: e.configurations.map(f64::from),
    };
    appearance.edges.iter().map(known).collect()
}

/// Something of the object this near to a place, metres, may be what is seen there.
const OWN_M: f64 = 0.03;

/// What a state's parts show beyond those edges whose surface is seen; `buffer` holds the
/// object's visible surface.
pub fn ends(
    scene: &Scene,
    articulated: &Articulated,
    edges: &[KnownEdge],
    state: &State,
    buffer: &DepthBuffer,
) -> Vec<Ends> {
    let poses = articulated.poses(state);
    let configuration: Vec<Option<f64>> = (0..articulated.parts)
        .map(|part| articulated.joints.iter().position(|j| j.child == part).map(|j| state.q[j]))
        .collect();
    let mut ends = vec![Ends::default(); articulated.parts];
    for e in edges {
        let [low, high] = e.configurations;
        if configuration[e.part].is_some_and(|q| q < low || q > high) {
            continue;
        }
        let pose = &poses[e.part];
        let (surface, beyond, normal) = (pose * e.surface, pose * e.beyond, pose * e.normal);
        let at = |place: &Point3<f64>| at(scene, place, &normal);
        let is_own = pixel_of(scene, &beyond)
            .is_none_or(|pixel| buffer.nearest(pixel, e.part).1 < beyond.z + OWN_M);
        if is_own || at(&surface) != Some(There::Surface) {
            continue;
        }
        match at(&beyond) {
            Some(There::Nothing) => ends[e.part].as_learned += 1,
            Some(There::Surface) if at(&center(&surface, &beyond)) == Some(There::Surface) => {
                ends[e.part].goes_on += 1;
            }
            _ => {}
        }
    }
    ends
}

#[derive(PartialEq)]
enum There {
    Nothing,
    Surface,
}

/// What is at a place in the camera frame: nothing, or a surface of that orientation, seen from
/// either side; `None` where something else is, or hides it.
fn at(scene: &Scene, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<There> {
    if is_empty(&scene.frame, place, normal)? {
        return Some(There::Nothing);
    }
    let (u, v) = pixel_of(scene, place)?;
    let surface = scene.surface(u, v)?;
    (surface.normal.dot(normal).abs() > PARALLEL).then_some(There::Surface)
}

/// Cosine of the largest angle between two normals of one surface.
const PARALLEL: f64 = 0.87;

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
    fn before_a_board(half: f64) -> Ends {
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
        ends(&scene, &alone, &[edge], &state, &DepthBuffer::of(&[]))[0]
    }

    #[test]
    fn a_board_ends_where_the_learned_one_does_or_goes_on() {
        let counts = |ends: Ends| (ends.as_learned, ends.goes_on);
        assert_eq!(counts(before_a_board(0.20)), (1, 0));
        assert_eq!(counts(before_a_board(0.27)), (0, 1));
        // Where the surface itself is not seen, what is beyond says nothing.
        assert_eq!(counts(before_a_board(0.10)), (0, 0));
    }

    #[test]
    fn what_goes_on_at_most_edges_is_another_thing() {
        let likeness = |as_learned, goes_on| Ends { as_learned, goes_on }.likeness(false);
        assert_eq!(likeness(100, 3), 1.0);
        assert_eq!(likeness(2, 60), 0.0);
    }

    #[test]
    fn a_few_edges_prove_nothing() {
        assert_eq!(Ends { as_learned: 0, goes_on: 5 }.likeness(false), 1.0);
        assert_eq!(Ends { as_learned: 8, goes_on: 24 }.likeness(true), 1.0);
    }
}
