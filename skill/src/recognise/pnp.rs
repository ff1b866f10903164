//! Recognition without depth: the pose of one part from the pixels of its matches alone (PnP), then the
//! configuration of each joint from the pixels of the parts beyond it.
//!
//! In: matches (model side in the object frame at configuration 0, metres; seen side in pixels).
//! Out: a detection (camera frame, metres and radians), verified by its colours alone.
//! From: AP3P (Ke and Roumeliotis 2017) in RANSAC; Gauss-Newton over reprojection errors.

use super::evidence::{Detection, evident_joints};
use super::hypothesis::places;
use super::kinematics::{Articulated, State};
use super::matching::Match;
use super::normal_equations::System;
use super::render_cloud::Cloud;
use super::scene::Scene;
use super::verify::verify_appearance;
use crate::math::rigid::Pose;
use linkage_frames::PinholeCamera;
use nalgebra::{Matrix2x3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use opencv::calib3d;
use opencv::core::{Mat, Point2f, Point3f, Vector};
use opencv::prelude::*;

/// Smallest number of inliers of a pose without depth.
const MIN_INLIERS: usize = 12;
/// Smallest number of inliers that show a part.
const MIN_OF_PART: usize = 4;
/// Largest reprojection error of an inlier, pixels.
const MAX_ERROR_PX: f64 = 4.0;
/// Number of configurations tried of a joint.
const SCAN: usize = 61;
/// Numbers of a part's matches that are tried, the most distinct first: the more there are, the smaller the share of
/// right ones.
const LOTS: [usize; 3] = [40, 100, 250];
/// Number of steps of the refinement.
const STEPS: usize = 8;
/// Largest number of samples that RANSAC draws.
const SAMPLES: i32 = 2000;

/// Detection from pixels, verified by colour; `None` with too few inliers.
pub fn find(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    matches: &[Match],
) -> Option<Detection> {
    let camera = &scene.frame.camera;
    let (state, inliers) = place(camera, articulated, matches)?;
    let verdict = verify_appearance(scene, articulated, cloud, &state);
    let placed: Vec<bool> = (0..articulated.parts)
        .map(|p| {
            inliers_of(camera, articulated, matches, &state, &[p]) >= MIN_OF_PART
                && verdict.parts[p].correlates()
        })
        .collect();
    let evident = evident_joints(articulated, &placed);
    let score = verdict.appearance_score() * (1.0 - (-(inliers as f64) / 10.0).exp());
    let deviations = vec![None; articulated.joints.len()];
    Some(Detection { state, score, inliers, verdict, placed, evident, deviations })
}

/// State with the most inliers, and their number.
fn place(
    camera: &PinholeCamera,
    articulated: &Articulated,
    matches: &[Match],
) -> Option<(State, usize)> {
    (0..articulated.parts)
        .flat_map(|part| LOTS.map(|lot| (part, lot)))
        .filter_map(|(part, lot)| {
            let own: Vec<&Match> = matches.iter().filter(|m| m.part == part).take(lot).collect();
            let camera_from_part = solve(camera, &own).ok().flatten()?;
            let state = configured(camera, articulated, matches, part, &camera_from_part);
            let state = refined(camera, articulated, matches, state);
            let inliers = inliers(camera, articulated, matches, &state, |_| true);
            Some((state, inliers))
        })
        .max_by_key(|(_, inliers)| *inliers)
        .filter(|(_, inliers)| *inliers >= MIN_INLIERS)
}

/// State in which `part` has the given pose, with the configurations that most matches of the parts beyond each
/// joint agree with.
fn configured(
    camera: &PinholeCamera,
    articulated: &Articulated,
    matches: &[Match],
    part: usize,
    camera_from_part: &Pose,
) -> State {
    let mut q = articulated.rest();
    for (j, joint) in articulated.joints.iter().enumerate() {
        let moved = articulated.moved_by(j);
        let beyond: Vec<usize> =
            (0..articulated.parts).filter(|p| moved.contains(p) != moved.contains(&part)).collect();
        let tried = (0..SCAN).map(|i| {
            let mut tried = q.clone();
            tried[j] = joint.low + (joint.high - joint.low) * i as f64 / (SCAN - 1) as f64;
            let state = articulated.state_with(part, camera_from_part, tried);
            (inliers_of(camera, articulated, matches, &state, &beyond), state.q[j])
        });
        if let Some((count, best)) = tried.max_by_key(|(count, _)| *count)
            && count >= MIN_OF_PART
        {
            q[j] = best;
        }
    }
    articulated.state_with(part, camera_from_part, q)
}

/// Pose and configurations by least squares over the reprojection errors of all inliers.
fn refined(
    camera: &PinholeCamera,
    articulated: &Articulated,
    matches: &[Match],
    start: State,
) -> State {
    let mut state = start;
    for _ in 0..STEPS {
        let poses = articulated.poses(&state);
        let velocities = articulated.velocities(&poses);
        let mut system = System::new(6 + articulated.joints.len());
        for m in matches {
            let at = poses[m.part] * m.model_point;
            let Some(error) = off_by(camera, m, &at).filter(|e| e.norm() < MAX_ERROR_PX) else {
                continue;
            };
            let slope = Matrix2x3::new(
                camera.fx / at.z,
                0.0,
                -camera.fx * at.x / at.z.powi(2),
                0.0,
                camera.fy / at.z,
                -camera.fy * at.y / at.z.powi(2),
            );
            for k in 0..2 {
                let row = velocities.of(m.part, &at).map(|velocity| (slope * velocity)[k]);
                system.add(row, error[k], 1.0);
            }
        }
        let Some(step) = system.solve(1e-3) else { break };
        state = articulated.stepped(&state, &step);
    }
    state
}

/// Reprojection error of a match whose model point is at `at` in the camera frame, pixels.
fn off_by(camera: &PinholeCamera, m: &Match, at: &Point3<f64>) -> Option<Vector2<f64>> {
    let p = camera.project(at)?;
    Some(Vector2::new(p.x - f64::from(m.pixel[0]), p.y - f64::from(m.pixel[1])))
}

/// Number of inliers of a state on some parts, each place counted once.
fn inliers_of(
    camera: &PinholeCamera,
    articulated: &Articulated,
    matches: &[Match],
    state: &State,
    parts: &[usize],
) -> usize {
    inliers(camera, articulated, matches, state, |m| parts.contains(&m.part))
}

/// Number of inliers of a state among the matches that `counts` selects, each place counted once.
fn inliers(
    camera: &PinholeCamera,
    articulated: &Articulated,
    matches: &[Match],
    state: &State,
    counts: impl Fn(&Match) -> bool,
) -> usize {
    let poses = articulated.poses(state);
    places(matches.iter().filter(|m| {
        counts(m)
            && off_by(camera, m, &(poses[m.part] * m.model_point))
                .is_some_and(|e| e.norm() < MAX_ERROR_PX)
    }))
}

/// Pose of one part by RANSAC over the pixels of its matches; `None` with too few matches or inliers.
fn solve(camera: &PinholeCamera, matches: &[&Match]) -> opencv::Result<Option<Pose>> {
    if matches.len() < 6 {
        return Ok(None);
    }
    let object: Vector<Point3f> = matches
        .iter()
        .map(|m| {
            let p = m.model_point;
            Point3f::new(p.x as f32, p.y as f32, p.z as f32)
        })
        .collect();
    let picture: Vector<Point2f> =
        matches.iter().map(|m| Point2f::new(m.pixel[0], m.pixel[1])).collect();
    let intrinsics = Mat::from_slice_2d(&[
        [camera.fx, 0.0, camera.cx],
        [0.0, camera.fy, camera.cy],
        [0.0, 0.0, 1.0],
    ])?;
    let distortion = Mat::from_slice(&camera.distortion)?.try_clone()?;
    let (mut rotation, mut translation) = (Mat::default(), Mat::default());
    let mut inliers = Mat::default();
    let solved = calib3d::solve_pnp_ransac(
        &object,
        &picture,
        &intrinsics,
        &distortion,
        &mut rotation,
        &mut translation,
        false,
        SAMPLES,
        MAX_ERROR_PX as f32,
        0.9999,
        &mut inliers,
        calib3d::SOLVEPNP_AP3P,
    )?;
    if !solved || inliers.rows() < 6 {
        return Ok(None);
    }
    let vector = |m: &Mat| -> opencv::Result<Vector3<f64>> {
        Ok(Vector3::from_column_slice(m.data_typed::<f64>()?))
    };
    let pose = Pose::from_parts(
        Translation3::from(vector(&translation)?),
        UnitQuaternion::from_scaled_axis(vector(&rotation)?),
    );
    Ok(pose.translation.vector.iter().all(|x| x.is_finite()).then_some(pose))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::rotation_about;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::kinematics::ChainJoint;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A box and its door, hinged at its left edge.
    fn cupboard() -> Articulated {
        let geometry = JointGeometry::hinge(Vector3::y_axis(), Point3::new(-0.3, 0.0, 1.5));
        let joints = vec![ChainJoint::new(geometry, [0, 1], [-0.1, 1.6])];
        Articulated { parts: 2, joints }
    }

    /// Matches of both parts in a state, with half a pixel of noise, and as many wrong ones.
    fn seen(articulated: &Articulated, state: &State, camera: &PinholeCamera) -> Vec<Match> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let poses = articulated.poses(state);
        (0..160)
            .map(|i| {
                let part = usize::from(i % 4 >= 2);
                let depth = if part == 0 { rng.random_range(1.5..2.0) } else { 1.5 };
                let model_point =
                    Point3::new(rng.random_range(-0.3..0.3), rng.random_range(-0.4..0.4), depth);
                let pixel = match i % 2 {
                    0 => camera.project(&(poses[part] * model_point)).unwrap(),
                    _ => [rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)].into(),
                };
                let pixel = [pixel.x, pixel.y].map(|x| (x + rng.random_range(-0.5..0.5)) as f32);
                Match {
                    part,
                    model_point,
                    model_normal: Vector3::zeros(),
                    seen_point: None,
                    seen_normal: Vector3::zeros(),
                    pixel,
                    distance: 0.5,
                    ratio: 0.5,
                    tolerance: 0.0,
                }
            })
            .collect()
    }

    #[test]
    fn a_cupboard_is_placed_by_pixels_alone_and_its_door_told() {
        let (articulated, camera) = (cupboard(), PinholeCamera::kinect());
        let turned = rotation_about(&Point3::new(0.0, 0.0, 1.7), &Vector3::y_axis(), 0.3);
        let truth = State { camera_from_object: turned, q: vec![0.8] };
        let matches = seen(&articulated, &truth, &camera);
        let (state, inliers) = place(&camera, &articulated, &matches).unwrap();
        let off = truth.camera_from_object.inverse() * state.camera_from_object;
        assert!(off.rotation.angle().to_degrees() < 0.3, "{off}");
        assert!(inliers > 60 && (state.q[0] - 0.8).abs() < 0.02, "{inliers}, {:?}", state.q);
    }

    #[test]
    fn wrong_matches_alone_place_nothing() {
        let (articulated, camera) = (cupboard(), PinholeCamera::kinect());
        let rest = State { camera_from_object: Pose::identity(), q: vec![0.0] };
        let wrong: Vec<Match> =
            seen(&articulated, &rest, &camera).into_iter().skip(1).step_by(2).collect();
        assert!(place(&camera, &articulated, &wrong).is_none());
    }
}
