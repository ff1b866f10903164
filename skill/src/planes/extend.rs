//! What a hinge does where its tracks are lost: a lid that turns its other face, a door seen
//! at a grazing angle. Its plane is still there, about the line that the tracks told.

use super::hinge::Lie;
use super::patch::{PlanePatch, moving_patches};
use crate::articulate::{JointGeometry, JointKind};
use crate::base::BaseMotion;
use crate::geometry::orthonormal_basis;
use crate::keyframes::Keyframes;
use crate::structure::{LearnedJoint, range_of};
use crate::track::TrackSet;
use std::f64::consts::{PI, TAU};

/// Share of the frames from which a joint is known well enough.
const KNOWN_ENOUGH: f64 = 0.9;
/// The line that tracks told may be off by this much: sine of its angle with a plane,
const MAX_TILT: f64 = 0.12;
/// and metres.
const MAX_DISTANCE: f64 = 0.05;
/// Turns of one plane differ from the joint's configuration by a constant, within radians.
const MAX_STRAY: f64 = 0.1;
/// Keyframes in which tracks and plane must agree.
const MIN_AGREEING: usize = 2;
/// Farthest turn from one keyframe to the next, radians; as much more for each that shows nothing.
const MAX_STEP: f64 = 0.9;

/// A plane about the line, at a keyframe.
struct Sighting {
    frame: usize,
    lie: Lie,
    turn: f64,
    samples: usize,
}

/// Fills in configurations of hinges of the base where the part's plane shows them.
pub fn extend(
    joints: &mut [LearnedJoint],
    set: &TrackSet,
    base: &BaseMotion,
    keyframes: &Keyframes,
    seed: u64,
) {
    let lacks = |l: &LearnedJoint| {
        let known = l.base_from_part.iter().flatten().count();
        l.joint.kind == JointKind::Revolute
            && l.joint.parent == 0
            && (known as f64) < KNOWN_ENOUGH * l.base_from_part.len() as f64
    };
    if !joints.iter().any(lacks) {
        return;
    }
    let patches = moving_patches(keyframes, base, seed);
    let frames: Vec<usize> = keyframes.iter().map(|(frame, _)| frame).collect();
    for learned in joints.iter_mut().filter(|l| lacks(l)) {
        let found = shown_by_planes(learned, &patches, &frames);
        tracing::debug!(joint = learned.joint.name, keyframes = found.len(), "shown by its plane");
        if !found.is_empty() {
            fill(learned, &found, set);
        }
    }
}

/// Frame and configuration of keyframes in which tracks tell nothing.
fn shown_by_planes(
    learned: &LearnedJoint,
    patches: &[PlanePatch],
    keyframes: &[usize],
) -> Vec<(usize, f64)> {
    let geometry = learned.joint.geometry();
    let sightings = sightings(&geometry, patches);
    let known = |s: &Sighting| configuration(learned, &geometry, s.frame);
    let offsets: Vec<(f64, &Sighting)> =
        sightings.iter().filter_map(|s| Some((near(s.turn - known(s)?, 0.0), s))).collect();
    let agreeing =
        |offset: f64| offsets.iter().filter(move |(o, _)| near(o - offset, 0.0).abs() < MAX_STRAY);
    let best = offsets
        .iter()
        .map(|(offset, s)| (agreeing(*offset).map(|(_, s)| s.samples).sum::<usize>(), *offset, *s))
        .max_by_key(|(samples, ..)| *samples);
    let Some((_, offset, _)) = best else { return Vec::new() };
    let with: Vec<&Sighting> = agreeing(offset).map(|(_, s)| *s).collect();
    let Some(reference) = with.iter().max_by_key(|s| s.samples) else { return Vec::new() };
    if with.len() < MIN_AGREEING {
        return Vec::new();
    }
    let mut found = Vec::new();
    let (mut before, mut unseen) = (0.0, 0);
    for frame in 0..learned.base_from_part.len() {
        if let Some(q) = configuration(learned, &geometry, frame) {
            (before, unseen) = (q, 0);
            continue;
        }
        if !keyframes.contains(&frame) {
            continue;
        }
        unseen += 1;
        let own = sightings
            .iter()
            .filter(|s| s.frame == frame && s.lie.alike(&reference.lie))
            .max_by_key(|s| s.samples);
        if let Some(s) = own {
            let q = near(s.turn - offset, before);
            if (q - before).abs() < MAX_STEP * f64::from(unseen) {
                found.push((frame, q));
                (before, unseen) = (q, 0);
            }
        }
    }
    found
}

fn sightings(geometry: &JointGeometry, patches: &[PlanePatch]) -> Vec<Sighting> {
    let (axis, origin) = (geometry.axis.into_inner(), geometry.origin);
    let (u, v) = orthonormal_basis(&axis);
    patches
        .iter()
        .filter(|p| {
            p.normal.dot(&axis).abs() < MAX_TILT
                && (p.offset - p.normal.dot(&origin.coords)).abs() < MAX_DISTANCE
        })
        .filter_map(|p| {
            let lie = Lie::of(p, &origin, &axis)?;
            let turn = lie.arm.dot(&v).atan2(lie.arm.dot(&u));
            let turn = if axis.dot(&u.cross(&v)) < 0.0 { -turn } else { turn };
            Some(Sighting { frame: p.frame, turn, samples: p.points.len(), lie })
        })
        .collect()
}

/// The configuration of a frame, from the part's pose there.
fn configuration(learned: &LearnedJoint, geometry: &JointGeometry, frame: usize) -> Option<f64> {
    let pose = learned.base_from_part[frame]?;
    Some(pose.rotation.scaled_axis().dot(&geometry.axis))
}

/// The angle, whole turns from `angle`, that lies nearest to `to`.
fn near(angle: f64, to: f64) -> f64 {
    to + (angle - to + PI).rem_euclid(TAU) - PI
}

fn fill(learned: &mut LearnedJoint, found: &[(usize, f64)], set: &TrackSet) {
    let geometry = learned.joint.geometry();
    for &(frame, q) in found {
        learned.base_from_part[frame] = Some(geometry.motion(q));
    }
    let (frames, turns): (Vec<usize>, Vec<f64>) = (0..learned.base_from_part.len())
        .filter_map(|f| Some((f, configuration(learned, &geometry, f)?)))
        .unzip();
    learned.joint.range = range_of(&turns);
    learned.joint.configuration = set.timed(&frames, &turns);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Joint;
    use nalgebra::{Point3, Vector3};

    const LAST: usize = 40;

    fn line() -> JointGeometry {
        JointGeometry::hinge(Vector3::x_axis(), Point3::new(0.0, 0.0, 1.0))
    }

    /// How far a lid is turned in a frame.
    fn turn(frame: usize) -> f64 {
        0.04 * frame as f64
    }

    /// The plane of the lid in a frame.
    fn patch(frame: usize) -> PlanePatch {
        let at = |x: i32, y: i32| Point3::new(0.03 * f64::from(x), 0.02 * f64::from(y), 1.0);
        let closed = (-5..5).flat_map(|x| (1..10).map(move |y| at(x, y)));
        let motion = line().motion(turn(frame));
        let normal = motion.rotation * -Vector3::z();
        let points: Vec<Point3<f64>> = closed.map(|p| motion * p).collect();
        PlanePatch { frame, normal, offset: normal.dot(&points[0].coords), points }
    }

    /// Where planes show the lid that tracks followed to frame 12, if it is seen in these frames
    /// of all keyframes.
    fn shown(seen: &[usize]) -> Vec<(usize, f64)> {
        let learned = LearnedJoint {
            joint: Joint::of(&line()),
            base_from_part: (0..=LAST).map(|f| (f <= 12).then(|| line().motion(turn(f)))).collect(),
            tracks: Vec::new(),
        };
        let patches: Vec<PlanePatch> = seen.iter().map(|&f| patch(f)).collect();
        let keyframes: Vec<usize> = (0..=LAST).step_by(4).collect();
        shown_by_planes(&learned, &patches, &keyframes)
    }

    #[test]
    fn a_lid_is_followed_by_its_plane_though_it_was_out_of_sight() {
        let found = shown(&[0, 4, 8, 12, 36, 40]);
        assert_eq!(found.iter().map(|(f, _)| *f).collect::<Vec<_>>(), [36, 40]);
        assert!(found.iter().all(|(f, q)| (q - turn(*f)).abs() < 1e-6), "{found:?}");
    }

    #[test]
    fn an_angle_is_taken_where_it_continues_the_last() {
        assert!((near(-3.0, 3.0) - (TAU - 3.0)).abs() < 1e-12);
        assert!((near(0.2, 0.0) - 0.2).abs() < 1e-12);
    }
}
