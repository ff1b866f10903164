//! Tests whether a surface at rest is connected with a body that sways. A forearm that turns keeps its shape, but it
//! hangs on a trunk, which sways by millimetres and centimetres all the time; a door, a lid or a lever is connected
//! with what stands still.
//!
//! In: a surface at rest (base frame, metres) and the keyframes.
//! Out: whether the body that is connected with the surface stands still or sways.
//! From: region growing in the depth image; the limits from parts and persons of 70 rendered demonstrations
//! (`README.md`).

use super::rest_surface::RestSurface;
use super::stillness::{RoomShifts, shift};
use super::view::View;
use crate::learn::one_surface::{Cell, connected_cells, largest_step};
use crate::math::robust::median;
use nalgebra::{Point3, Vector3};
use std::collections::HashSet;

/// Distance between two places of the depth image that are tested, pixels.
const STEP_PX: usize = 4;
/// How much farther than the surface's radius the points of the body may be from its middle, metres: from a hand to the
/// shoulder.
const BODY_M: f64 = 0.5;
/// Number of keyframes that see through a place from which the place does not belong to the body.
const THROUGH_BODY: usize = 2;
/// Fewest keyframes that must show a body.
const LEAST_SHIFTS: usize = 8;
/// Fewest points of a body of which the shift is known.
const LEAST_POINTS: usize = 100;
/// Median distance between two shifts of a body up to which it stands still, and from which it sways: metres, and
/// standard deviations of a depth reading; the larger counts.
const STILL: (f64, f64) = (0.0025, 0.3);
const SWAYS: (f64, f64) = (0.0045, 1.0);

/// What a surface at rest is connected with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Body {
    /// Hardly anything that stays.
    #[default]
    Nothing,
    /// Something of which it is not clear whether it sways.
    Unclear,
    /// Furniture: what hangs on it is no limb.
    StandsStill,
    /// A person.
    Sways,
}

/// What the surface is connected with: how far that shifts between keyframes, beyond the shift of the whole room.
/// `room`: the shifts against the keyframe that shows the surface at rest.
pub fn body_of(surface: &RestSurface, views: &[View], room: &RoomShifts) -> Body {
    let rest = &views[surface.keyframe];
    let (points, normals): (Vec<_>, Vec<_>) = connected(surface, views).unzip();
    if points.len() < LEAST_POINTS {
        return Body::Nothing;
    }
    let over_room = |(view, room): (&View, &Option<Vector3<f64>>)| {
        Some(shift(&points, &normals, view)? - (*room)?)
    };
    let shifts: Vec<Vector3<f64>> =
        views.iter().zip(&room.of_keyframe).filter_map(over_room).collect();
    let earlier = |(i, shift): (usize, &Vector3<f64>)| {
        shifts[..i].iter().map(|other| (shift - other).norm()).collect::<Vec<_>>()
    };
    let mut apart: Vec<f64> = shifts.iter().enumerate().flat_map(earlier).collect();
    let z = (rest.camera_from_base * surface.centre()).z;
    let sigma = rest.picture.camera.depth_sensor.reading_sigma(z);
    let sway_m = median(&mut apart).unwrap_or_default();
    tracing::debug!(points = points.len(), shown = shifts.len(), sway_m, sigma, "its body");
    match sway_m {
        _ if shifts.len() < LEAST_SHIFTS => Body::Unclear,
        s if s > SWAYS.0.max(SWAYS.1 * sigma) => Body::Sways,
        s if s < STILL.0.max(STILL.1 * sigma) => Body::StandsStill,
        _ => Body::Unclear,
    }
}

/// The points around the surface that are connected with it at rest and that no keyframes see through, with their
/// normals; base frame.
fn connected<'v>(
    surface: &RestSurface,
    views: &'v [View],
) -> impl Iterator<Item = (Point3<f64>, Vector3<f64>)> + 'v {
    let rest = &views[surface.keyframe];
    let stays = |place: &Point3<f64>| {
        let through = views.iter().filter(|view| view.shows_behind(place));
        through.take(THROUGH_BODY).count() < THROUGH_BODY
    };
    let patch = |cell: Cell| {
        let [u, v] = pixel(cell);
        rest.patch_at(u, v)
    };
    cells_beside(surface, rest).into_iter().filter_map(patch).filter(move |(place, _)| stays(place))
}

/// Cells around the surface that are connected with it, in the order of columns.
fn cells_beside(surface: &RestSurface, rest: &View) -> Vec<Cell> {
    let depth = &rest.picture.depth;
    let (columns, rows) = (depth.width() / STEP_PX, depth.height() / STEP_PX);
    let z = |cell: Cell| {
        let [u, v] = pixel(cell);
        depth.at(u, v).map(f64::from)
    };
    let (centre, far) = (surface.centre(), surface.radius() + BODY_M);
    let is_near = |cell: Cell| {
        let [u, v] = pixel(cell);
        rest.surface_at(u, v).is_some_and(|place| (place - centre).norm() < far)
    };
    let cell_of = |place: &Point3<f64>| {
        let pixel = rest.pixel_of(place)?.coords / STEP_PX as f64;
        let is_inside =
            (0.0..columns as f64).contains(&pixel.x) && (0.0..rows as f64).contains(&pixel.y);
        let cell = is_inside.then_some((pixel.x as usize, pixel.y as usize))?;
        let expected = (rest.camera_from_base * place).z;
        // At the border of the surface the middle of a cell may show what is behind it.
        z(cell).is_some_and(|z| (z - expected).abs() < largest_step(expected)).then_some(cell)
    };
    let own: HashSet<Cell> = surface.points.iter().filter_map(cell_of).collect();
    let reached = connected_cells(own.clone(), (columns, rows), z, is_near);
    let mut others: Vec<Cell> = reached.difference(&own).copied().collect();
    others.sort_unstable();
    others
}

/// Pixel in the middle of a cell.
fn pixel(cell: Cell) -> [usize; 2] {
    [cell.0, cell.1].map(|at| at * STEP_PX + STEP_PX / 2)
}

#[cfg(test)]
mod tests {
    use super::super::rest_surface::{End, vacated_surfaces};
    use super::super::test_data::{bar_on_post, turn};
    use super::*;

    fn body_of_a_post_that_sways_by(sway_m: f64) -> Body {
        let recording = bar_on_post(turn, |f| sway_m * (0.8 * f as f64).sin(), |_| None);
        let views = View::all(&recording);
        let surface = vacated_surfaces(&views, End::First, |_| Vec::new()).remove(0);
        body_of(&surface, &views, &RoomShifts::of(End::First, &views))
    }

    #[test]
    fn an_arm_hangs_on_a_trunk_that_sways_and_a_lever_on_a_post_that_stands() {
        assert_eq!(body_of_a_post_that_sways_by(0.0), Body::StandsStill);
        assert_eq!(body_of_a_post_that_sways_by(0.001), Body::StandsStill);
        assert_eq!(body_of_a_post_that_sways_by(0.01), Body::Sways);
    }
}
