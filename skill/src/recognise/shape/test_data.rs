//! Test object of the searches for plain objects: a board without features that slides along x before a plain plate,
//! and a wall behind both.

use super::super::config::RecogniseConfig;
use super::super::kinematics::{Articulated, ChainJoint};
use super::super::refine::Refiner;
use super::super::render_cloud::KnownEdge;
use super::super::scene::Scene;
use super::super::test_data::{BOARD_M, PLATE_M, slider_surface};
use super::{ContourGrid, Contours, ObjectShape};
use crate::object::joint_geometry::JointGeometry;
use crate::test_data::seen as picture;
use nalgebra::{Point3, Vector3};

/// Distance of the wall from the camera, metres.
pub const WALL_M: f64 = 2.5;

/// Left, right and half the height of the board, metres.
const BOARD: [f64; 3] = [0.0, 0.4, 0.2];
/// Left, right and half the height of the plate behind the board, metres.
const PLATE: [f64; 3] = [-0.35, -0.15, 0.1];

/// Edges of a rectangle at depth `z`, 2 cm apart.
fn edges(part: usize, [left, right, half]: [f64; 3], z: f64) -> Vec<KnownEdge> {
    let edge = |x: f64, y: f64, outward: Vector3<f64>| {
        let end = Point3::new(x, y, z);
        KnownEdge {
            part,
            surface: end - 0.0075 * outward,
            normal: -Vector3::z(),
            beyond: end + 0.03 * outward,
            configurations: [-0.2, 0.2],
        }
    };
    let steps = |from: f64, to: f64| {
        (0..).map(move |i| from + 0.02 * f64::from(i)).take_while(move |x| *x <= to)
    };
    let upright = steps(-half, half)
        .flat_map(|y| [edge(left, y, -Vector3::x()), edge(right, y, Vector3::x())]);
    let level = steps(left, right)
        .flat_map(|x| [edge(x, -half, -Vector3::y()), edge(x, half, Vector3::y())]);
    upright.chain(level).collect()
}

/// Runs `look` on a scene that shows the plate and a board of half height `half`, slid by `slid` (metres); with
/// `None`, on the wall alone.
pub fn look_for_plain_slider<T>(
    half: Option<f64>,
    slid: f64,
    look: impl FnOnce(&Refiner, Contours) -> T,
) -> T {
    let is_on =
        |[left, right, half]: [f64; 3], x: f64, y: f64| x >= left && x < right && y.abs() < half;
    let depth = |x: f64, y: f64| {
        if half.is_some_and(|half| is_on([slid, 0.4 + slid, half], BOARD_M * x, BOARD_M * y)) {
            BOARD_M
        } else if half.is_some() && is_on(PLATE, PLATE_M * x, PLATE_M * y) {
            PLATE_M
        } else {
            WALL_M
        }
    };
    let scene = Scene::plain(&picture(1, depth)).unwrap();
    let geometry = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
    let joints = vec![ChainJoint::new(geometry, [0, 1], [-0.1, 0.1])];
    let articulated = Articulated { parts: 2, joints };
    let mut cloud = slider_surface(|_| 3.0);
    cloud.edges = [edges(0, PLATE, PLATE_M), edges(1, BOARD, BOARD_M)].concat();
    let shape = ObjectShape::new(&cloud.edges, &cloud, 2);
    let seen = ContourGrid::of(&scene);
    let contours = Contours { shape: &shape, seen: &seen };
    let config = RecogniseConfig::default();
    let by_surface = Refiner::by_surface(&scene, &articulated, &cloud, &config);
    let refiner = Refiner { shape: Some(contours), ..by_surface };
    look(&refiner, contours)
}
