//! What a hinge does where its tracks are lost: a lid that turns its other face, a door seen
//! at a grazing angle. Its plane is still there, about the line that the tracks told. And where
//! few tracks live on from one stretch to the next, the stretches may be linked wrongly, by a
//! few degrees; the plane, which has no memory, tells by how much.

use super::hinge::Lie;
use super::patch::{PlanePatch, moving_patches};
use crate::articulate::{JointGeometry, JointKind};
use crate::base::BaseMotion;
use crate::geometry::{distance_to_line, median, orthonormal_basis};
use crate::keyframes::Keyframes;
use crate::structure::{LearnedJoint, range_of};
use crate::track::TrackSet;
use nalgebra::Point3;
use std::f64::consts::{PI, TAU};

/// The line that tracks told may be off by this much: sine of its angle with a plane,
const MAX_TILT: f64 = 0.12;
/// and metres.
const MAX_DISTANCE: f64 = 0.05;
/// The part may reach this much farther than its tracks: a share,
const MAX_BEYOND: f64 = 0.5;
/// and metres.
const BEYOND_M: f64 = 0.1;
/// Turns of one plane differ from the joint's configuration by a constant, within radians.
const MAX_STRAY: f64 = 0.1;
/// Keyframes in which tracks and plane must agree.
const MIN_AGREEING: usize = 2;
/// Stretches of tracks may be linked wrongly by this much, radians.
const MAX_SLIP: f64 = 0.3;
/// Slips that are worth mending: what planes tell is about a third as far off, radians.
const MIN_SLIP: f64 = 0.015;
/// Keyframes that must show the plane before slips are believed.
const MIN_SHOWN: usize = 6;
/// Tracks that link one face to the other: then the faces need not be parallel.
const LINKS: usize = 6;
/// Farthest turn from one keyframe to the next, radians; as much more for each that shows nothing.
const MAX_STEP: f64 = 0.9;

/// A plane about the line, at a keyframe.
struct Sighting {
    frame: usize,
    lie: Lie,
    turn: f64,
    samples: usize,
    /// The face that looks to where the part turns.
    fore: bool,
}

/// Mends and fills in configurations of hinges of the base where the part's plane shows them.
pub fn extend(
    joints: &mut [LearnedJoint],
    set: &TrackSet,
    base: &BaseMotion,
    keyframes: &Keyframes,
    seed: u64,
) {
    let carries: Vec<usize> = joints.iter().map(|l| l.joint.parent).collect();
    for learned in joints.iter_mut() {
        let joint = &learned.joint;
        let apt = joint.kind == JointKind::Revolute && joint.parent == 0;
        if !apt || carries.contains(&joint.child) {
            continue;
        }
        let line = joint.geometry();
        let reach = reach(learned, base, &line);
        let about = |p: &Point3<f64>| {
            distance_to_line(&line.origin, &line.axis, p) < reach * (1.0 + MAX_BEYOND) + BEYOND_M
        };
        let patches = moving_patches(keyframes, base, seed, about);
        let frames: Vec<usize> = keyframes.iter().map(|(frame, _)| frame).collect();
        let linked = |a: usize, b: usize| {
            let lives = |f: usize, id: usize| base.tracks[id].at(f).is_some();
            learned.tracks.iter().filter(|&&id| lives(a, id) && lives(b, id)).count()
        };
        let shown = shown_by_plane(learned, &patches, &frames, linked);
        if !shown.is_empty() {
            apply(learned, &shown, set);
        }
    }
}

/// Distance from the line up to which the joint's tracks lie.
fn reach(learned: &LearnedJoint, base: &BaseMotion, line: &JointGeometry) -> f64 {
    let mut found: Vec<f64> = learned
        .tracks
        .iter()
        .flat_map(|&id| base.tracks[id].points.iter().flatten().step_by(8))
        .map(|p| distance_to_line(&line.origin, &line.axis, &p.point))
        .collect();
    found.sort_by(f64::total_cmp);
    found.get(found.len() * 19 / 20).copied().unwrap_or_default()
}

/// Frame and configuration where the plane tells another than the tracks, or alone tells one.
fn shown_by_plane(
    learned: &LearnedJoint,
    patches: &[PlanePatch],
    keyframes: &[usize],
    linked: impl Fn(usize, usize) -> usize,
) -> Vec<(usize, f64)> {
    let geometry = learned.joint.geometry();
    let known: Vec<Option<f64>> = (0..learned.base_from_part.len())
        .map(|frame| configuration(learned, &geometry, frame))
        .collect();
    let sightings = sightings(&geometry, patches);
    let Some(plane) = PartPlane::of(&sightings, &known, linked) else { return Vec::new() };
    let (zero, mended) = plane.mended(&known);
    let mut shown: Vec<(usize, f64)> = (0..known.len())
        .filter(|&f| mended[f] != known[f])
        .filter_map(|f| Some((f, mended[f]?)))
        .collect();
    let alone = plane.alone(&mended, zero, keyframes);
    tracing::debug!(
        joint = learned.joint.name,
        keyframes = plane.sightings.len(),
        mended = shown.len(),
        alone = alone.len(),
        "shown by its plane"
    );
    shown.extend(alone);
    shown
}

/// A part's own plane in the keyframes that show it.
struct PartPlane<'a> {
    /// At most one a keyframe, in order.
    sightings: Vec<&'a Sighting>,
    /// Turn at configuration 0.
    zero: f64,
}

impl<'a> PartPlane<'a> {
    /// The plane that turns as tracks say, in most samples.
    fn of(
        all: &'a [Sighting],
        known: &[Option<f64>],
        linked: impl Fn(usize, usize) -> usize,
    ) -> Option<Self> {
        let zeros: Vec<(f64, &Sighting)> =
            all.iter().filter_map(|s| Some((near(s.turn - known[s.frame]?, 0.0), s))).collect();
        let agreeing =
            |zero: f64| zeros.iter().filter(move |(o, _)| near(o - zero, 0.0).abs() < MAX_STRAY);
        let samples = |zero: f64| agreeing(zero).map(|(_, s)| s.samples).sum::<usize>();
        let zero = zeros.iter().map(|(zero, _)| *zero).max_by_key(|zero| samples(*zero))?;
        let reference: &Sighting = agreeing(zero).map(|(_, s)| *s).max_by_key(|s| s.samples)?;
        if agreeing(zero).count() < MIN_AGREEING {
            return None;
        }
        let mut sightings: Vec<&Sighting> = Vec::new();
        for sighting in all.iter().filter(|s| s.lie.alike(&reference.lie)) {
            match sightings.last_mut() {
                Some(last) if last.frame == sighting.frame => {
                    if sighting.samples > last.samples {
                        *last = sighting;
                    }
                }
                _ => sightings.push(sighting),
            }
        }
        let joins =
            |w: &[&Sighting]| w[0].fore != w[1].fore && linked(w[0].frame, w[1].frame) >= LINKS;
        if sightings.windows(2).any(joins) {
            sightings.retain(|s| s.fore == reference.fore);
        }
        Some(Self { sightings, zero })
    }

    /// Turn at configuration 0, and the tracks' configurations without their slips.
    fn mended(&self, known: &[Option<f64>]) -> (f64, Vec<Option<f64>>) {
        let slips = self.slips(known);
        let Some(&(_, first)) = slips.first() else { return (self.zero, known.to_vec()) };
        let worst = slips.iter().map(|(_, slip)| (slip - first).abs()).fold(0.0, f64::max);
        if slips.len() < MIN_SHOWN || worst < MIN_SLIP {
            return (self.zero, known.to_vec());
        }
        let mend =
            |(frame, q): (usize, &Option<f64>)| q.map(|q| q + interpolated(&slips, frame) - first);
        (self.zero + first, known.iter().enumerate().map(mend).collect())
    }

    /// Keyframes and by how much the plane is turned farther there than tracks say; lone strays
    /// are smoothed away.
    fn slips(&self, known: &[Option<f64>]) -> Vec<(usize, f64)> {
        let raw: Vec<(usize, f64)> = self
            .sightings
            .iter()
            .filter_map(|s| Some((s.frame, near(s.turn - self.zero - known[s.frame]?, 0.0))))
            .filter(|(_, slip)| slip.abs() < MAX_SLIP)
            .collect();
        (0..raw.len())
            .map(|i| {
                let start = i.saturating_sub(1).min(raw.len().saturating_sub(3));
                let mut three: Vec<f64> = raw[start..].iter().take(3).map(|(_, s)| *s).collect();
                (raw[i].0, median(&mut three).unwrap_or_default())
            })
            .collect()
    }

    /// Configurations in keyframes in which tracks tell nothing.
    fn alone(&self, known: &[Option<f64>], zero: f64, keyframes: &[usize]) -> Vec<(usize, f64)> {
        let mut found = Vec::new();
        let (mut before, mut unseen) = (0.0, 0);
        for (frame, q) in known.iter().enumerate() {
            if let Some(q) = q {
                (before, unseen) = (*q, 0);
                continue;
            }
            if !keyframes.contains(&frame) {
                continue;
            }
            unseen += 1;
            let own = self.sightings.iter().find(|s| s.frame == frame);
            if let Some(s) = own {
                let q = near(s.turn - zero, before);
                if (q - before).abs() < MAX_STEP * f64::from(unseen) {
                    found.push((frame, q));
                    (before, unseen) = (q, 0);
                }
            }
        }
        found
    }
}

/// The value at a frame, between those of the frames around it.
fn interpolated(values: &[(usize, f64)], frame: usize) -> f64 {
    let next = values.partition_point(|(f, _)| *f < frame);
    match (next.checked_sub(1).map(|i| values[i]), values.get(next)) {
        (Some((a, va)), Some(&(b, vb))) => va + (vb - va) * (frame - a) as f64 / (b - a) as f64,
        (Some((_, only)), None) | (None, Some(&(_, only))) => only,
        (None, None) => 0.0,
    }
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
            let fore = axis.cross(&lie.arm).dot(&p.normal) > 0.0;
            Some(Sighting { frame: p.frame, turn, samples: p.points.len(), lie, fore })
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

fn apply(learned: &mut LearnedJoint, shown: &[(usize, f64)], set: &TrackSet) {
    let geometry = learned.joint.geometry();
    for &(frame, q) in shown {
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
    use nalgebra::Vector3;

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

    /// What planes in these frames show of a lid whose tracks say this; so many link its faces.
    fn shown(
        patches: &[PlanePatch],
        tracks: impl Fn(usize) -> Option<f64>,
        links: usize,
    ) -> Vec<(usize, f64)> {
        let learned = LearnedJoint {
            joint: Joint::of(&line()),
            base_from_part: (0..=LAST).map(|f| Some(line().motion(tracks(f)?))).collect(),
            tracks: Vec::new(),
        };
        shown_by_plane(&learned, patches, &keyframes(), |_, _| links)
    }

    fn keyframes() -> Vec<usize> {
        (0..=LAST).step_by(4).collect()
    }

    /// The patch, shown from its other side and, by a wedge, not parallel to the first.
    fn other_face(frame: usize, wedge: f64) -> PlanePatch {
        let face = patch(frame);
        let motion = line().motion(wedge);
        let points: Vec<Point3<f64>> = face.points.iter().map(|p| motion * p).collect();
        let normal = -(motion.rotation * face.normal);
        PlanePatch { frame, normal, offset: normal.dot(&points[0].coords), points }
    }

    /// The lid shows its other face from frame 20 on.
    fn both_faces(wedge: f64) -> Vec<PlanePatch> {
        let face = |f| if f < 20 { patch(f) } else { other_face(f, wedge) };
        keyframes().into_iter().map(face).collect()
    }

    #[test]
    fn a_lid_is_followed_by_its_plane_though_it_was_out_of_sight() {
        let seen = [0, 4, 8, 12, 36, 40].map(patch);
        let found = shown(&seen, |f| (f <= 12).then(|| turn(f)), 0);
        assert_eq!(found.iter().map(|(f, _)| *f).collect::<Vec<_>>(), [36, 40]);
        assert!(found.iter().all(|(f, q)| (q - turn(*f)).abs() < 1e-6), "{found:?}");
    }

    #[test]
    fn stretches_of_tracks_that_slipped_are_mended_by_the_plane() {
        let slipped = |f: usize| Some(turn(f) - if f < 20 { 0.0 } else { 0.1 });
        let found = shown(&both_faces(0.0), slipped, 0);
        let mended = |f: usize| found.iter().find(|(frame, _)| *frame == f).map(|(_, q)| *q);
        for frame in (0..=16).chain(20..=LAST) {
            let q = mended(frame).or(slipped(frame)).unwrap();
            assert!((q - turn(frame)).abs() < 1e-6, "{frame}: {q}");
        }
    }

    #[test]
    fn a_plane_that_strays_once_mends_nothing() {
        let mut seen = both_faces(0.0);
        seen[3] = other_face(12, 0.1);
        assert!(shown(&seen, |f| Some(turn(f)), 0).is_empty());
    }

    #[test]
    fn faces_that_tracks_link_need_not_be_parallel() {
        let wedge = both_faces(0.1);
        assert!(shown(&wedge, |f| Some(turn(f)), LINKS).is_empty());
        assert!(!shown(&wedge, |f| Some(turn(f)), 0).is_empty());
    }

    #[test]
    fn an_angle_is_taken_where_it_continues_the_last() {
        assert!((near(-3.0, 3.0) - (TAU - 3.0)).abs() < 1e-12);
        assert!((near(0.2, 0.0) - 0.2).abs() < 1e-12);
    }
}
