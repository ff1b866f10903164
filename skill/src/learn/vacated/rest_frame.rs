//! Tests whether a surface at rest is set into something. The front of a drawer closes its opening: beside its border
//! a static surface is as near to the camera. A person stands before things: beside the border only the far
//! background is seen.
//!
//! In: a surface at rest (base frame) and the keyframes.
//! Out: what the surface is connected with; and of the directions from its middle to all sides, the number in which its
//! border meets something that stays, and the number in which there is only what is far behind.

use super::connected_body::{Body, body_of};
use super::rest_surface::RestSurface;
use super::stillness::RoomShifts;
use super::view::View;
use crate::learn::free_space::Probe;
use crate::math::rigid::{orthonormal_basis, plane_through};
use nalgebra::{Point3, Vector3};
use std::f64::consts::TAU;

/// Directions from the middle of the surface that are tested.
const DIRECTIONS: usize = 16;
/// How far beside the border another surface is searched for, metres.
const BESIDE_M: f64 = 0.05;
/// Steps from the border to the farthest place beside it.
const BESIDE_STEPS: usize = 5;
/// Largest distance between a surface that meets the border and where the surface at rest would continue, metres:
/// fronts stand out by their thickness.
const MEETS_M: f64 = 0.035;
/// Fewest directions in which something must meet a surface that is set in.
const MIN_MEETS: usize = 3;
/// Largest ratio of the directions in which nothing meets a closed surface to those in which something does.
const MAX_FREE: f64 = 0.5;
/// Largest number of free directions of a surface that has something beside it. Of drawers in open frames, as under a
/// table, it was up to 4; of two slides that were wrong and that other tests accepted, 6 and 7.
const MAX_FREE_DIRECTIONS: usize = 4;
/// Smallest share of the surface's points that a keyframe must see through for the surface to be away.
const AWAY: f64 = 0.5;
/// Largest share of the keyframes in which the surface is away that may see through a place that stays.
const MAX_THROUGH: f64 = 0.05;
/// Smallest share of the keyframes in which the surface is away that must show a place that stays.
const LEAST_SHOWN: f64 = 0.25;

/// What is beside the border of a surface at rest, and what the surface is connected with.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RestFrame {
    /// Directions in which something meets the surface and stays when the surface goes away.
    pub meets: usize,
    /// Directions in which nothing meets the surface.
    pub free: usize,
    /// What the surface is connected with.
    pub body: Body,
}

impl RestFrame {
    /// The frame of a surface at rest. Something that meets the surface but is not seen once the surface is away
    /// counts for neither: it may be more of the same surface. `room`: the shifts against the surface's keyframe.
    pub fn of(surface: &RestSurface, views: &[View], room: &RoomShifts) -> Self {
        let centre = surface.centre();
        let (_, normal) = plane_through(&surface.points);
        let (u, v) = orthonormal_basis(&normal);
        let rest = &views[surface.keyframe];
        let away: Vec<&View> = views.iter().filter(|view| is_away(surface, view)).collect();
        let mut frame = Self { body: body_of(surface, views, room), ..Self::default() };
        for k in 0..DIRECTIONS {
            let angle = TAU * k as f64 / DIRECTIONS as f64;
            let direction = u * angle.cos() + v * angle.sin();
            let Some(border) = border(surface, &centre, &normal, &direction) else { continue };
            let beside = places_beside(&border, &direction, rest);
            frame.free += usize::from(beside.is_empty());
            frame.meets += usize::from(beside.iter().any(|place| stays(place, &away)));
        }
        frame
    }

    /// True if something meets the surface at several sides and few are open.
    pub fn is_set_in(self) -> bool {
        self.meets >= MIN_MEETS && self.is_closed()
    }

    /// True if more sides are open than something meets: the surface may be a person.
    pub fn is_open(self) -> bool {
        self.free > self.meets
    }

    /// True if the surface is connected with something or meets something, and few directions are free.
    pub fn has_something_beside(self) -> bool {
        self.free <= MAX_FREE_DIRECTIONS && (self.meets > 0 || self.body != Body::Nothing)
    }

    /// True if at most half as many sides are open as something meets.
    pub fn is_closed(self) -> bool {
        self.free as f64 <= MAX_FREE * self.meets as f64
    }
}

/// The surface's farthest point in the sector around a direction.
fn border(
    surface: &RestSurface,
    centre: &Point3<f64>,
    normal: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<Point3<f64>> {
    let along = |p: &Point3<f64>| direction.dot(&(p - centre));
    let half_sector = (0.5 * TAU / DIRECTIONS as f64).tan();
    let across = normal.cross(direction);
    let in_sector = surface
        .points
        .iter()
        .filter(|p| along(p) > 0.0 && across.dot(&(*p - centre)).abs() < half_sector * along(p));
    in_sector.copied().max_by(|a, b| along(a).total_cmp(&along(b)))
}

/// The points that are seen beside the border, about where the surface would continue; base frame.
fn places_beside(border: &Point3<f64>, direction: &Vector3<f64>, rest: &View) -> Vec<Point3<f64>> {
    let beside = |k| border + direction * (BESIDE_M * k as f64 / BESIDE_STEPS as f64);
    let near = |wanted: Point3<f64>| {
        rest.surface_near(&wanted).filter(|place| (place - wanted).norm() < MEETS_M)
    };
    (1..=BESIDE_STEPS).map(beside).filter_map(near).collect()
}

/// True if a keyframe sees through most of the surface's points.
fn is_away(surface: &RestSurface, view: &View) -> bool {
    let through = surface.points.iter().filter(|p| view.probe(p) == Probe::Through).count();
    through as f64 >= AWAY * surface.points.len() as f64
}

/// True if keyframes in which the surface is away show a place, and hardly any sees through it.
fn stays(place: &Point3<f64>, away: &[&View]) -> bool {
    let share = |holds: &dyn Fn(&View) -> bool| {
        away.iter().filter(|view| holds(view)).count() as f64 / away.len().max(1) as f64
    };
    share(&|view| view.shows_behind(place)) <= MAX_THROUGH
        && share(&|view| view.shows(place)) >= LEAST_SHOWN
}

#[cfg(test)]
mod tests {
    use super::super::rest_surface::{End, vacated_surfaces};
    use super::super::test_data::{drawer, slider, turn};
    use super::*;
    use crate::learn::recording::Recording;

    fn frame(recording: &Recording) -> RestFrame {
        let views = View::all(recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        RestFrame::of(surface, &views, &RoomShifts::of(End::First, &views))
    }

    #[test]
    fn a_front_in_its_cabinet_is_set_in_and_a_plate_before_a_wall_is_not() {
        let in_cabinet = frame(&drawer(|frame| 0.25 * turn(frame), 0.3));
        assert!(in_cabinet.is_set_in() && in_cabinet.free == 0, "{in_cabinet:?}");
        let before_a_wall = frame(&slider(|frame| 0.25 * turn(frame)));
        assert_eq!([before_a_wall.meets, before_a_wall.free], [0, DIRECTIONS]);
        assert!(!before_a_wall.has_something_beside() && in_cabinet.has_something_beside());
    }

    #[test]
    fn what_moves_along_with_it_holds_nothing() {
        // The cabinet comes with its front: beside both is the wall.
        assert!(!frame(&drawer(|frame| 0.25 * turn(frame), 0.0)).is_set_in());
    }
}
