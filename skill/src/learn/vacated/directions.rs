//! Finds directions that an axis may have: across or along the surfaces around a part. People build hinges square to
//! what they are in; the alignment later corrects a direction that is off by some degrees.
//!
//! In: a surface at rest, the keyframe that shows it, and directions of known axes and of turning planes; base frame.
//! Out: unit directions, base frame.
//! From: clusters of surface normals, and principal axes.

use super::rest_surface::RestSurface;
use super::view::View;
use crate::math::rigid::{line_angle, plane_through};
use nalgebra::{Matrix3, Point3, Vector3};

/// Distance between the patches whose normals are estimated, pixels.
const PATCH_STEP_PX: usize = 10;
/// Distance from the middle of a patch to its border, pixels.
const PATCH_HALF_PX: usize = 6;
/// Most patches whose normals are estimated.
const MAX_PATCHES: usize = 1500;
/// Largest range of depth in a patch, metres; a larger one is an edge.
const MAX_RANGE_M: f64 = 0.08;
/// How far the surroundings reach beyond the radius of the part, metres.
const SURROUNDINGS_M: f64 = 0.4;
/// Largest angle between normals of one surface or of parallel ones, radians.
const SAME_NORMAL_RAD: f64 = 0.2;
/// Most main normals.
const MAX_NORMALS: usize = 4;
/// Smallest share of all normals that one main normal has.
const MIN_SHARE: f64 = 0.05;
/// Largest angle between two directions that count as one, radians.
const SAME_DIRECTION_RAD: f64 = 0.17;

/// Largest angle between a direction of turning planes and another direction that count as one, radians: the planes'
/// normals determine a direction to half of that.
const SAME_DIRECTION_OF_PLANES_RAD: f64 = 0.05;

/// The directions: first those of `known` axes, then those square to the surroundings and the principal axes of the
/// surface, last those `of_planes` that turn nearby. A part that stands askew to its surroundings, as a round bin
/// does, is square to none of them; its planes give its direction.
pub fn axis_directions(
    surface: &RestSurface,
    view: &View,
    known: impl Iterator<Item = Vector3<f64>>,
    of_planes: impl Iterator<Item = Vector3<f64>>,
) -> Vec<Vector3<f64>> {
    let main = main_normals(normals_around(surface, view));
    let pairs = (0..main.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let across = pairs.map(|(i, j)| main[i].cross(&main[j])).filter(|x| x.norm() > 0.5);
    let own = principal_axes(&surface.points);
    let mut directions: Vec<Vector3<f64>> = Vec::new();
    let mut add = |direction: Vector3<f64>, apart_rad: f64| {
        let direction = direction.normalize();
        if directions.iter().all(|d| line_angle(d, &direction) > apart_rad) {
            directions.push(direction);
        }
    };
    let square = known.chain(main.iter().copied()).chain(across).chain(own);
    square.for_each(|direction| add(direction, SAME_DIRECTION_RAD));
    of_planes.for_each(|direction| add(direction, SAME_DIRECTION_OF_PLANES_RAD));
    directions
}

/// Normals of small patches around a part, base frame.
fn normals_around(surface: &RestSurface, view: &View) -> Vec<Vector3<f64>> {
    let depth = &view.picture.depth;
    let (centre, radius) = (surface.centre(), surface.radius() + SURROUNDINGS_M);
    let steps =
        |size: usize| (PATCH_HALF_PX..size.saturating_sub(PATCH_HALF_PX)).step_by(PATCH_STEP_PX);
    let patches = steps(depth.height()).flat_map(|v| steps(depth.width()).map(move |u| (u, v)));
    let is_near = |(u, v): &(usize, usize)| {
        view.surface_at(*u, *v).is_some_and(|place| (place - centre).norm() < radius)
    };
    let near: Vec<(usize, usize)> = patches.filter(is_near).collect();
    let step = near.len().div_ceil(MAX_PATCHES).max(1);
    near.into_iter().step_by(step).filter_map(|(u, v)| normal_of_patch(view, u, v)).collect()
}

fn normal_of_patch(view: &View, u: usize, v: usize) -> Option<Vector3<f64>> {
    let reach = || (0..=2 * PATCH_HALF_PX).step_by(2);
    let mut places: Vec<Point3<f64>> = Vec::new();
    let (mut near, mut far) = (f64::INFINITY, 0.0_f64);
    for dv in reach() {
        for du in reach() {
            let (u, v) = (u + du - PATCH_HALF_PX, v + dv - PATCH_HALF_PX);
            let z = f64::from(view.picture.depth.at(u, v)?);
            (near, far) = (near.min(z), far.max(z));
            places.push(view.surface_at(u, v)?);
        }
    }
    (far - near < MAX_RANGE_M).then(|| plane_through(&places).1)
}

/// The means of the largest clusters of normals, the largest first.
fn main_normals(mut normals: Vec<Vector3<f64>>) -> Vec<Vector3<f64>> {
    let all = normals.len();
    let mut main = Vec::new();
    let count = |normals: &[Vector3<f64>], n: &Vector3<f64>| {
        normals.iter().filter(|other| line_angle(other, n) < SAME_NORMAL_RAD).count()
    };
    while main.len() < MAX_NORMALS {
        let counts = normals.iter().enumerate().map(|(i, n)| (count(&normals, n), i));
        let best = counts.max_by_key(|&(n, i)| (n, std::cmp::Reverse(i)));
        let Some((n, i)) = best.filter(|(n, _)| *n as f64 >= MIN_SHARE * all as f64) else { break };
        let mode = normals[i];
        let (of_mode, others): (Vec<_>, Vec<_>) =
            normals.into_iter().partition(|other| line_angle(other, &mode) < SAME_NORMAL_RAD);
        debug_assert_eq!(of_mode.len(), n);
        let scatter: Matrix3<f64> = of_mode.iter().map(|n| n * n.transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        main.push(eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned());
        normals = others;
    }
    main
}

/// The three principal axes of a point cloud.
fn principal_axes(points: &[Point3<f64>]) -> Vec<Vector3<f64>> {
    let mean: Vector3<f64> =
        points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let spread: Matrix3<f64> =
        points.iter().map(|p| p.coords - mean).map(|d| d * d.transpose()).sum();
    let eigen = spread.symmetric_eigen();
    eigen.eigenvectors.column_iter().map(|axis| axis.into_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::rest_surface::{End, vacated_surfaces};
    use super::super::test_data::{lever, turn};
    use super::*;

    /// The given number of normals for each direction, each turned away from it by less than three degrees.
    fn normals(of: &[(Vector3<f64>, usize)]) -> Vec<Vector3<f64>> {
        let about = |&(n, count): &(Vector3<f64>, usize)| {
            (0..count).map(move |i| {
                let angle = f64::from(i as u32 % 7) - 3.0;
                let beside = if n.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() };
                let sense = if i % 2 == 0 { 1.0 } else { -1.0 };
                sense * (n + n.cross(&beside) * 0.015 * angle).normalize()
            })
        };
        of.iter().flat_map(about).collect()
    }

    fn is_along(a: &Vector3<f64>, b: &Vector3<f64>) -> bool {
        line_angle(a, b) < 0.05
    }

    #[test]
    fn the_main_normals_are_the_frequent_ones_most_frequent_first() {
        let found = main_normals(normals(&[
            (Vector3::x(), 30),
            (Vector3::z(), 50),
            (Vector3::new(0.0, 1.0, 1.0).normalize(), 2),
        ]));
        assert_eq!(found.len(), 2, "two of 82 are none");
        assert!(is_along(&found[0], &Vector3::z()) && is_along(&found[1], &Vector3::x()));
    }

    #[test]
    fn there_are_no_more_main_normals_than_may_be() {
        let turned = |i: u32| {
            (Vector3::new((0.5 * f64::from(i)).cos(), (0.5 * f64::from(i)).sin(), 0.0), 20)
        };
        let all: Vec<_> = (0..6).map(turned).collect();
        assert_eq!(main_normals(normals(&all)).len(), MAX_NORMALS);
        assert!(main_normals(Vec::new()).is_empty());
    }

    #[test]
    fn a_long_flat_cloud_has_its_sides_as_axes() {
        let points: Vec<Point3<f64>> = (0..60)
            .map(|i| {
                let (along, across) = (f64::from(i % 20) * 0.02, f64::from(i / 20) * 0.01);
                Point3::new(across + 1.0, 2.0, along)
            })
            .collect();
        let axes = principal_axes(&points);
        for side in [Vector3::x(), Vector3::y(), Vector3::z()] {
            assert!(axes.iter().any(|axis| is_along(axis, &side)), "{axes:?}");
        }
    }

    #[test]
    fn a_lever_before_a_wall_may_turn_square_to_the_wall_or_along_itself() {
        let recording = lever(turn);
        let views = View::all(&recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let known = Vector3::new(1.0, 1.0, 0.0);
        let found = axis_directions(surface, &views[0], std::iter::once(known), std::iter::empty());
        assert!(is_along(&found[0], &known), "known axes come first");
        for side in [Vector3::z(), Vector3::x(), Vector3::y()] {
            assert!(found.iter().any(|d| is_along(d, &side)), "{side:?} is not among {found:?}");
        }
        for (i, a) in found.iter().enumerate() {
            assert!((a.norm() - 1.0).abs() < 1e-9);
            assert!(found[..i].iter().all(|b| line_angle(a, b) > SAME_DIRECTION_RAD));
        }
    }

    #[test]
    fn a_patch_across_an_edge_or_without_readings_has_no_normal() {
        let recording = lever(turn);
        let view = &View::all(&recording)[0];
        // The bar's end lies at x = 0.2 m, that is 203 pixels from the left; its side is 11 below the middle.
        let on_wall = normal_of_patch(view, 60, 60).unwrap();
        assert!(is_along(&on_wall, &Vector3::z()));
        assert!(normal_of_patch(view, 203, 131).is_none());
    }
}
