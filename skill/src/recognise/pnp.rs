//! Where depth is missing: the base's pose from its matches' pixels alone (PnP), then each
//! joint's configuration from the pixels of the part that it moves.

use super::Found;
use super::articulated::{Articulated, State};
use super::matching::Match;
use super::scene::Scene;
use crate::geometry::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use opencv::calib3d;
use opencv::core::{Mat, Point2f, Point3f, Vector};
use opencv::prelude::*;

/// Inliers that a pose without depth must have: nothing else verifies it.
const MIN_INLIERS: usize = 12;
/// Reprojection error of an inlier, pixels.
const MAX_ERROR_PX: f64 = 4.0;
/// Configurations tried.
const SCAN: usize = 61;

/// The object from pixels; `None` without enough inliers.
pub fn find(scene: &Scene, articulated: &Articulated, matches: &[Match]) -> Option<Found> {
    let base: Vec<&Match> = matches.iter().filter(|m| m.part == 0).collect();
    let camera_from_object = solve(scene, &base).ok().flatten()?;
    let mut state = State { camera_from_object, q: articulated.rest() };
    let mut evident = Vec::new();
    let mut seen = vec![false; articulated.parts];
    seen[0] = true;
    for j in 0..articulated.joints.len() {
        let joint = &articulated.joints[j];
        let moved = articulated.moved_by(j);
        let of_joint: Vec<&Match> = matches.iter().filter(|m| moved.contains(&m.part)).collect();
        let (q, count) = (0..SCAN)
            .map(|i| joint.low + (joint.high - joint.low) * i as f64 / (SCAN - 1) as f64)
            .map(|q| {
                let mut tried = state.clone();
                tried.q[j] = q;
                (q, inliers(scene, articulated, &of_joint, &tried))
            })
            .max_by_key(|(_, count)| *count)?;
        if count >= 4 {
            state.q[j] = q;
        }
        evident.push(count >= 4);
        seen[joint.child] = count >= 4;
    }
    let all: Vec<&Match> = matches.iter().collect();
    let count = inliers(scene, articulated, &all, &state);
    let score = 1.0 - (-(count as f64) / 30.0).exp();
    let verdict = None;
    (count >= MIN_INLIERS).then_some(Found { state, score, inliers: count, verdict, seen, evident })
}

fn inliers(scene: &Scene, articulated: &Articulated, matches: &[&Match], state: &State) -> usize {
    let poses = articulated.poses(state);
    matches
        .iter()
        .filter(|m| {
            scene.frame.camera.project(&(poses[m.part] * m.model_point)).is_some_and(|p| {
                (p.x - f64::from(m.pixel[0])).hypot(p.y - f64::from(m.pixel[1])) < MAX_ERROR_PX
            })
        })
        .count()
}

fn solve(scene: &Scene, matches: &[&Match]) -> opencv::Result<Option<Pose>> {
    if matches.len() < 6 {
        return Ok(None);
    }
    let camera = &scene.frame.camera;
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
        500,
        MAX_ERROR_PX as f32,
        0.999,
        &mut inliers,
        calib3d::SOLVEPNP_EPNP,
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
