//! Contours: places where a surface ends, of a known object and of a frame.
//!
//! In: the edges of an object (object frame at configuration 0, metres), or a scene.
//! Out: contour points with the normal of the surface and the direction in which it ends (object frame, or camera
//! frame; metres).

use super::super::render_cloud::KnownEdge;
use super::super::scene::Scene;
use crate::math::grid::cell;
use crate::math::rigid::orthonormal_basis;
use crate::object::surface_end::{INSET_M, is_empty};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::f64::consts::TAU;

/// A place at which a surface ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourPoint {
    /// Index of the part; 0 in a frame.
    pub part: usize,
    /// The place, metres.
    pub point: Point3<f64>,
    /// Unit normal of the surface.
    pub normal: Vector3<f64>,
    /// Unit direction, perpendicular to the normal, in which the surface ends.
    pub outward: Vector3<f64>,
    /// Index of the side among those of its part: points whose outward directions and normals are alike. 0 in a frame.
    pub side: usize,
    /// Smallest and largest configuration of the part's joint at which the end is known, rad or m; 0 for the base
    /// and in a frame.
    pub configurations: [f64; 2],
}

/// Side of a cell in which one point for each direction is kept, metres.
const SPACING_M: f64 = 0.02;
/// Largest distance of points that determine the direction of an edge, metres: at a depth of three metres the points
/// of a frame are 3 cm apart.
const ALONG_M: f64 = 0.1;
/// Smallest cosine between the normals of two points of one edge.
const SAME_NORMAL: f64 = 0.9;
/// Smallest cosine between the outward directions of two points of one edge, before the direction of the edge is
/// known.
const SAME_OUTWARD: f64 = 0.5;
/// Smallest number of points that determine the direction of an edge.
const LEAST_ALONG: usize = 4;
/// Smallest ratio of the variance of an edge's points along it to that across it for the edge to be straight.
const STRAIGHT: f64 = 4.0;

/// Contour of an object, by its known edges.
pub fn contour_of_object(edges: &[KnownEdge]) -> Vec<ContourPoint> {
    let place = |e: &KnownEdge| {
        let outward = (e.beyond - e.surface).try_normalize(1e-9)?;
        Some(ContourPoint {
            part: e.part,
            point: e.surface + outward * INSET_M,
            normal: e.normal,
            outward,
            side: 0,
            configurations: e.configurations,
        })
    };
    let mut contour = thinned(&straightened(&edges.iter().filter_map(place).collect::<Vec<_>>()));
    number_sides(&mut contour);
    contour
}

/// Smallest cosine between the outward directions, and between the normals, of two points of one side.
const ALIKE_ON_SIDE: f64 = 0.85;

/// Numbers the sides of each part from 0: a point is on the side of the first earlier point that ends in about its
/// direction and faces about where it faces.
fn number_sides(contour: &mut [ContourPoint]) {
    let mut sides: Vec<(ContourPoint, usize)> = Vec::new();
    for p in contour {
        let is_same = |q: &ContourPoint| {
            q.part == p.part
                && q.outward.dot(&p.outward) > ALIKE_ON_SIDE
                && q.normal.dot(&p.normal) > ALIKE_ON_SIDE
        };
        p.side = match sides.iter().find(|(first, _)| is_same(first)) {
            Some((_, side)) => *side,
            None => {
                let side = sides.iter().filter(|(first, _)| first.part == p.part).count();
                sides.push((*p, side));
                side
            }
        };
    }
}

/// Distance between the examined pixels, pixels.
const STEP_PX: usize = 4;
/// Largest depth of contour points, metres: farther away depth is too noisy.
const FARTHEST_M: f64 = 4.5;
/// Number of directions in the tangent plane that are tried.
const DIRECTIONS: usize = 8;
/// Length of a step by which a surface is followed to its end, metres.
const FOLLOW_M: f64 = 0.006;
/// Largest number of steps by which a surface is followed to its end.
const FOLLOW_STEPS: usize = 6;
/// Distances beyond the end at which there must be free space, metres.
const BEYOND_M: [f64; 2] = [0.025, 0.04];

/// Contour of a scene: where a surface ends, and free space is seen beyond it in the tangent plane.
pub fn contour_of_scene(scene: &Scene) -> Vec<ContourPoint> {
    let depth = &scene.frame.depth;
    let rows: Vec<usize> = (STEP_PX / 2..depth.height()).step_by(STEP_PX).collect();
    let places: Vec<ContourPoint> = rows
        .into_par_iter()
        .flat_map_iter(|v| {
            let columns = (STEP_PX / 2..depth.width()).step_by(STEP_PX);
            columns.flat_map(move |u| ends_beside(scene, u, v))
        })
        .collect();
    thinned(&straightened(&thinned(&places)))
}

/// Ends of the surface that is seen at a pixel, near that pixel.
fn ends_beside(scene: &Scene, u: usize, v: usize) -> Vec<ContourPoint> {
    let frame = &scene.frame;
    let near = |z: f32| f64::from(z) < FARTHEST_M;
    if !frame.depth.at(u, v).is_some_and(near) {
        return Vec::new();
    }
    let Some(surface) = scene.surface(u, v) else { return Vec::new() };
    let at = frame.camera.back_project(u as f64, v as f64, surface.z);
    let normal = surface.normal;
    let (x, y) = orthonormal_basis(&normal);
    let is = |place: Point3<f64>| is_empty(frame, &place, &normal);
    let end = |i: usize| {
        let angle = TAU * i as f64 / DIRECTIONS as f64;
        let outward = x * angle.cos() + y * angle.sin();
        let place = |distance: f64| at + outward * distance;
        let longest = FOLLOW_M * FOLLOW_STEPS as f64;
        is(place(longest + BEYOND_M[0])).filter(|empty| *empty)?;
        let goes_on = |step: &usize| is(place(*step as f64 * FOLLOW_M)) == Some(false);
        let followed = (1..=FOLLOW_STEPS).take_while(goes_on).count();
        // A surface that continues at the last step may end anywhere before the place that is empty.
        if followed == FOLLOW_STEPS {
            return None;
        }
        let last = followed as f64 * FOLLOW_M;
        let ends = BEYOND_M.iter().all(|beyond| is(place(last + beyond)) == Some(true));
        let point = place(last + 0.5 * FOLLOW_M);
        ends.then_some(ContourPoint {
            part: 0,
            point,
            normal,
            outward,
            side: 0,
            configurations: [0.0; 2],
        })
    };
    (0..DIRECTIONS).filter_map(end).collect()
}

/// Points with the outward direction of the edge on which their neighbours lie; points with too few neighbours are
/// dropped.
fn straightened(points: &[ContourPoint]) -> Vec<ContourPoint> {
    let cells = by_cell(points, ALONG_M);
    let of_edge = |p: &ContourPoint| {
        let own = cell(&p.point, ALONG_M);
        let about = (0..27).filter_map(|k| {
            let (dx, dy, dz) = (k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
            cells.get(&[own[0] + dx, own[1] + dy, own[2] + dz])
        });
        let is_on_edge = |q: &&ContourPoint| {
            q.part == p.part
                && (q.point - p.point).norm() < ALONG_M
                && q.normal.dot(&p.normal) > SAME_NORMAL
                && q.outward.dot(&p.outward) > SAME_OUTWARD
        };
        let edge: Vec<&ContourPoint> =
            about.flatten().map(|i| &points[*i]).filter(is_on_edge).collect();
        outward_of(p, &edge)
    };
    points.iter().filter_map(of_edge).collect()
}

/// Point with the outward direction of its edge; `None` if too few points determine it.
fn outward_of(p: &ContourPoint, edge: &[&ContourPoint]) -> Option<ContourPoint> {
    if edge.len() < LEAST_ALONG {
        return None;
    }
    let count = edge.len() as f64;
    let mean = edge.iter().map(|q| q.point.coords).sum::<Vector3<f64>>() / count;
    let spread = |q: &&ContourPoint| {
        let d = q.point.coords - mean;
        d * d.transpose()
    };
    let scatter: Matrix3<f64> = edge.iter().map(spread).sum();
    let eigen = scatter.symmetric_eigen();
    let longest = eigen.eigenvalues.imax();
    let along: Vector3<f64> = eigen.eigenvectors.column(longest).into();
    let across = scatter.trace() - eigen.eigenvalues[longest];
    let about = edge.iter().map(|q| q.outward).sum::<Vector3<f64>>();
    let is_straight = eigen.eigenvalues[longest] > STRAIGHT * across;
    let meant = if is_straight { about - along * along.dot(&about) } else { about };
    let outward = (meant - p.normal * p.normal.dot(&meant)).try_normalize(1e-6)?;
    Some(ContourPoint { outward, ..*p })
}

/// One point per cell and direction.
fn thinned(points: &[ContourPoint]) -> Vec<ContourPoint> {
    let mut kept: Vec<ContourPoint> = Vec::new();
    let mut in_cell: HashMap<(usize, [i32; 3]), Vec<usize>> = HashMap::new();
    for p in points {
        let own = in_cell.entry((p.part, cell(&p.point, SPACING_M))).or_default();
        let is_same = |i: &usize| {
            let q = &kept[*i];
            q.normal.dot(&p.normal) > SAME_NORMAL && q.outward.dot(&p.outward) > SAME_NORMAL
        };
        if !own.iter().any(is_same) {
            own.push(kept.len());
            kept.push(*p);
        }
    }
    kept
}

fn by_cell(points: &[ContourPoint], side: f64) -> HashMap<[i32; 3], Vec<usize>> {
    let mut cells: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    for (i, p) in points.iter().enumerate() {
        cells.entry(cell(&p.point, side)).or_default().push(i);
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};

    #[test]
    fn a_board_in_a_picture_ends_at_its_four_sides() {
        let scene = Scene::plain(&seen(1, board(0.2, 1.5, 2.5))).unwrap();
        let of_board = |p: &&ContourPoint| p.point.z < 2.0;
        let contour = contour_of_scene(&scene);
        let sides: Vec<&ContourPoint> = contour.iter().filter(of_board).collect();
        assert!(sides.len() > 40, "{}", sides.len());
        for p in &sides {
            let from_centre = p.point.x.abs().max(p.point.y.abs());
            assert!((from_centre - 0.2).abs() < 0.015, "{p:?}");
        }
        let towards = |d: Vector3<f64>| sides.iter().filter(|p| p.outward.dot(&d) > 0.97).count();
        for direction in [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()] {
            assert!(towards(direction) > 8);
        }
    }

    #[test]
    fn an_edge_gives_its_places_its_own_direction() {
        let place = |i: i32| ContourPoint {
            part: 0,
            point: Point3::new(0.01 * f64::from(i), 0.0, 1.0),
            normal: -Vector3::z(),
            outward: Vector3::new(0.4 * f64::from(i % 2), 1.0, 0.0).normalize(),
            side: 0,
            configurations: [0.0; 2],
        };
        let points: Vec<ContourPoint> = (0..20).map(place).collect();
        assert!(straightened(&points).iter().all(|p| p.outward.dot(&Vector3::y()) > 0.999));
        assert!(straightened(&points[..2]).is_empty());
    }

    #[test]
    fn the_four_sides_of_a_board_are_numbered() {
        let directions: [Vector3<f64>; 4] =
            [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()];
        let place = |i: usize| ContourPoint {
            part: i / 8,
            point: Point3::new(0.01 * i as f64, 0.0, 1.0),
            normal: -Vector3::z(),
            outward: (directions[i % 4] + Vector3::<f64>::new(0.1, -0.1, 0.0)).normalize(),
            side: 0,
            configurations: [0.0; 2],
        };
        let mut contour: Vec<ContourPoint> = (0..16).map(place).collect();
        number_sides(&mut contour);
        let sides: Vec<usize> = contour.iter().map(|p| p.side).collect();
        assert_eq!(sides, [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3]);
    }
}
