//! Alignment by contour: a plain board would slide in its plane, and the ends of its surface hold it.
//!
//! In: a state (camera frame, metres), the contour of an object and that of the frame.
//! Out: rows of normal equations, and a part's pose after some steps.
//! From: Gauss-Newton over distances along the outward direction.

use super::super::kinematics::{Articulated, State};
use super::super::normal_equations::{System, add_surface};
use super::super::scene::Scene;
use super::contour::ContourPoint;
use super::contour_grid::ContourGrid;
use super::end_profile::LEAST_COSINE;
use super::object_shape::ObjectShape;
use crate::math::rigid::{Pose, matrix_pose};

/// Largest number of contour points that count in full; of more each counts less.
const FULL_COUNT: f64 = 100.0;
/// Standard deviation of where a surface is seen to end: the sum of a part in metres and a part in pixels.
const END_SIGMA: (f64, f64) = (0.004, 1.0);

/// Adds the distances of contour points, along the direction outward, from where the surface in the image ends;
/// returns their number.
pub fn add_contour<'c>(
    system: &mut System,
    scene: &Scene,
    seen: &ContourGrid,
    contour: impl Iterator<Item = &'c ContourPoint>,
    articulated: &Articulated,
    state: &State,
) -> usize {
    let poses = articulated.poses(state);
    let velocities = articulated.velocities(&poses);
    let poses: Vec<_> = poses.iter().map(matrix_pose).collect();
    let mut found = Vec::new();
    for c in contour {
        let pose = &poses[c.part];
        let (point, normal, outward) = (pose * c.point, pose * c.normal, pose * c.outward);
        if -normal.dot(&point.coords) < LEAST_COSINE * point.coords.norm() {
            continue;
        }
        if let Some(end) = seen.nearest(&point, &normal, &outward) {
            found.push((c.part, point, end.outward, (point - end.point).dot(&end.outward)));
        }
    }
    let share = (FULL_COUNT / found.len().max(1) as f64).min(1.0);
    for (part, point, outward, residual) in &found {
        let sigma = END_SIGMA.0 + END_SIGMA.1 * point.z / scene.frame.camera.fx;
        let weight = share / sigma.powi(2) / (residual.abs() / sigma / 2.0).max(1.0);
        let row = velocities.of(*part, point).map(|v| outward.dot(&v));
        system.add(row, *residual, weight);
    }
    found.len()
}

/// Largest number of steps of the alignment of one part.
const STEPS: usize = 8;
/// Smallest number of surfels and contour points with which a part is aligned.
const LEAST_SEEN: usize = 12;
/// Largest distance of surfels from the seen surface in the first and in the last step, metres.
const GATES_M: (f64, f64) = (0.05, 0.02);

/// Pose of a part, aligned by its own surface and contour.
pub fn aligned(
    scene: &Scene,
    seen: &ContourGrid,
    shape: &ObjectShape,
    part: usize,
    camera_from_part: Pose,
) -> Pose {
    let rigid = Articulated { parts: shape.clouds.len(), joints: Vec::new() };
    let mut state = State { camera_from_object: camera_from_part, q: Vec::new() };
    for i in 0..STEPS {
        let closing = i as f64 / (STEPS - 1) as f64;
        let gate = GATES_M.0 + (GATES_M.1 - GATES_M.0) * closing;
        let mut system = System::new(6);
        let surface = add_surface(&mut system, scene, &rigid, &shape.clouds[part], &state, gate);
        let own = shape.contour.iter().filter(|c| c.part == part);
        let ends = add_contour(&mut system, scene, seen, own, &rigid, &state);
        if surface + ends < LEAST_SEEN {
            break;
        }
        let Some(step) = system.solve(10.0) else { break };
        state = rigid.stepped(&state, &step);
        if step.amax() < 2e-4 {
            break;
        }
    }
    state.camera_from_object
}

#[cfg(test)]
mod tests {
    use super::super::object_shape::Contours;
    use super::super::test_data::look_for_plain_slider;
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    /// How far the board of the slider was slid, metres.
    const SLID_M: f64 = 0.06;

    /// The board's pose, off by this shift and turn about the line of sight.
    fn off_by(shift: [f64; 3], turn: f64) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
        Pose::from_parts((Vector3::from(shift) + Vector3::x() * SLID_M).into(), turn)
    }

    /// The board, aligned from a pose; by its surface alone if its contour is not `used`. The picture
    /// shows it, or the wall alone.
    fn board_from(start: Pose, is_there: bool, used: bool) -> Pose {
        look_for_plain_slider(is_there.then_some(0.2), SLID_M, |refiner, contours| {
            let camera = &refiner.scene.frame.camera;
            let nothing = ContourGrid::new(Vec::new(), camera.depth_sensor, camera.fx);
            let seen = if used { contours.seen } else { &nothing };
            aligned(refiner.scene, seen, contours.shape, 1, start)
        })
    }

    #[test]
    fn a_board_beside_its_place_is_drawn_to_where_the_picture_ends() {
        let found = board_from(off_by([0.012, -0.01, 0.02], 0.03), true, true);
        let off = off_by([0.0; 3], 0.0).inverse() * found;
        // A pixel is half a centimetre wide there.
        assert!(off.translation.vector.norm() < 0.006, "{off}");
        assert!(off.rotation.angle() < 0.015, "{off}");
    }

    #[test]
    fn its_surface_alone_tells_how_far_a_board_is_and_leaves_it_where_it_is_in_its_plane() {
        let start = off_by([0.012, -0.01, 0.02], 0.0);
        let found = board_from(start, true, false);
        assert!(found.translation.z.abs() < 0.002, "{found}");
        let slid = (found.translation.vector - start.translation.vector).xy();
        assert!(slid.norm() < 0.003, "{slid}");
    }

    #[test]
    fn where_nothing_of_a_part_is_seen_its_pose_stays() {
        let start = off_by([0.012, -0.01, 0.02], 0.03);
        assert_eq!(board_from(start, false, true), start);
    }

    /// Rows that the board's contour adds, each place taken so many times, and what they tell of its pose.
    fn rows(camera_from_object: Pose, times: usize) -> (usize, Vec<Option<f64>>) {
        look_for_plain_slider(Some(0.2), SLID_M, |refiner, Contours { shape, seen }| {
            let state = State { camera_from_object, q: vec![SLID_M] };
            let mut system = System::new(7);
            let own: Vec<&ContourPoint> = shape.contour.iter().filter(|c| c.part == 1).collect();
            let places = own.iter().copied().cycle().take(times * own.len());
            let count =
                add_contour(&mut system, refiner.scene, seen, places, refiner.articulated, &state);
            (count, system.pose_deviations())
        })
    }

    #[test]
    fn only_places_near_an_end_in_the_picture_count() {
        let (all, _) = rows(Pose::identity(), 1);
        assert!(all > 40, "{all}");
        assert_eq!(rows(Pose::translation(0.0, 0.0, 0.3), 1).0, 0, "far behind");
        let about = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
        let turned = Pose::from_parts(Vector3::new(0.5, 0.0, 2.4).into(), about);
        assert_eq!(rows(turned, 1).0, 0, "in its place, but with its back to the camera");
    }

    #[test]
    fn of_more_than_a_hundred_places_each_counts_less() {
        let [(_, once), (two, twice), (four, often)] =
            [1, 2, 4].map(|times| rows(Pose::identity(), times));
        assert!(two > 100 && four == 2 * two);
        // The contour alone determines the rotation in the plane of the board.
        let turn = |told: &[Option<f64>]| told[2].unwrap();
        assert!(turn(&twice) < turn(&once));
        assert!((turn(&twice) - turn(&often)).abs() < 1e-9);
    }
}
