//! The baseline of the paper's experiment: features that keep their distance form a body; bodies
//! are followed by least squares without outlier rejection; a slide is assumed first, and a hinge
//! is fitted if the residual of the slide is too large.
//!
//! In: tracks in the base frame, metres. Like the paper, we give the baseline the forward-backward
//! check of its tracks and filtered depth; the camera's motion is that of
//! [`crate::learn::ego_motion`].
//! Out: the joints between bodies, and between bodies and the base; metres, radians.
//! From: Katz, Kazemi, Bagnell & Stentz, "Interactive Segmentation, Tracking, and Kinematic
//! Modeling of Unknown 3D Articulated Objects" (ICRA 2013), with the deterministic choice of models
//! of Katz & Brock (2010), as the paper describes them.

mod model;
mod rigid_body;

use super::learned_joint::{LearnedJoint, LearnedJoints, orient, range_of};
use super::recording::Recording;
use super::tracking::TrackSet;
use crate::object::model::Joint;
use model::Fit;
use rigid_body::Body;

/// The joints between bodies, and between bodies and the base. The baseline does not report
/// rejected candidates.
pub fn learn(recording: &Recording) -> LearnedJoints {
    let base = &recording.ego_motion;
    let bodies: Vec<Body> = rigid_body::cluster(base)
        .into_iter()
        .filter_map(|tracks| Body::follow(base, tracks))
        .collect();
    let mut joints: Vec<LearnedJoint> = Vec::new();
    // Number of the joint of each body that is connected.
    let mut number_of: Vec<Option<usize>> = vec![None; bodies.len()];
    for (i, child) in bodies.iter().enumerate() {
        let to_base = model::fit(child, None);
        let (parent, fit) = match to_base {
            Some(fit) => (None, fit),
            None => {
                let Some((p, fit)) = (0..i)
                    .filter(|&p| number_of[p].is_some())
                    .filter_map(|p| Some((p, model::fit(child, Some(&bodies[p]))?)))
                    .min_by(|(_, a), (_, b)| a.residual.total_cmp(&b.residual))
                else {
                    continue;
                };
                (Some(p), fit)
            }
        };
        let number = joints.len() + 1;
        number_of[i] = Some(number);
        let parent_number = parent.and_then(|p| number_of[p]).unwrap_or(0);
        joints.push(to_learned(&recording.tracks, number, parent_number, child, fit));
    }
    LearnedJoints { joints, ..LearnedJoints::default() }
}

fn to_learned(set: &TrackSet, number: usize, parent: usize, body: &Body, fit: Fit) -> LearnedJoint {
    let mut geometry = fit.geometry;
    let mut configuration = fit.configuration;
    orient(&mut geometry, &mut configuration);
    LearnedJoint {
        joint: Joint {
            name: format!("joint{number}"),
            parent,
            child: number,
            range: range_of(&configuration),
            observations: fit.frames.len(),
            position_rmse: fit.residual,
            orientation_rmse: fit.turn_residual,
            configuration: set.timed(&fit.frames, &configuration),
            // The baseline states no uncertainty.
            ..Joint::of(&geometry)
        },
        base_from_part: body.base_from_body.clone(),
        tracks: body.tracks.clone(),
        plain_surface: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::{BaseObservation, EgoMotion, Information, TrackInBase};
    use crate::learn::keyframes::Keyframes;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::{JointGeometry, JointKind};
    use nalgebra::{Point3, Vector3};
    use std::sync::Arc;

    const FRAMES: usize = 60;

    fn path(at: impl Fn(usize) -> Point3<f64>, moves: bool) -> Arc<TrackInBase> {
        let precision = Information::new(&Vector3::z(), 0.001, 0.001);
        let point = |f| Some(BaseObservation::new(at(f), precision, 0.001));
        let points = (0..FRAMES).map(point).collect();
        Arc::new(TrackInBase { points, moves, ..TrackInBase::default() })
    }

    fn learned(motion: impl Fn(usize) -> Pose) -> Vec<LearnedJoint> {
        let places =
            || (0..40).map(|i| Point3::new(0.02 * f64::from(i % 8), 0.03 * f64::from(i / 8), 1.0));
        let moved = places().map(|p| path(|f| motion(f) * p, true));
        let still = places().map(|p| path(|_| p + Vector3::new(0.0, 0.4, 0.0), false));
        let tracks: Vec<Arc<TrackInBase>> = moved.chain(still).collect();
        let base = EgoMotion {
            camera_from_base: vec![Pose::identity(); FRAMES],
            static_count: 40,
            tracks,
        };
        let frame_utimes = (0..FRAMES as i64).collect();
        let tracks = TrackSet { frame_utimes, tracks: Vec::new() };
        let recording = Recording { tracks, ego_motion: base, keyframes: Keyframes::new(2) };
        learn(&recording).joints
    }

    fn q(frame: usize) -> f64 {
        frame as f64 / FRAMES as f64
    }

    #[test]
    fn a_slide_is_a_slide() {
        let joints = learned(|f| Pose::translation(0.3 * q(f), 0.0, 0.0));
        assert_eq!(joints.len(), 1);
        assert_eq!(joints[0].joint.kind, JointKind::Prismatic);
        assert!(joints[0].joint.axis[0] > 0.999);
    }

    #[test]
    fn what_no_slide_explains_is_a_hinge() {
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(-0.2, 0.0, 1.1));
        let joints = learned(|f| line.motion(q(f)));
        assert_eq!(joints.len(), 1);
        let joint = &joints[0].joint;
        assert_eq!(joint.kind, JointKind::Revolute);
        assert!(joint.axis[1].abs() > 0.999);
        let off = Point3::from(joint.origin) - line.origin;
        assert!((off - Vector3::y() * off.y).norm() < 0.005, "{off}");
    }

    #[test]
    fn what_neither_explains_is_not_connected() {
        let joints = learned(|f| {
            let turn = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
            Pose::translation(0.0, 0.3 * (9.0 * q(f)).sin(), 0.0) * turn.motion(q(f))
        });
        assert!(joints.is_empty());
    }
}
