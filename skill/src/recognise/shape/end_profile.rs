//! Where the surface in the image ends beside a contour point: the image is read at places along the direction in which
//! the model's surface ends.
//!
//! In: a contour point and the pose of its part (camera frame, metres).
//! Out: the distance of the seen end from the contour point, or that the surface ends elsewhere; nothing if the image
//! does not show it.

use super::super::render_cloud::NEAREST_M;
use super::super::scene::Scene;
use super::contour::ContourPoint;
use nalgebra::{IsometryMatrix3, Point3, Vector3};

/// Smallest cosine between the normal of a contour point and the direction to the camera at which it is visible.
pub const LEAST_COSINE: f64 = 0.2;
/// Distance between the places that are read, metres.
const STEP_M: f64 = 0.005;
/// Number of places that are read inside of the contour point, and outside of it.
const INSIDE: usize = 8;
const OUTSIDE: usize = 9;
/// Largest number of places between the last one that shows the surface and the first one seen through: depth has gaps
/// and mixed readings at edges.
const GAP: usize = 5;
/// Number of places that decide at either end of the read line whether the surface is there.
const DECIDING: usize = 4;

/// What the image shows of an end of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SeenEnd {
    /// Distance from the contour point to the seen end along the outward direction, metres; negative inside.
    At(f64),
    /// The surface continues, or is not there at all.
    Elsewhere,
}

/// What a reading says of a place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reading {
    /// The surface is there.
    Surface,
    /// The camera sees through the place.
    Through,
    /// Something is before it.
    Before,
    /// No depth, or too near behind to decide.
    Unclear,
}

/// What the image shows of the end at a contour point; `None` if that end is occluded or not in the image, or if depth
/// has no clear readings about it.
pub fn seen_end(scene: &Scene, pose: &IsometryMatrix3<f64>, c: &ContourPoint) -> Option<SeenEnd> {
    let (point, normal, outward) = (pose * c.point, pose * c.normal, pose * c.outward);
    pixel_of(scene, &point, &normal)?;
    let distance = |i: usize| (i as f64 - INSIDE as f64) * STEP_M;
    let readings: Vec<Reading> = (0..=INSIDE + OUTSIDE)
        .map(|i| reading(scene, &(point + outward * distance(i)), &normal))
        .collect();
    let count = |readings: &[Reading], what| readings.iter().filter(|r| **r == what).count();
    let (inmost, outmost) = (&readings[..DECIDING], &readings[readings.len() - DECIDING..]);
    if count(inmost, Reading::Through) > count(inmost, Reading::Surface)
        || count(outmost, Reading::Surface) >= DECIDING / 2
    {
        return Some(SeenEnd::Elsewhere);
    }
    let last = readings.iter().rposition(|r| *r == Reading::Surface)?;
    let beyond = &readings[last..];
    let next = beyond.iter().position(|r| matches!(r, Reading::Through | Reading::Before))?;
    let is_seen = beyond[next] == Reading::Through && next <= GAP + 1;
    is_seen.then(|| SeenEnd::At(distance(last) + 0.5 * next as f64 * STEP_M))
}

/// Pixel of a place; `None` if a surface with that normal would not be visible there.
pub fn pixel_of(
    scene: &Scene,
    point: &Point3<f64>,
    normal: &Vector3<f64>,
) -> Option<(usize, usize)> {
    let faces = -normal.dot(&point.coords) > LEAST_COSINE * point.coords.norm();
    let camera = &scene.frame.camera;
    let pixel = (faces && point.z > NEAREST_M).then(|| camera.project(point)).flatten()?;
    let is_seen = camera.sees(&pixel, 2.0);
    is_seen.then_some(((pixel.x + 0.5) as usize, (pixel.y + 0.5) as usize))
}

/// What the image shows at a place of a surface with this normal, both in the camera frame.
fn reading(scene: &Scene, place: &Point3<f64>, normal: &Vector3<f64>) -> Reading {
    let frame = &scene.frame;
    let cosine = -normal.dot(&place.coords) / place.coords.norm();
    let pixel = if cosine < LEAST_COSINE { None } else { frame.camera.project(place) };
    let Some(z) = pixel.and_then(|pixel| frame.depth.at_nearest(pixel.x, pixel.y)) else {
        return Reading::Unclear;
    };
    let behind = f64::from(z) - place.z;
    let tolerance = frame.camera.depth_sensor.tolerance(place.z, cosine);
    match () {
        () if behind > 2.0 * tolerance => Reading::Through,
        () if behind > tolerance => Reading::Unclear,
        () if behind > -tolerance => Reading::Surface,
        () => Reading::Before,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen as picture};

    /// What is seen of a learned end at this x of a board 40 cm wide that faces the camera at 1.5 m, a metre before a
    /// wall. Where `before` holds, something stands 1 m from the camera.
    fn seen_at(x: f64, outward: f64, before: impl Fn(f64) -> bool) -> Option<SeenEnd> {
        let of_board = board(0.2, 1.5, 2.5);
        seen_with(x, outward, |u, v| if before(1.5 * u) { 1.0 } else { of_board(u, v) })
    }

    /// The same where this depth is seen in each direction.
    fn seen_with(x: f64, outward: f64, depth: impl Fn(f64, f64) -> f64) -> Option<SeenEnd> {
        let scene = Scene::plain(&picture(1, depth)).unwrap();
        let c = ContourPoint {
            part: 0,
            point: Point3::new(x, 0.0, 1.5),
            normal: -Vector3::z(),
            outward: outward * Vector3::x(),
            side: 0,
            configurations: [0.0; 2],
        };
        seen_end(&scene, &IsometryMatrix3::identity(), &c)
    }

    fn distance(seen: Option<SeenEnd>) -> f64 {
        let Some(SeenEnd::At(distance)) = seen else { panic!("{seen:?}") };
        distance
    }

    #[test]
    fn the_distance_from_the_learned_end_to_the_seen_one_is_read() {
        assert!(distance(seen_at(0.2, 1.0, |_| false)).abs() < 0.005);
        assert!((distance(seen_at(0.19, 1.0, |_| false)) - 0.01).abs() < 0.005, "outside");
        assert!((distance(seen_at(-0.22, -1.0, |_| false)) + 0.02).abs() < 0.005, "inside");
    }

    #[test]
    fn a_surface_that_goes_on_or_is_not_there_ends_elsewhere() {
        assert_eq!(seen_at(0.05, 1.0, |_| false), Some(SeenEnd::Elsewhere), "it goes on");
        assert_eq!(seen_at(0.4, 1.0, |_| false), Some(SeenEnd::Elsewhere), "it is not there");
    }

    #[test]
    fn a_gap_in_depth_at_an_edge_is_bridged_and_a_slot_in_a_surface_is_no_end() {
        let of = |depth: &dyn Fn(f64) -> f64| seen_with(0.2, 1.0, |u, _| depth(1.5 * u));
        let gap = |wide: f64| {
            move |x: f64| match x {
                x if x < 0.2 => 1.5,
                x if x < 0.2 + wide => f64::NAN,
                _ => 2.5,
            }
        };
        assert!((distance(of(&gap(0.02))) - 0.01).abs() < 0.006);
        assert_eq!(of(&gap(0.1)), None, "nothing is known beyond it");
        let slot = |x: f64| if (0.195..0.205).contains(&x) { 2.5 } else { 1.5 };
        assert_eq!(of(&slot), Some(SeenEnd::Elsewhere));
    }

    #[test]
    fn an_end_behind_something_or_out_of_sight_says_nothing() {
        assert_eq!(seen_at(0.2, 1.0, |x| x > 0.18), None, "its end is hidden");
        assert_eq!(seen_at(0.2, 1.0, |x| x > 0.1), None, "all of it is hidden");
        assert_eq!(seen_at(9.0, 1.0, |_| false), None, "outside of the image");
    }
}
