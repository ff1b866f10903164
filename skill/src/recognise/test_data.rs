//! Test object: a board that slides along x before a plate; both face the camera.

use super::evidence::Detection;
use super::kinematics::State;
use super::render_cloud::{Cloud, CloudPoint};
use super::verdict::Verdict;
use nalgebra::{Point3, Vector3};

/// Distance of the board, part 1, from the camera, metres.
pub const BOARD_M: f64 = 1.2;
/// Distance of the plate, part 0, from the camera, metres.
pub const PLATE_M: f64 = 1.5;

const STEP_M: f64 = 0.015;
/// Left border of the board in x, and its size, metres.
const BOARD: (f64, f64) = (0.0, 0.4);
/// Left border of the plate in x, and its size, metres.
const PLATE: (f64, f64) = (-0.35, 0.2);

/// Surface of board and plate; `lightness` is a function of the height y in metres.
pub fn slider_surface(lightness: fn(f64) -> f32) -> Cloud {
    let square = |part, (left, size): (f64, f64), z| {
        let count = (size / STEP_M).round() as i32;
        (0..=count).flat_map(move |i| {
            (0..=count).map(move |j| {
                let (x, y) = (left + STEP_M * f64::from(i), STEP_M * f64::from(j) - 0.5 * size);
                let lab = [lightness(y), 0.0, 0.0];
                CloudPoint { part, point: Point3::new(x, y, z), normal: -Vector3::z(), lab }
            })
        })
    };
    Cloud::of(square(0, PLATE, PLATE_M).chain(square(1, BOARD, BOARD_M)).collect())
}

/// True if the ray through the point (x, y) at depth 1 m meets the board.
pub fn on_board(x: f64, y: f64) -> bool {
    (0.0..0.4).contains(&(BOARD_M * x)) && (BOARD_M * y).abs() < 0.2
}

/// True if the ray through the point (x, y) at depth 1 m would meet the plate if the board were not there.
pub fn on_plate(x: f64, y: f64) -> bool {
    (-0.36..-0.14).contains(&(PLATE_M * x)) && (PLATE_M * y).abs() < 0.11
}

/// A detection of the object with one joint, whose configuration is not determined, and these `placed` parts.
pub fn detection(state: State, verdict: Verdict, placed: Vec<bool>) -> Detection {
    let (evident, deviations) = (vec![false], vec![None]);
    Detection { state, score: 0.8, inliers: 20, verdict, placed, evident, deviations }
}
