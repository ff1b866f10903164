//! Chooses the joint between two bodies: a slide; a hinge if the residual of the slide is too
//! large; else no joint.
//!
//! In: the motions of a body and of its possible parent in the base frame, and the features of the
//! body; metres.
//! Out: the fitted joint, in the coordinates of the parent.
//! From: Katz & Brock 2010, as the paper describes it (section II).

use super::rigid_body::{Body, MIN_COMMON_FRAMES};
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointGeometry;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, UnitVector3, Vector3};

/// Largest residual of a slide, as root mean square over features and frames, metres; above it a
/// hinge is fitted.
const MAX_SLIDE_RESIDUAL_M: f64 = 0.01;
/// Largest residual of a hinge, metres; above it the two bodies are not connected.
const MAX_HINGE_RESIDUAL_M: f64 = 0.02;

/// A joint that was fitted to the motion of a body relative to its parent.
pub struct Fit {
    /// Line of the joint in the coordinates of the parent: the base frame, or the base frame at the
    /// first frame of the parent body.
    pub geometry: JointGeometry,
    /// Frames in which both bodies are known.
    pub frames: Vec<usize>,
    /// Configuration in each of `frames`, metres or radians.
    pub configuration: Vec<f64>,
    /// Root mean square distance of the features from the model, metres.
    pub residual: f64,
    /// Root mean square angle from the model, radians.
    pub turn_residual: f64,
}

/// Fits a slide or a hinge to the motion of a body in the base (`parent` is `None`) or in another
/// body; `None` if neither fits or there are too few common frames.
pub fn fit(child: &Body, parent: Option<&Body>) -> Option<Fit> {
    let (frames, motions): (Vec<usize>, Vec<Pose>) = child
        .base_from_body
        .iter()
        .enumerate()
        .filter_map(|(f, pose)| {
            let parent = match parent {
                Some(p) => Some(p.base_from_body[f].as_ref()?),
                None => None,
            };
            Some((f, relative(pose.as_ref()?, parent)))
        })
        .unzip();
    if frames.len() < MIN_COMMON_FRAMES {
        return None;
    }
    let rest = motions[0];
    let motions: Vec<Pose> = motions.iter().map(|m| m * rest.inverse()).collect();
    let points: Vec<Point3<f64>> = child.points.iter().map(|p| rest * p).collect();
    let centre =
        Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64);
    let slide = slide(&motions, centre)
        .map(|(geometry, q)| judged(geometry, &frames, q, &motions, &points))
        .filter(|fit| fit.residual < MAX_SLIDE_RESIDUAL_M);
    slide.or_else(|| {
        let (geometry, q) = hinge(&motions, centre)?;
        let fit = judged(geometry, &frames, q, &motions, &points);
        (fit.residual < MAX_HINGE_RESIDUAL_M).then_some(fit)
    })
}

fn slide(motions: &[Pose], centre: Point3<f64>) -> Option<(JointGeometry, Vec<f64>)> {
    let ways: Vec<Vector3<f64>> = motions.iter().map(|m| m * centre - centre).collect();
    let mut spread = Matrix3::zeros();
    for w in &ways {
        spread += w * w.transpose();
    }
    let eigen = spread.symmetric_eigen();
    let direction = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let axis = UnitVector3::try_new(direction, 1e-9)?;
    let q = ways.iter().map(|w| w.dot(&axis)).collect();
    Some((JointGeometry::slide(axis, centre), q))
}

/// The axis is the mean rotation axis; its position is the least-squares fixed point of the
/// motions.
fn hinge(motions: &[Pose], centre: Point3<f64>) -> Option<(JointGeometry, Vec<f64>)> {
    let turns: Vec<Vector3<f64>> = motions.iter().map(|m| m.rotation.scaled_axis()).collect();
    let widest = turns.iter().max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
    let sum: Vector3<f64> = turns.iter().map(|t| t * t.dot(widest).signum()).sum();
    let axis = UnitVector3::try_new(sum, 1e-6)?;
    let q: Vec<f64> = turns.iter().map(|t| t.dot(&axis)).collect();
    let mut left = DMatrix::zeros(3 * motions.len() + 1, 3);
    let mut right = DVector::zeros(3 * motions.len() + 1);
    for (i, m) in motions.iter().enumerate() {
        let turn = m.rotation.to_rotation_matrix();
        left.fixed_view_mut::<3, 3>(3 * i, 0).copy_from(&(Matrix3::identity() - turn.matrix()));
        right.fixed_rows_mut::<3>(3 * i).copy_from(&m.translation.vector);
    }
    // The position along the axis is free; the centroid of the body is taken.
    left.fixed_view_mut::<1, 3>(3 * motions.len(), 0).copy_from(&axis.transpose());
    right[3 * motions.len()] = axis.dot(&centre.coords);
    let origin = left.svd(true, true).solve(&right, 1e-6).ok()?;
    let origin = Point3::new(origin[0], origin[1], origin[2]);
    Some((JointGeometry::hinge(axis, origin), q))
}

fn judged(
    geometry: JointGeometry,
    frames: &[usize],
    configuration: Vec<f64>,
    motions: &[Pose],
    points: &[Point3<f64>],
) -> Fit {
    let (mut sum, mut turned) = (0.0, 0.0);
    for (motion, &q) in motions.iter().zip(&configuration) {
        let model = geometry.motion(q);
        let apart: f64 = points.iter().map(|p| (motion * p - model * p).norm_squared()).sum();
        sum += apart / points.len() as f64;
        turned += (model.inverse() * motion).rotation.angle().powi(2);
    }
    let n = motions.len() as f64;
    Fit {
        geometry,
        frames: frames.to_vec(),
        configuration,
        residual: (sum / n).sqrt(),
        turn_residual: (turned / n).sqrt(),
    }
}

/// Pose of a body in the coordinates of its parent, or in the base frame without a parent.
fn relative(pose: &Pose, parent: Option<&Pose>) -> Pose {
    parent.map_or(*pose, |p| p.inverse() * pose)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body of eight features that moves as `pose` says, in this many frames.
    fn body(frames: usize, pose: impl Fn(f64) -> Pose) -> Body {
        let corner = |i: usize| {
            Point3::new(0.2 * (i % 2) as f64, 0.2 * (i / 2 % 2) as f64, 1.0 + 0.1 * (i / 4) as f64)
        };
        Body {
            tracks: (0..8).collect(),
            base_from_body: (0..frames).map(|f| Some(pose(f as f64 / 29.0))).collect(),
            points: (0..8).map(corner).collect(),
        }
    }

    fn slides(t: f64) -> Pose {
        Pose::translation(0.3 * t, 0.0, 0.0)
    }

    fn turns(t: f64) -> Pose {
        JointGeometry::hinge(Vector3::y_axis(), Point3::new(-0.3, 0.0, 1.2)).motion(t)
    }

    #[test]
    fn a_straight_motion_is_a_slide_with_its_way_as_configuration() {
        let fit = fit(&body(30, slides), None).unwrap();
        assert_eq!(fit.geometry.kind.name(), "prismatic");
        assert!((fit.configuration[29].abs() - 0.3).abs() < 1e-9 && fit.residual < 1e-9);
    }

    #[test]
    fn what_turns_is_a_hinge_where_it_turns_about() {
        let fit = fit(&body(30, turns), None).unwrap();
        assert_eq!(fit.geometry.kind.name(), "revolute");
        let off = fit.geometry.origin - Point3::new(-0.3, 0.0, 1.2);
        assert!((off - Vector3::y() * off.y).norm() < 1e-6, "{off}");
        assert!((fit.configuration[29].abs() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_body_is_fitted_in_the_frame_of_another_that_moves() {
        let carried = body(30, |t| slides(t) * turns(t));
        let fit = fit(&carried, Some(&body(30, slides))).unwrap();
        assert_eq!(fit.geometry.kind.name(), "revolute");
        assert!(fit.residual < 1e-6, "{}", fit.residual);
    }

    #[test]
    fn too_few_common_frames_tell_nothing() {
        assert!(fit(&body(MIN_COMMON_FRAMES - 1, slides), None).is_none());
    }
}
