//! Estimates the configuration of a hinge where its tracks are lost: a lid turns its other face, or a door is seen at
//! a grazing angle. The part's plane is still seen about the line of the tracks.
//!
//! Where few tracks connect two segments of time, the segments may be linked wrongly by a few degrees; the plane does
//! not drift and shows this slip. Where the plane is seen edge-on, so that there is no depth of it, the edge of the
//! part shows the configuration.
//!
//! In: hinges of the base with configurations from tracks, and the recording.
//! Out: the hinges with corrected direction, and corrected and additional configurations, radians.

use super::axis_direction::Direction;
use super::depth_following::EDGE_ON;
use super::part_plane::PartPlane;
use super::plane_segments::{Cylinder, PlanePatch, Sampling, moving_patches};
use super::planes_about_axis::{edges, plane_observations};
use crate::learn::ego_motion::EgoMotion;
use crate::learn::free_space::count_free_space;
use crate::learn::learned_joint::{LearnedJoint, orient, range_of, span_of};
use crate::learn::recording::Recording;
use crate::learn::tracking::TrackSet;
use crate::math::rigid::{Pose, distance_to_line, plane_through};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::Point3;

/// Smallest share of the keyframes in which a joint must be known for coarse sampling.
const KNOWN_ENOUGH: f64 = 0.9;
/// Largest difference between configurations that count as the same zero, radians.
const SAME_ZERO_RAD: f64 = 0.05;
/// First frames that must agree on the zero.
const TELL_ZERO: usize = 3;
/// Added to the reach of the tracks, as a share of it: a part may reach farther than its tracks.
const MAX_BEYOND: f64 = 0.5;
/// Added to the reach of the tracks, metres.
const BEYOND_M: f64 = 0.1;

/// Corrects and adds configurations of hinges of the base where the part's plane shows them. Hinges that carry
/// another joint are left as they are.
pub fn extend(joints: &mut [LearnedJoint], recording: &Recording) {
    let carries: Vec<usize> = joints.iter().map(|l| l.joint.parent).collect();
    for learned in joints.iter_mut() {
        let joint = &learned.joint;
        let apt = joint.kind == JointKind::Revolute && joint.parent == 0;
        if apt && !carries.contains(&joint.child) {
            let reach = reach(learned, &recording.ego_motion, &joint.geometry());
            extend_to(reach, learned, recording);
        }
    }
}

/// Corrects and adds configurations of one hinge of the base, whose part reaches `reach` metres from the line.
pub fn extend_to(reach: f64, learned: &mut LearnedJoint, recording: &Recording) {
    let radius = reach * (1.0 + MAX_BEYOND) + BEYOND_M;
    let cylinder = Cylinder { line: learned.joint.geometry(), radius };
    let frames: Vec<usize> = recording.keyframes.iter().map(|(frame, _)| frame).collect();
    let known = frames.iter().filter(|&&f| learned.base_from_part[f].is_some()).count();
    let sampling = if (known as f64) < KNOWN_ENOUGH * frames.len() as f64 {
        Sampling::Fine
    } else {
        Sampling::Coarse
    };
    let patches = moving_patches(recording, sampling, Some(&cylinder));
    let tracks = learned.tracks.clone();
    let linked = |a: usize, b: usize| {
        let lives = |f: usize, id: usize| recording.ego_motion.tracks[id].at(f).is_some();
        tracks.iter().filter(|&&id| lives(a, id) && lives(b, id)).count()
    };
    direct(learned, &patches, &recording.tracks, &linked);
    let mut shown = shown_by_plane(learned, &patches, &frames, &linked);
    let points = learned.points(&recording.ego_motion);
    let line = learned.joint.geometry();
    shown.retain(|&(frame, q)| {
        learned.base_from_part[frame].is_some()
            || !is_seen_through(&points, frame, &line.motion(q), recording)
    });
    if !shown.is_empty() {
        let known_from = learned.base_from_part.iter().position(Option::is_some);
        learned.place(&shown, &recording.tracks);
        if shown.iter().any(|(frame, _)| Some(*frame) < known_from) {
            count_from_first_frame(learned, &recording.tracks);
        }
    }
}

/// True if the depth image of a keyframe sees through more points of the part than it finds in place. The frame of a
/// cabinet lies in the plane of its closed door and is seen while the door stands open. False for a part that is seen
/// edge-on: a small error of the line puts all of it beside itself.
fn is_seen_through(
    points: &[Point3<f64>],
    frame: usize,
    base_from_part: &Pose,
    recording: &Recording,
) -> bool {
    let picture = recording.keyframes.iter().find(|(keyframe, _)| *keyframe == frame);
    let Some((_, picture)) = picture else { return false };
    let camera_from_part = recording.ego_motion.camera_from_base[frame] * base_from_part;
    let in_camera: Vec<Point3<f64>> = points.iter().map(|p| camera_from_part * p).collect();
    let (middle, normal) = plane_through(&in_camera);
    let is_edge_on = normal.dot(&middle.coords.normalize()).abs() < EDGE_ON;
    !is_edge_on && count_free_space(picture, points, &camera_from_part).margin() < 0
}

/// Distance from the line within which 95 % of the joint's track points lie, metres.
fn reach(learned: &LearnedJoint, base: &EgoMotion, line: &JointGeometry) -> f64 {
    let mut found: Vec<f64> = learned
        .tracks
        .iter()
        .flat_map(|&id| base.tracks[id].points.iter().flatten().step_by(8))
        .map(|p| distance_to_line(&line.origin, &line.axis, &p.point))
        .collect();
    found.sort_by(f64::total_cmp);
    found.get(found.len() * 19 / 20).copied().unwrap_or_default()
}

/// Corrects the line's direction from the planes about it.
fn direct(
    learned: &mut LearnedJoint,
    patches: &[PlanePatch],
    set: &TrackSet,
    linked: &impl Fn(usize, usize) -> usize,
) {
    let line = learned.joint.geometry();
    let known = learned.configurations();
    let plane_observations = plane_observations(&line, patches);
    let direction = PartPlane::of(&plane_observations, &known, linked)
        .and_then(|plane| Direction::across(&plane.normals()));
    if direction.is_some_and(|direction| direction.correct(learned)) {
        tracing::debug!(joint = learned.joint.name, "directed by its plane");
        set_configurations(learned, &known, set);
    }
}

/// Recomputes the part's poses after the joint's line was changed.
pub fn pose_anew(learned: &mut LearnedJoint, set: &TrackSet) {
    let known = learned.configurations();
    set_configurations(learned, &known, set);
}

/// Sets the part's poses from the known configurations, by frame.
fn set_configurations(learned: &mut LearnedJoint, known: &[Option<f64>], set: &TrackSet) {
    let all = known.iter().enumerate().filter_map(|(frame, q)| Some((frame, (*q)?)));
    learned.place(&all.collect::<Vec<_>>(), set);
}

/// Frames and configurations in which the plane shows another configuration than the tracks, or in which only the
/// plane shows one.
fn shown_by_plane(
    learned: &LearnedJoint,
    patches: &[PlanePatch],
    keyframes: &[usize],
    linked: &impl Fn(usize, usize) -> usize,
) -> Vec<(usize, f64)> {
    let geometry = learned.joint.geometry();
    let known = learned.configurations();
    let plane_observations = plane_observations(&geometry, patches);
    let Some(plane) = PartPlane::of(&plane_observations, &known, linked) else { return Vec::new() };
    let (zero, mended) = plane.mended(&known);
    let mut shown: Vec<(usize, f64)> = (0..known.len())
        .filter(|&f| mended[f] != known[f])
        .filter_map(|f| Some((f, mended[f]?)))
        .collect();
    let alone = plane.alone(&edges(&geometry, patches), &mended, zero, keyframes);
    tracing::debug!(
        joint = learned.joint.name,
        keyframes = plane.plane_observations.len(),
        mended = shown.len(),
        alone = alone.len(),
        "shown by its plane"
    );
    shown.extend(alone);
    shown
}

/// Moves configuration 0 to the first frame, if planes show the part in frames before those in which it was known.
/// Otherwise a flap that was first known standing open would count as open when it is shut.
fn count_from_first_frame(learned: &mut LearnedJoint, set: &TrackSet) {
    let known = learned.configurations().into_iter().enumerate();
    let (frames, mut turns): (Vec<usize>, Vec<f64>) =
        known.filter_map(|(frame, q)| Some((frame, q?))).unzip();
    // A single frame may show the plane of a hand.
    let at_first = &turns[..turns.len().min(TELL_ZERO)];
    let Some(&first) = turns.first() else { return };
    if first.abs() < SAME_ZERO_RAD || span_of(at_first) > SAME_ZERO_RAD {
        return;
    }
    let mut geometry = learned.joint.geometry();
    let to_first = geometry.motion(first);
    learned.plain_surface.iter_mut().for_each(|place| *place = to_first * *place);
    let axis = geometry.axis;
    orient(&mut geometry, &mut turns);
    if geometry.axis.dot(&axis) < 0.0 {
        learned.joint.turn_round();
    }
    for (&frame, &q) in frames.iter().zip(&turns) {
        learned.base_from_part[frame] = Some(geometry.motion(q));
    }
    learned.joint.range = range_of(&turns);
    learned.joint.configuration = set.timed(&frames, &turns);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::{BaseObservation, Information, TrackInBase};
    use crate::learn::plane_hinges::part_plane::LINKS;
    use crate::learn::plane_hinges::test_data::{HINGE_M, door_recording};
    use crate::learn::tracking::TrackId;
    use crate::object::model::Joint;
    use nalgebra::Vector3;
    use std::f64::consts::FRAC_PI_2;
    use std::sync::Arc;

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

    /// Configurations that planes add to a lid with these configurations from tracks; `links` tracks link its faces.
    fn shown(
        patches: &[PlanePatch],
        tracks: impl Fn(usize) -> Option<f64>,
        links: usize,
    ) -> Vec<(usize, f64)> {
        let learned = LearnedJoint {
            joint: Joint::of(&line()),
            base_from_part: (0..=LAST).map(|f| Some(line().motion(tracks(f)?))).collect(),
            tracks: Vec::new(),
            plain_surface: Vec::new(),
        };
        shown_by_plane(&learned, patches, &keyframes(), &|_, _| links)
    }

    fn keyframes() -> Vec<usize> {
        (0..=LAST).step_by(4).collect()
    }

    /// A flap with its turn in each keyframe, before and after its first frames were found.
    fn counted_from_first(turned: impl Fn(usize) -> f64) -> (LearnedJoint, [Point3<f64>; 2]) {
        let frames = keyframes();
        let set = TrackSet { frame_utimes: (0..=LAST as i64).collect(), tracks: Vec::new() };
        let pose = |f: usize| frames.contains(&f).then(|| line().motion(turned(f)));
        let mut learned = LearnedJoint {
            joint: Joint::of(&line()),
            base_from_part: (0..=LAST).map(pose).collect(),
            tracks: Vec::new(),
            plain_surface: vec![Point3::new(0.0, 0.3, 1.0)],
        };
        let place = |l: &LearnedJoint| l.base_from_part[24].unwrap() * l.plain_surface[0];
        let was = place(&learned);
        count_from_first_frame(&mut learned, &set);
        let is = place(&learned);
        (learned, [was, is])
    }

    fn told(learned: &LearnedJoint) -> Vec<f64> {
        learned.joint.configuration.iter().map(|[_, q]| *q).collect()
    }

    #[test]
    fn what_was_shut_at_first_is_shut_at_zero_and_opens_upwards() {
        // First known when it stood open, the flap had 0 there and 2 radians where it is shut.
        let opened = |f: usize| 0.1 * f.clamp(12, 32) as f64 - 1.2;
        let (learned, [was, is]) = counted_from_first(|f| 2.0 - opened(f));
        let q = told(&learned);
        assert!(q[0].abs() < 1e-9 && (q[10] - 2.0).abs() < 1e-9, "{q:?}");
        assert_eq!(learned.joint.axis, [-1.0, -0.0, -0.0], "it grows as the flap opens");
        assert!(learned.joint.range[0].abs() < 1e-9 && (learned.joint.range[1] - 2.0).abs() < 1e-9);
        assert!((was - is).norm() < 1e-9, "the part is where it was");
    }

    #[test]
    fn a_flap_may_turn_by_more_than_half_a_circle_from_its_first_frame() {
        let opened = |f: usize| 0.19 * f.clamp(12, 32) as f64 - 0.19 * 12.0;
        let (learned, _) = counted_from_first(|f| opened(f) - 1.9);
        let q = told(&learned);
        assert!(q[0].abs() < 1e-9 && (q[10] - 3.8).abs() < 1e-9, "{q:?}");
    }

    #[test]
    fn one_frame_that_differs_from_the_next_ones_is_no_zero() {
        let (learned, _) = counted_from_first(|f| if f == 0 { 1.0 } else { 0.0 });
        assert!(learned.joint.configuration.is_empty(), "as it was");
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
    fn segments_of_tracks_that_slipped_are_mended_by_the_plane() {
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

    /// The edge that faces away from the line, where the lid ends.
    fn edge(frame: usize) -> PlanePatch {
        let at = |x: i32, z: i32| Point3::new(0.03 * f64::from(x), 0.2, 1.0 + 0.004 * f64::from(z));
        let closed = (-5..5).flat_map(|x| (0..4).map(move |z| at(x, z)));
        let motion = line().motion(turn(frame));
        let normal = motion.rotation * Vector3::y();
        let points: Vec<Point3<f64>> = closed.map(|p| motion * p).collect();
        PlanePatch { frame, normal, offset: normal.dot(&points[0].coords), points }
    }

    #[test]
    fn a_lid_seen_edge_on_is_followed_by_its_edge() {
        let both = [0, 4, 8, 12].into_iter().flat_map(|f| [patch(f), edge(f)]);
        let seen: Vec<PlanePatch> = both.chain([16, 20, 24].map(edge)).collect();
        let found = shown(&seen, |f| (f <= 12).then(|| turn(f)), 0);
        assert_eq!(found.iter().map(|(f, _)| *f).collect::<Vec<_>>(), [16, 20, 24]);
        assert!(found.iter().all(|(f, q)| (q - turn(*f)).abs() < 1e-6), "{found:?}");
    }

    #[test]
    fn a_hand_beside_the_edge_does_not_hide_it() {
        let hand = |frame: usize| {
            let off = Vector3::new(0.0, 0.0, if frame.is_multiple_of(8) { 0.03 } else { -0.02 });
            let points = edge(frame).points.iter().map(|p| p + off).collect();
            PlanePatch { points, ..edge(frame) }
        };
        let all = [0, 4, 8, 12].into_iter().flat_map(|f| [patch(f), edge(f), hand(f)]);
        let seen: Vec<PlanePatch> = all.chain([16, 20, 24].map(edge)).collect();
        let found = shown(&seen, |f| (f <= 12).then(|| turn(f)), 0);
        assert_eq!(found.iter().map(|(f, _)| *f).collect::<Vec<_>>(), [16, 20, 24]);
        assert!(found.iter().all(|(f, q)| (q - turn(*f)).abs() < 1e-6), "{found:?}");
    }

    #[test]
    fn what_rests_is_no_edge_of_the_lid() {
        let still = |frame| PlanePatch { frame, ..edge(0) };
        let both = [0, 4, 8, 12].into_iter().flat_map(|f| [patch(f), still(f)]);
        let seen: Vec<PlanePatch> = both.chain([16, 20, 24].map(still)).collect();
        assert!(shown(&seen, |f| (f <= 12).then(|| turn(f)), 0).is_empty());
    }

    #[test]
    fn a_door_that_stands_open_is_seen_through_where_it_would_be_shut() {
        let (opened, edge_on) = (1.2, FRAC_PI_2 + (HINGE_M[0] / HINGE_M[1]).atan());
        let recording = door_recording(24, |f| match f {
            0..8 => 0.0,
            8..16 => opened,
            _ => edge_on,
        });
        let [x, z] = HINGE_M;
        let place = |i: i32, k: i32| Point3::new(x + 0.05 * f64::from(i), 0.1 * f64::from(k), z);
        let points: Vec<_> = (1..11).flat_map(|i| (-4..5).map(move |k| place(i, k))).collect();
        let turned_about = |hinge: f64, frame, q| {
            let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(hinge, 0.0, z));
            is_seen_through(&points, frame, &hinge.motion(q), &recording)
        };
        assert!(turned_about(x, 12, 0.0), "the front about the opening is no sign of a shut door");
        assert!(!turned_about(x, 12, opened) && !turned_about(x, 4, 0.0), "where it is");
        assert!(
            !turned_about(x + 0.02, 20, edge_on),
            "seen edge-on, about a line that is a little off"
        );
    }

    #[test]
    fn a_door_is_known_by_its_plane_where_tracks_do_not_show_it() {
        let turned = |f: usize| 0.15 * f.saturating_sub(6).min(8) as f64;
        let recording = door_recording(24, turned);
        let [x, z] = HINGE_M;
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(x, 0.0, z));
        let place = |i: i32, k: i32| Point3::new(x + 0.05 * f64::from(i), 0.1 * f64::from(k), z);
        let known = |f: usize| (f < 12).then(|| line.motion(turned(f)));
        let mut learned = LearnedJoint {
            joint: Joint::of(&line),
            base_from_part: (0..24).map(known).collect(),
            tracks: Vec::new(),
            plain_surface: (1..11).flat_map(|i| (-4..5).map(move |k| place(i, k))).collect(),
        };
        extend_to(0.6, &mut learned, &recording);
        let told = learned.configurations();
        let is_right = |f: usize| told[f].map(|q| (q - turned(f)).abs() < 0.05);
        let right: Vec<Option<bool>> = (12..24).map(is_right).collect();
        assert!(right.contains(&Some(true)) && !right.contains(&Some(false)), "{told:?}");
    }

    #[test]
    fn points_of_a_part_are_those_of_its_plain_surface_or_of_its_tracks() {
        let precision = Information::new(&Vector3::z(), 0.001, 0.001);
        let seen = BaseObservation::new(Point3::new(0.3, 0.0, 1.0), precision, 0.001);
        let points = vec![None, Some(seen)];
        let track = TrackInBase { id: TrackId(0), first_frame: 1, points, moves: true };
        let base = EgoMotion { tracks: vec![Arc::new(track)], ..EgoMotion::default() };
        let mut learned = LearnedJoint {
            joint: Joint::of(&line()),
            base_from_part: vec![None, None, Some(Pose::translation(0.1, 0.0, 0.0))],
            tracks: vec![0],
            plain_surface: Vec::new(),
        };
        assert!((learned.points(&base)[0] - Point3::new(0.2, 0.0, 1.0)).norm() < 1e-9);
        learned.plain_surface = vec![Point3::origin()];
        assert_eq!(learned.points(&base), [Point3::origin()]);
    }
}
