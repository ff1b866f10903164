//! Hinges by depth alone. Where no track shows a joint, for want of texture or because a lid turns its
//! other face, a flat part is still seen to turn: its planes in all keyframes keep their distance from
//! the line of the hinge.
//!
//! A slide of a plain surface in its own plane leaves no trace in depth, and one along its
//! normal could be any of many: only hinges are sought.

mod axis_direction;
pub(crate) mod config;
mod extend_range;
mod hinge;
mod part_plane;
mod plane_segments;
mod planes_about_axis;

use super::free_space::{FreeSpaceCounts, count_free_space};
use super::learned_joint::{LearnedJoint, orient, range_of};
use super::recording::Recording;
use super::tracking::Trajectory;
use crate::math::rigid::{distance_to_line, line_angle};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::{Joint, covariance_rows};
use config::PlanesConfig;
use extend_range::{extend, extend_to};
use hinge::{Hinge, best_hinge};
use plane_segments::{Sampling, moving_patches};

/// Largest angle between the axes of a hinge that few tracks showed and of a plain part's hinge that
/// is the same, radians.
const SAME_DIRECTION_RAD: f64 = 0.2;
/// Largest distance between their lines, metres.
const SAME_PLACE_M: f64 = 0.15;

/// What planes add to the joints that tracks showed: a hinge where there is none, and configurations
/// where tracks were lost.
pub fn complete(
    mut joints: Vec<LearnedJoint>,
    recording: &Recording,
    config: &PlanesConfig,
) -> Vec<LearnedJoint> {
    let meagre = |j: &LearnedJoint| j.joint.log_likelihood < config.meagre_gain;
    if joints.iter().all(meagre)
        && let Some(hinge) = search(recording, config)
    {
        let mut plain = to_learned(&hinge, recording);
        if !joints.iter().any(|j| is_same_hinge(&j.joint, &plain.joint)) {
            extend_to(hinge.reach(), &mut plain, recording);
            return vec![plain];
        }
    }
    extend(&mut joints, recording);
    joints
}

/// Both are hinges about much the same line.
fn is_same_hinge(tracked: &Joint, plain: &Joint) -> bool {
    let axis = tracked.axis.into();
    tracked.kind == plain.kind
        && line_angle(&axis, &plain.axis.into()) < SAME_DIRECTION_RAD
        && distance_to_line(&tracked.origin.into(), &axis, &plain.origin.into()) < SAME_PLACE_M
}

/// Finds the hinge of a plain part; `None` when no plane turns about a line.
fn search(recording: &Recording, config: &PlanesConfig) -> Option<Hinge> {
    let patches = moving_patches(recording, Sampling::Coarse, None);
    let hinge = best_hinge(&patches)?;
    let [through, aside] = seen_through_shares(&hinge, recording);
    let [low, high] = hinge.range();
    tracing::debug!(
        planes = patches.len(),
        keyframes = hinge.turns.len(),
        turn = high - low,
        rmse = hinge.rmse,
        through,
        aside,
        rests = hinge.rests(),
        axis = ?hinge.axis.as_slice(),
        "plain hinge"
    );
    let stands = hinge.turns.len() >= config.min_keyframes
        && high - low >= config.min_turn_rad
        && hinge.rmse <= config.max_rmse_m
        && hinge.rests()
        && through <= config.max_through
        && aside >= config.min_tells;
    stands.then_some(hinge)
}

/// Shares of the part's points that keyframes see through: where the hinge puts them, and where
/// they would be if they were turned aside by half the range.
fn seen_through_shares(hinge: &Hinge, recording: &Recording) -> [f64; 2] {
    let [low, high] = hinge.range();
    let aside = 0.5 * (high - low);
    let (mut there, mut elsewhere) = (FreeSpaceCounts::default(), FreeSpaceCounts::default());
    for (frame, picture) in recording.keyframes.iter() {
        let Some(&(_, q)) = hinge.turns.iter().find(|(f, _)| *f == frame) else { continue };
        let camera_from_base = recording.ego_motion.camera_from_base[frame];
        let probe = |q: f64| {
            let camera_from_part = camera_from_base * hinge.geometry().motion(q);
            count_free_space(picture, &hinge.points, &camera_from_part)
        };
        there.add(probe(q));
        let turned = [q - aside, q + aside].map(probe);
        elsewhere.add(turned.into_iter().max_by_key(|p| p.through).unwrap_or_default());
    }
    [there.share_through(), elsewhere.share_through()]
}

fn to_learned(hinge: &Hinge, recording: &Recording) -> LearnedJoint {
    let mut geometry: JointGeometry = hinge.geometry();
    let (frames, mut configuration): (Vec<usize>, Vec<f64>) = hinge.turns.iter().copied().unzip();
    orient(&mut geometry, &mut configuration);
    let mut base_from_part: Trajectory = vec![None; recording.ego_motion.camera_from_base.len()];
    for (&frame, &q) in frames.iter().zip(&configuration) {
        base_from_part[frame] = Some(geometry.motion(q));
    }
    let joint = Joint {
        range: range_of(&configuration),
        covariance: covariance_rows(&hinge.covariance()),
        observations: hinge.turns.len(),
        position_rmse: hinge.rmse,
        configuration: recording.tracks.timed(&frames, &configuration),
        type_probabilities: [(JointKind::Revolute, 1.0)].into(),
        ..Joint::of(&geometry)
    };
    LearnedJoint { joint, base_from_part, tracks: Vec::new(), plain_surface: hinge.points.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, UnitVector3, Vector3};

    #[test]
    fn a_hinge_is_the_same_only_near_the_line_of_the_tracks() {
        let hinge = |direction: [f64; 3], origin: [f64; 3]| {
            let direction = UnitVector3::new_normalize(Vector3::from(direction));
            Joint::of(&JointGeometry::hinge(direction, Point3::from(origin)))
        };
        let plain = hinge([0.0, 1.0, 0.0], [0.3, 0.1, 2.5]);
        assert!(is_same_hinge(&hinge([0.1, -1.0, 0.0], [0.35, 0.8, 2.5]), &plain));
        assert!(!is_same_hinge(&hinge([0.0, 1.0, 0.0], [0.9, 0.1, 3.0]), &plain), "elsewhere");
        assert!(!is_same_hinge(&hinge([1.0, 0.0, 0.0], [0.3, 0.1, 2.5]), &plain), "crosswise");
    }
}
