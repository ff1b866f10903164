//! Directions that an axis may have: across or along the surfaces around a part. People build hinges square
//! to what they are in; the alignment later corrects a direction that is off by some degrees.

use super::rest_surface::RestSurface;
use super::view::View;
use crate::math::rigid::{line_angle, plane_through};
use nalgebra::{Matrix3, Point3, Vector3};

/// Pixels between the patches whose normals are taken, and from their middle to their border.
const PATCH_STEP_PX: usize = 10;
const PATCH_HALF_PX: usize = 6;
/// Most patches.
const MAX_PATCHES: usize = 1500;
/// Largest range of depth in a patch, metres: more is an edge.
const MAX_RANGE_M: f64 = 0.08;
/// How much farther than the part itself its surroundings reach, metres.
const SURROUNDINGS_M: f64 = 0.4;
/// Normals that close are of one surface or of parallel ones, radians.
const SAME_NORMAL_RAD: f64 = 0.2;
/// Most main normals, and the least share of all normals that one of them has.
const MAX_NORMALS: usize = 4;
const MIN_SHARE: f64 = 0.05;
/// Directions closer than this are one, radians.
const SAME_DIRECTION_RAD: f64 = 0.17;

/// Directions that planes tell closer than this are one, radians: their normals tell them to half of that.
const SAME_DIRECTION_OF_PLANES_RAD: f64 = 0.05;

/// The directions, those of `known` axes first, and last those `of_planes` that turn nearby. What stands askew to its
/// surroundings, as a round bin does, is square to none of them; its planes tell its direction.
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

/// Normals of small patches around a part.
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

/// The means of the normals that most others are close to, the most frequent first.
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

/// The three principal axes of a cloud.
fn principal_axes(points: &[Point3<f64>]) -> Vec<Vector3<f64>> {
    let mean: Vector3<f64> =
        points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let spread: Matrix3<f64> =
        points.iter().map(|p| p.coords - mean).map(|d| d * d.transpose()).sum();
    let eigen = spread.symmetric_eigen();
    eigen.eigenvectors.column_iter().map(|axis| axis.into_owned()).collect()
}
