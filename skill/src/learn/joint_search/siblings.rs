//! Search for siblings of adopted joints: the drawers of a chest slide in one direction, and the doors of a cabinet
//! turn about parallel lines. An arm that pulls a drawer moves with it, so that a candidate may be grown from the tracks
//! of both and explain neither well. But the arm also moves in other directions: it comes and leaves.
//!
//! In: adopted joints, and the tracks that no joint explains.
//! Out: candidates of the same types with parallel lines, in the frames of their parents, accepted or not.
//! From: ours.

use super::association::gather;
use super::bundle_adjustment::OUTLIER_CUT;
use super::candidates::grown;
use super::estimate::JointEstimate;
use super::motion_hypotheses::{COVERED, Hypothesis, hypotheses};
use super::screw_joint::ScrewJoint;
use super::search_state::{MIN_MOVING, SearchState};
use super::tracks_in_part_frame::TracksInFrame;
use super::verification::verify;
use crate::learn::ego_motion::BaseObservation;
use crate::math::rigid::Pose;
use crate::math::robust::{median, overlap};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::HashSet;

/// Smallest share of a track's observations that lie on the line along which, or in the plane in which, it moves. An arm
/// that comes and leaves is seen on its way for longer than the other 15 %.
const KEEPS: f64 = 0.85;
/// Largest number of hypotheses that are grown for each joint, because a user waits. Among tracks of one direction the
/// strongest ones are siblings.
const GROWN: usize = 3;
/// Smallest cosine of the angle between the lines of siblings, 8 degrees: a short motion gives a direction no better.
const PARALLEL: f64 = 0.99;
/// Smallest cosine of the angle between lines that are parallel as exactly as they can be measured, 2.5 degrees. Two
/// drawers were 0.3 and 0.6 degrees apart.
const EXACTLY_PARALLEL: f64 = 0.999;

/// Smallest turn of a motion about a known line, radians: smaller ones have no line of their own.
const LEAST_TURN: f64 = 0.1;
/// Smallest cosine of the angle by which a motion about a known line turns that line, 18 degrees: few tracks in a short
/// window give no better motion.
const ABOUT_PARALLEL: f64 = 0.95;
/// Largest shift of a known line by a motion about it, metres.
const NEAR_LINE_M: f64 = 0.12;

/// Factor on the outlier cut for a joint's own tracks.
const ROUGHLY: f64 = 4.0;
/// Largest error of a motion that is the joint's own, as a share of the displacement.
const SAME_MOTION: f64 = 0.5;

/// Candidates for siblings of each adopted joint.
pub fn grow_siblings(
    search: &SearchState,
    unexplained: &[usize],
    round: usize,
) -> Vec<JointEstimate> {
    search
        .joints
        .par_iter()
        .flat_map_iter(|joint| {
            let view = search.view_from(joint.parent);
            let mut moving = search.moving_tracks(joint.parent, &view, unexplained);
            moving.retain(|&track| keeps_to(&joint.dof, &view, track));
            let mut found = siblings_among(search, (joint, None), &view, &moving, round);
            if joint.dof.hinge {
                let own = own_tracks(&view, joint, &moving);
                moving.retain(|&t| circles(&joint.dof, &view, t) && !own.contains(&t));
                let known = Some(joint.dof);
                found.extend(siblings_among(search, (joint, known), &view, &moving, round));
            }
            found
        })
        .collect()
}

/// Candidates for siblings of one joint among tracks that move as siblings do; about one line with it, if that is
/// `known`.
fn siblings_among(
    search: &SearchState,
    (joint, known): (&JointEstimate, Option<ScrewJoint>),
    view: &TracksInFrame,
    moving: &[usize],
    round: usize,
) -> Vec<JointEstimate> {
    if moving.len() < MIN_MOVING {
        return Vec::new();
    }
    let parent = joint.parent;
    let seed = search.settings.seed.wrapping_add(round as u64);
    let mut tried: Vec<Vec<usize>> = Vec::new();
    let mut found = Vec::new();
    let may_be = |h: &Hypothesis| {
        known.is_none_or(|line| {
            turns_about(&line, &h.motion) && !h.is_explained_by(joint, view, SAME_MOTION)
        })
    };
    for h in hypotheses(view, moving, 0, search.config(), seed).into_iter().filter(may_be) {
        if tried.len() == GROWN {
            break;
        }
        if tried.iter().any(|tracks| overlap(&h.tracks, tracks) > COVERED) {
            continue;
        }
        let candidate = grown(search, (&h, known), (parent, view, moving));
        tried.push(h.tracks);
        let sibling = candidate.and_then(|candidate| as_sibling(candidate, &joint.dof));
        found.extend(sibling.map(|sibling| verify(search, view, sibling, moving, "sibling")));
    }
    found
}

/// The candidate, if it is of the same type and parallel.
fn as_sibling(mut candidate: JointEstimate, dof: &ScrewJoint) -> Option<JointEstimate> {
    let cosine = candidate.dof.axis.dot(&dof.axis).abs();
    candidate.evidence.is_parallel_sibling = cosine > EXACTLY_PARALLEL;
    (candidate.dof.hinge == dof.hinge && cosine > PARALLEL).then_some(candidate)
}

/// True if a track moves as parts of siblings of a joint do: along a line parallel to a slide, or in a plane across a
/// hinge.
fn keeps_to(dof: &ScrewJoint, view: &TracksInFrame, track: usize) -> bool {
    let split = |place: &Point3<f64>| {
        let along = place.coords.dot(&dof.axis) * dof.axis;
        let beside = place.coords - along;
        if dof.hinge { (beside, along) } else { (along, beside) }
    };
    let seen: Vec<&BaseObservation> = view.life(track).map(|(_, seen)| seen).collect();
    let middle =
        |k: usize| median(&mut seen.iter().map(|s| split(&s.point).1[k]).collect::<Vec<f64>>());
    let [Some(x), Some(y), Some(z)] = [middle(0), middle(1), middle(2)] else { return false };
    let fixed = Vector3::new(x, y, z);
    let keeps = |s: &&&BaseObservation| {
        let (free, _) = split(&s.point);
        s.distance_sq(&Point3::from(free + fixed)) < OUTLIER_CUT
    };
    seen.iter().filter(keeps).count() as f64 >= KEEPS * seen.len() as f64
}

/// Tracks that roughly follow the joint itself: two parts that turn about one line differ only in when they turn.
fn own_tracks(view: &TracksInFrame, joint: &JointEstimate, moving: &[usize]) -> HashSet<usize> {
    let (mut joint, mut moving) = (joint.clone(), moving.to_vec());
    let followers = gather(view, &mut joint, &mut moving, ROUGHLY * OUTLIER_CUT);
    followers.into_iter().map(|follower| follower.track).collect()
}

/// True if a motion is a turn about the line of a hinge.
fn turns_about(hinge: &ScrewJoint, motion: &Pose) -> bool {
    let direction = motion.rotation * hinge.axis;
    let shift = motion * hinge.origin - hinge.origin;
    motion.rotation.angle() > LEAST_TURN
        && direction.dot(&hinge.axis) > ABOUT_PARALLEL
        && shift.norm() < NEAR_LINE_M
}

/// True if a track moves on a circle about the line of a hinge: the two doors of a fridge, or the lid and the seat of a
/// toilet, turn about one line.
fn circles(hinge: &ScrewJoint, view: &TracksInFrame, track: usize) -> bool {
    let beside = |place: &Point3<f64>| {
        let to_place = place - hinge.origin;
        to_place - to_place.dot(&hinge.axis) * hinge.axis
    };
    let seen: Vec<&BaseObservation> = view.life(track).map(|(_, seen)| seen).collect();
    let mut radii: Vec<f64> = seen.iter().map(|s| beside(&s.point).norm()).collect();
    let Some(radius) = median(&mut radii) else { return false };
    let keeps = |s: &&&BaseObservation| {
        let to_place = beside(&s.point);
        let length = to_place.norm();
        length > 0.0 && s.distance_sq(&(s.point - to_place * (1.0 - radius / length))) < OUTLIER_CUT
    };
    seen.iter().filter(keeps).count() as f64 >= KEEPS * seen.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::config::JointSearchConfig;
    use crate::learn::joint_search::test_data::{
        FRAMES, ON_FRONT, drawer, front, front_paths, recording_of, seen_along, with_search,
    };
    use crate::learn::joint_search::warm_start::WarmStart;

    /// Number of tracks on the second drawer, and on the arm that pulls it.
    const ON_SECOND: usize = 30;

    /// How far the second drawer is pulled out, metres: the first one rests again by then.
    fn second(frame: usize) -> f64 {
        0.02 * frame.saturating_sub(46).min(10) as f64
    }

    /// Paths of the first drawer, of a second one below it, and of an arm that comes down to the second one and pulls
    /// it out.
    fn two_drawers() -> Vec<Vec<Point3<f64>>> {
        let mut paths = front_paths();
        let place = |i: usize| (0.03 * (i % 10) as f64 - 0.135, 0.03 * (i / 10) as f64);
        paths.extend((0..ON_SECOND).map(|i| {
            let (x, y) = place(i);
            (0..FRAMES).map(|f| Point3::new(x, 0.3 + y, 1.5 - second(f))).collect()
        }));
        paths.extend((0..ON_SECOND).map(|i| {
            let (x, y) = place(i);
            let down = |f: usize| 0.01 * f.min(40) as f64;
            (0..FRAMES).map(|f| Point3::new(x, y - 0.1 + down(f), 1.4 - second(f))).collect()
        }));
        paths
    }

    #[test]
    fn a_second_drawer_is_a_candidate_and_the_arm_that_pulls_it_does_not_keep_to_its_line() {
        let recording = recording_of(two_drawers(), front);
        let config = JointSearchConfig::default();
        with_search(&recording, &config, &WarmStart::default(), |search| {
            let first = drawer(&search.base_view, |_| true);
            let kept = (ON_FRONT..ON_FRONT + 2 * ON_SECOND)
                .filter(|&track| keeps_to(&first.dof, &search.base_view, track));
            assert!(kept.eq(ON_FRONT..ON_FRONT + ON_SECOND));
            search.joints.push(first);
            let unexplained: Vec<usize> = (ON_FRONT..ON_FRONT + 2 * ON_SECOND).collect();
            let found = grow_siblings(search, &unexplained, 0);
            let second = found.iter().max_by(|a, b| a.gain.total_cmp(&b.gain)).expect("a drawer");
            assert!((second.span() - 0.2).abs() < 0.01, "{}", second.span());
            assert!(second.evidence.is_parallel_sibling && second.parent.is_none());
            assert_eq!(second.members, (ON_FRONT..ON_FRONT + ON_SECOND).collect::<Vec<_>>());
        });
    }

    /// The hinge about which both doors of a fridge turn.
    fn fridge_line() -> ScrewJoint {
        ScrewJoint::hinge(Vector3::y(), Point3::new(-0.3, 0.0, 1.5))
    }

    /// Turn of the lower door, radians.
    fn lower(frame: usize) -> f64 {
        0.1 * frame.saturating_sub(5).min(10) as f64
    }

    /// Turn of the upper door, radians: the lower one rests by then.
    fn upper(frame: usize) -> f64 {
        0.1 * frame.saturating_sub(46).min(10) as f64
    }

    #[test]
    fn the_second_door_about_one_line_is_a_candidate_and_the_first_one_is_not_again() {
        let line = fridge_line();
        let place = |i: usize, y: f64| {
            Point3::new(0.04 * (i % 10) as f64 - 0.2, y + 0.03 * (i / 10) as f64, 1.5)
        };
        let path = |turn: fn(usize) -> f64, p: Point3<f64>| -> Vec<Point3<f64>> {
            (0..FRAMES).map(|f| line.move_point(turn(f), &p)).collect()
        };
        let mut paths: Vec<_> = (0..ON_FRONT).map(|i| path(lower, place(i, 0.1))).collect();
        paths.extend((0..ON_SECOND).map(|i| path(upper, place(i, -0.3))));
        let recording = recording_of(paths, front);
        let config = JointSearchConfig::default();
        with_search(&recording, &config, &WarmStart::default(), |search| {
            let mut first = drawer(&search.base_view, |_| true);
            first.dof = line;
            first.q = (0..FRAMES).map(lower).collect();
            first.summarise();
            let all: Vec<usize> = (0..ON_FRONT + ON_SECOND).collect();
            let own = own_tracks(&search.base_view, &first, &all);
            assert_eq!(own, (0..ON_FRONT).collect());
            assert!(all.iter().all(|&track| circles(&line, &search.base_view, track)));
            search.joints.push(first);
            let found = grow_siblings(search, &all, 0);
            let second = found.iter().filter(|j| j.members.contains(&ON_FRONT));
            let second = second.max_by(|a, b| a.gain.total_cmp(&b.gain)).expect("a second door");
            assert!((second.span() - 1.0).abs() < 0.05, "{}", second.span());
            assert_eq!(second.members, (ON_FRONT..ON_FRONT + ON_SECOND).collect::<Vec<_>>());
        });
    }

    #[test]
    fn a_motion_turns_about_a_line_if_the_line_stays_where_it_is() {
        let line = fridge_line();
        assert!(turns_about(&line, &line.geometry().motion(0.4)));
        assert!(!turns_about(&line, &line.geometry().motion(0.02)), "it hardly turns");
        let aside = ScrewJoint::hinge(Vector3::y(), Point3::new(0.4, 0.0, 1.5));
        assert!(!turns_about(&line, &aside.geometry().motion(0.4)));
        let across = ScrewJoint::hinge(Vector3::x(), line.origin);
        assert!(!turns_about(&line, &across.geometry().motion(0.4)));
    }

    #[test]
    fn a_track_keeps_to_a_line_along_a_slide_or_to_a_plane_across_a_hinge() {
        let path = |at: fn(f64) -> Point3<f64>| (0..20).map(|f| at(0.02 * f64::from(f))).collect();
        let along: Vec<Point3<f64>> = path(|d| Point3::new(0.1, 0.2, 1.0 + d));
        let across: Vec<Point3<f64>> = path(|d| Point3::new(0.1 + d, 0.2, 1.0 + d));
        let slanted: Vec<Point3<f64>> = path(|d| Point3::new(0.1, 0.2 + d, 1.0 + d));
        let base = seen_along(&[along, across, slanted]);
        let view = TracksInFrame::from_base(&base, vec![0, 1, 2]);
        let kept = |dof: &ScrewJoint| [0, 1, 2].map(|track| keeps_to(dof, &view, track));
        let slide = ScrewJoint::slide(Vector3::z(), Point3::origin());
        assert_eq!(kept(&slide), [true, false, false]);
        let hinge = ScrewJoint::hinge(Vector3::y(), Point3::origin());
        assert_eq!(kept(&hinge), [true, true, false]);
    }

    #[test]
    fn what_is_not_parallel_is_no_sibling() {
        let config = JointSearchConfig::default();
        with_search(
            &recording_of(front_paths(), front),
            &config,
            &WarmStart::default(),
            |search| {
                let slide = ScrewJoint::slide(Vector3::z(), Point3::origin());
                let turned = |angle: f64| {
                    let mut joint = drawer(&search.base_view, |_| true);
                    joint.dof.axis = Vector3::new(angle.sin(), 0.0, angle.cos());
                    as_sibling(joint, &slide).map(|sibling| sibling.evidence.is_parallel_sibling)
                };
                assert_eq!([0.02, 0.1, 0.2].map(turned), [Some(true), Some(false), None]);
                let hinge = ScrewJoint::hinge(Vector3::z(), Point3::origin());
                assert!(as_sibling(drawer(&search.base_view, |_| true), &hinge).is_none());
            },
        );
    }
}
