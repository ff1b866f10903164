//! Hinges by depth alone: where tracks tell nothing, for want of texture or because a lid turns
//! its other face, a flat part is still seen to turn. Its plane in each keyframe, and the line
//! that all of them keep their distance from, are the hinge.
//!
//! A slide of a plain surface in its own plane leaves no trace in depth, and one along its
//! normal could be any of many: only hinges are sought.

mod axis_direction;
pub(crate) mod config;
mod depth_following;
mod extend_range;
mod hinge;
mod line_alignment;
mod part_plane;
mod plane_segments;
mod planes_about_axis;

use super::ego_motion::EgoMotion;
use super::keyframes::Keyframes;
use super::learned_joint::{LearnedJoint, orient, range_of};
use super::tracking::{TrackSet, Trajectory};
use crate::config::SkillConfig;
use crate::math::rigid::{distance_to_line, line_angle, orthonormal_basis};
use crate::math::robust::Moments;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::{Joint, covariance_rows};
use config::PlanesConfig;
use depth_following::{Following, Surface, View, follow};
use extend_range::{extend, extend_to};
use hinge::{Candidate, Hinge, SYSTEMATIC_RAD, candidates};
use line_alignment::{AlignedLine, align_line};
use nalgebra::{DMatrix, Point3};
use plane_segments::{PlanePatch, Sampling, moving_patches};

/// A plain part's hinge is the one that few tracks told of within this angle, radians,
const SAME_DIRECTION_RAD: f64 = 0.2;
/// and this distance, metres.
const SAME_PLACE_M: f64 = 0.15;

/// Lines that are followed in the depth pictures, the best supported first.
const MOST_FOLLOWED: usize = 12;
/// Turn by which a plane may differ from where its part was followed to, radians.
const SAME_TURN_RAD: f64 = 0.12;
/// How far beyond the planes' range the part is followed, radians: first a little, then farther.
const BEYOND_RAD: [f64; 2] = [0.3, 1.6];
/// Largest standard deviation of a line's place, metres: about one that is less known a robot
/// must not pull.
const MAX_PLACE_SIGMA_M: f64 = 0.02;
/// What planes do not tell of a place, however many there are, metres: ledges shift them.
const SYSTEMATIC_M: f64 = 0.005;
/// Share of the part's points that are found in a keyframe that shows it.
const LEAST_SHOWN: f64 = 0.3;
/// Share of the keyframes that must show it.
const LEAST_KEYFRAMES: f64 = 0.7;
/// Keyframes on end for which a part must rest,
const REST_KEYFRAMES: usize = 4;
/// and the turn that it may make meanwhile, radians.
const REST_RAD: f64 = 0.03;
/// Squared correlation of two configurations from which one joint is a consequence of the other.
const MAX_CORRELATION: f64 = 0.8;

/// What planes add to the joints that tracks told of: hinges that tracks told nothing of, and
/// configurations where tracks were lost.
pub fn complete(
    mut joints: Vec<LearnedJoint>,
    set: &TrackSet,
    base: &EgoMotion,
    keyframes: &Keyframes,
    config: &SkillConfig,
) -> Vec<LearnedJoint> {
    let mut plain: Vec<LearnedJoint> = Vec::new();
    for part in search(base, keyframes, &config.planes) {
        let learned = part.to_learned(set, base);
        let is_told = joints.iter().any(|j| {
            is_same_hinge(&j.joint, &learned.joint)
                || !is_meagre(j, &config.planes) && moves_together(j, &learned)
        });
        if !is_told {
            plain.push(learned);
            let added = plain.last_mut().expect("it was just added");
            extend_to(part.hinge.reach(), added, set, base, keyframes);
        }
    }
    // A hand that held a plain part is no joint beside it.
    joints
        .retain(|j| !(is_meagre(j, &config.planes) && plain.iter().any(|p| moves_together(p, j))));
    extend(&mut joints, set, base, keyframes);
    let first = joints.len() + 1;
    for (i, mut learned) in plain.into_iter().enumerate() {
        learned.joint.child = first + i;
        learned.joint.name = format!("joint{}", first + i);
        joints.push(learned);
    }
    joints
}

/// Few tracks told of it.
fn is_meagre(learned: &LearnedJoint, config: &PlanesConfig) -> bool {
    learned.joint.log_likelihood < config.meagre_gain
}

/// What one does is a function of what the other does.
fn moves_together(a: &LearnedJoint, b: &LearnedJoint) -> bool {
    let at = |l: &LearnedJoint| l.joint.configuration.clone();
    let (a, b) = (at(a), at(b));
    let common: Vec<(f64, f64)> = a
        .iter()
        .filter_map(|[t, q]| Some((*q, b.iter().find(|[s, _]| (s - t).abs() < 1e-4)?[1])))
        .collect();
    common.len() >= 5 && Moments::of(&common).correlation_sq().is_some_and(|c| c > MAX_CORRELATION)
}

/// Both are hinges about much the same line.
fn is_same_hinge(told: &Joint, plain: &Joint) -> bool {
    let axis = told.axis.into();
    told.kind == plain.kind
        && line_angle(&axis, &plain.axis.into()) < SAME_DIRECTION_RAD
        && distance_to_line(&told.origin.into(), &axis, &plain.origin.into()) < SAME_PLACE_M
}

/// A plain part that turns.
struct PlainPart {
    hinge: Hinge,
    /// Its line, aligned to the depth pictures.
    line: AlignedLine,
    /// The part's plane at configuration 0.
    surface: Surface,
    /// Its configuration at each keyframe.
    followed: Following,
    /// Planes that show it, by their place in the list.
    support: Vec<usize>,
}

/// Finds the hinges of plain parts.
fn search(base: &EgoMotion, keyframes: &Keyframes, config: &PlanesConfig) -> Vec<PlainPart> {
    let mut patches = moving_patches(keyframes, base, Sampling::Coarse, None);
    let mut found = Vec::new();
    let mut tried = 0;
    'next: while tried < MOST_FOLLOWED {
        for candidate in candidates(&patches, MOST_FOLLOWED - tried) {
            tried += 1;
            if let Some(part) =
                follow_hinge(&candidate, &patches, &View { base, keyframes }, config)
            {
                // What one part's plane explains, no other joint needs to.
                let mut index = 0;
                patches.retain(|_| {
                    index += 1;
                    !part.support.contains(&(index - 1))
                });
                found.push(part);
                continue 'next;
            }
        }
        break;
    }
    found
}

/// The hinge of a candidate whose part is seen to turn about it, and the planes that show it. Two
/// parts may turn about one line (a toilet's lid and seat): each plane at either end of the range,
/// and the largest, is followed by itself, and the one that most planes agree with is taken.
fn follow_hinge(
    candidate: &Candidate,
    patches: &[PlanePatch],
    view: &View,
    config: &PlanesConfig,
) -> Option<PlainPart> {
    let rough = candidate.hinge(patches, &candidate.support)?;
    let ends = rough.ends();
    ends.iter()
        .filter_map(|&seed| follow_plane(seed, &rough, candidate, patches, view, config))
        .max_by(|a, b| {
            let through = |part: &PlainPart| part.followed.share_through();
            let by_planes = a.support.len().cmp(&b.support.len());
            by_planes.then(through(b).total_cmp(&through(a)))
        })
}

/// The same for the part that one of the planes shows.
fn follow_plane(
    seed: usize,
    rough: &Hinge,
    candidate: &Candidate,
    patches: &[PlanePatch],
    view: &View,
    config: &PlanesConfig,
) -> Option<PlainPart> {
    let geometry = rough.geometry();
    let back = geometry.motion(-rough.turns[seed].1);
    let plane = &patches[candidate.support[seed]];
    let points: Vec<Point3<f64>> = plane.points.iter().map(|p| back * p).collect();
    let surface = Surface { points, normal: back * plane.normal }.thinned();
    // What turns beyond its planes is seen only where the pictures show nothing of it otherwise.
    let part = BEYOND_RAD.iter().find_map(|beyond| {
        let [low, high] = rough.range();
        let range = [low - beyond, high + beyond];
        let followed = follow(&surface, &geometry, range, rough.reach(), view);
        let agrees = |(k, (frame, turn)): (usize, &(usize, f64))| {
            let q = followed.at(*frame)?;
            ((turn - q).abs() < SAME_TURN_RAD).then_some(candidate.support[k])
        };
        let support: Vec<usize> = rough.turns.iter().enumerate().filter_map(agrees).collect();
        let hinge = candidate.hinge(patches, &support)?;
        // The line has moved a little: where the surface is about it is asked once more.
        let followed = follow(&surface, &hinge.geometry(), range, hinge.reach(), view);
        let line = align_line(&surface, &hinge, &followed, LEAST_SHOWN, view);
        let followed = follow(&surface, &line.geometry, range, hinge.reach(), view);
        let part = PlainPart { hinge, line, surface: surface.clone(), followed, support };
        let reason = part.doubt(config);
        part.report(patches.len(), rough.turns.len(), reason);
        reason.is_none().then_some(part)
    })?;
    Some(part)
}

impl PlainPart {
    fn report(&self, planes: usize, of: usize, reason: Option<&str>) {
        let [low, high] = self.followed.range(LEAST_SHOWN);
        tracing::debug!(
            planes,
            keyframes = self.support.len(),
            of,
            turn = high - low,
            rmse = self.hinge.rmse,
            residual = self.line.rmse,
            through = self.followed.share_through(),
            discriminability = self.followed.discriminability(),
            shown = self.followed.share_shown(LEAST_SHOWN),
            place_sigma = self.place_sigma(),
            axis = ?self.line.geometry.axis.as_slice(),
            origin = ?self.line.geometry.origin.coords.as_slice(),
            rejected = reason.unwrap_or("no"),
            "plain hinge"
        );
    }

    /// Why it is no part of an object; `None` where it is one.
    fn doubt(&self, config: &PlanesConfig) -> Option<&'static str> {
        let [low, high] = self.followed.range(LEAST_SHOWN);
        let reasons = [
            (self.support.len() < config.min_keyframes, "few planes lie about the line"),
            (!(high - low >= config.min_turn_rad), "it hardly turns"),
            (self.hinge.rmse > config.max_rmse_m, "its planes do not keep their distance"),
            (
                self.place_sigma() > MAX_PLACE_SIGMA_M,
                "it turns too little to tell about which line",
            ),
            (!self.followed.is_there_throughout(LEAST_SHOWN), "it comes and leaves"),
            (!self.followed.rests(REST_KEYFRAMES, REST_RAD), "it never rests"),
            (self.followed.share_through() > config.max_through, "it is seen through"),
            (
                self.followed.discriminability() < config.min_tells,
                "the pictures tell nothing of where it is",
            ),
            (
                self.followed.share_shown(LEAST_SHOWN) < LEAST_KEYFRAMES,
                "most pictures do not show it",
            ),
        ];
        reasons.into_iter().find(|(holds, _)| *holds).map(|(_, reason)| reason)
    }

    /// Largest standard deviation of the line's place, metres.
    fn place_sigma(&self) -> f64 {
        let place = self.line.covariance.view((3, 3), (3, 3)).into_owned();
        place.symmetric_eigenvalues().max().max(0.0).sqrt()
    }

    /// Covariance of (axis, origin): what the residuals tell, and what all readings share.
    fn covariance(&self) -> DMatrix<f64> {
        let mut covariance = self.line.covariance.clone();
        let (u, v) = orthonormal_basis(&self.line.geometry.axis);
        for side in [u, v] {
            for (r, c) in (0..9).map(|i| (i / 3, i % 3)) {
                covariance[(r, c)] += SYSTEMATIC_RAD.powi(2) * side[r] * side[c];
                covariance[(r + 3, c + 3)] += SYSTEMATIC_M.powi(2) * side[r] * side[c];
            }
        }
        covariance
    }

    fn to_learned(&self, set: &TrackSet, base: &EgoMotion) -> LearnedJoint {
        let mut geometry: JointGeometry = self.line.geometry.clone();
        let (frames, mut configuration): (Vec<usize>, Vec<f64>) =
            self.followed.shown(LEAST_SHOWN).map(|p| (p.frame, p.q)).unzip();
        orient(&mut geometry, &mut configuration);
        let mut base_from_part: Trajectory = vec![None; base.camera_from_base.len()];
        for (&frame, &q) in frames.iter().zip(&configuration) {
            base_from_part[frame] = Some(geometry.motion(q));
        }
        let joint = Joint {
            range: range_of(&configuration),
            covariance: covariance_rows(&self.covariance()),
            observations: frames.len(),
            position_rmse: self.line.rmse,
            configuration: set.timed(&frames, &configuration),
            type_probabilities: [(JointKind::Revolute, 1.0)].into(),
            ..Joint::of(&geometry)
        };
        let plain_surface = self.surface.points.clone();
        LearnedJoint { joint, base_from_part, tracks: Vec::new(), plain_surface }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitVector3, Vector3};

    #[test]
    fn a_hinge_is_the_same_only_near_the_line_that_tracks_told() {
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
