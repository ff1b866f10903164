//! Determines which joints of the base are carried by a moving part, and attaches them to it. A
//! part that was found while its carrier rested looks like a part of the base, but it is lost when
//! the carrier moves.
//!
//! In: adopted joints in the frames of their parents.
//! Out: the same joints; those attached have a new parent and are in the frame of its part.

use super::association::associate;
use super::correlation::frames_away;
use super::decision::{accepts, is_missed_less, may_be_accepted};
use super::estimate::{JointEstimate, base_from_part};
use super::evidence::Evidence;
use super::search_state::SearchState;
use super::verification::verify;

/// Smallest number of frames in which a joint of the base must be lost while another part is away
/// from its rest.
const LEAST_LOST: usize = 10;
/// Number of association rounds with the new parent.
const ROUNDS: usize = 2;

/// Attaches joints of the base to the moving parts that carry their parts.
pub fn reparent(search: &mut SearchState) {
    let mut i = 0;
    while i < search.joints.len() {
        match attached_to_another(search, i) {
            Some(attached) => replace(search, i, attached),
            None => i += 1,
        }
    }
}

/// The joint of the base with a new parent, in the frame of the part that carries it; `None` if no
/// part does. Of several parts the one that leaves most frames known is taken.
fn attached_to_another(search: &SearchState, joint: usize) -> Option<JointEstimate> {
    let is_child = |j: &JointEstimate| j.parent == Some(joint);
    if search.joints[joint].parent.is_some() || search.joints.iter().any(is_child) {
        return None;
    }
    (0..search.joints.len())
        .filter(|&p| p != joint)
        .filter_map(|p| attached(search, joint, p))
        .max_by_key(|attached| attached.known_frames().len())
}

/// The joint of the base with `parent` as its parent, in the frame of that part; `None` if the part
/// does not carry it.
fn attached(search: &SearchState, joint: usize, parent: usize) -> Option<JointEstimate> {
    let alone = &search.joints[joint];
    if !is_lost_beside(search, alone, parent) {
        return None;
    }
    let away = frames_away(&search.joints[parent], alone);
    let mut attached = in_frame_of(search, alone, parent, &away)?;
    let view = search.view_from(Some(parent));
    let is_free = |t: &usize| {
        let others = search.joints.iter().enumerate();
        others.into_iter().all(|(j, other)| j == joint || !other.members.contains(t))
    };
    let candidates: Vec<usize> = (0..view.len()).filter(is_free).collect();
    associate(&view, &mut attached, &candidates, ROUNDS);
    attached = verify(search, &view, attached, &candidates, "attached");
    let found_by_tracks = 3 * lost(&attached, &away) < 2 * lost(alone, &away);
    // Tracks are often lost during a turn, but the depth images show where the part went.
    let found_in_pictures =
        attached.evidence.is_found_everywhere() && is_missed_less(&attached, alone);
    if found_in_pictures {
        // Depth confirms the part although the parent rests in all tracked frames, so a negative
        // correlation is set to 0.
        let parent_correlation = attached.evidence.parent_correlation.max(0.0);
        attached.evidence =
            Evidence { parent_correlation, is_parallel_sibling: false, ..attached.evidence };
    }
    // Evidence outweighs the cost of its tracks only if the tracks go along: pictures show an arm beside a chair too.
    let is_accepted = found_by_tracks
        && may_be_accepted(&attached, &attached.evidence, search.config())
        || found_in_pictures && accepts(&attached, search.config());
    is_accepted.then_some(attached)
}

/// A joint of the base in the frame of another's part, with that part at its rest. Frames in which
/// that part is `away` become unknown; `None` if the joint is known only in these.
fn in_frame_of(
    search: &SearchState,
    alone: &JointEstimate,
    parent: usize,
    away: &[bool],
) -> Option<JointEstimate> {
    let at_rest = (0..away.len()).find(|&f| !away[f] && alone.known[f])?;
    let part_from_base = base_from_part(&search.joints, parent, at_rest).inverse();
    let mut attached = alone.clone();
    attached.parent = Some(parent);
    attached.dof.axis = part_from_base * alone.dof.axis;
    attached.dof.origin = part_from_base * alone.dof.origin;
    attached.points.iter_mut().for_each(|p| *p = part_from_base * *p);
    attached.evidence = Evidence { contradicted_frames: Vec::new(), ..attached.evidence };
    attached.known.iter_mut().zip(away).for_each(|(known, away)| *known &= !away);
    if !attached.known[attached.anchor] {
        attached.anchor = at_rest;
    }
    Some(attached)
}

/// True if a joint is unknown in at least half of the frames in which another joint's part is away
/// from its rest: that part may carry the joint's own part.
pub fn is_lost_beside(search: &SearchState, alone: &JointEstimate, other: usize) -> bool {
    let away = frames_away(&search.joints[other], alone);
    let lost = lost(alone, &away);
    lost >= LEAST_LOST && 2 * lost >= away.iter().filter(|a| **a).count()
}

/// Replaces joint number `previous_id` by its attached version, which comes after its new parent.
fn replace(search: &mut SearchState, previous_id: usize, attached: JointEstimate) {
    search.joints.remove(previous_id);
    search.joints.push(attached);
    for parent in search.joints.iter_mut().filter_map(|j| j.parent.as_mut()) {
        *parent -= usize::from(*parent > previous_id);
    }
    search.renew_views(0);
}

/// Number of the marked `frames` in which a joint's configuration is unknown.
fn lost(joint: &JointEstimate, frames: &[bool]) -> usize {
    frames.iter().zip(&joint.known).filter(|(among, known)| **among && !**known).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::config::{JointSearchConfig, SearchSettings};
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_along;
    use crate::learn::joint_search::tracks_in_part_frame::TracksInFrame;
    use crate::learn::joint_search::verification::evaluate;
    use crate::learn::joint_search::warm_start::WarmStart;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::recording::Recording;
    use crate::learn::tracking::{Track, TrackId, TrackSet};
    use crate::test_data::seen;
    use linkage_frames::RgbdFrame;
    use nalgebra::{Point3, Vector3};
    use std::sync::Arc;

    const FRAMES: usize = 60;
    const POINTS: usize = 36;

    /// A chair's seat turns to and fro, then its back leans.
    fn seat_turn(f: usize) -> f64 {
        0.04 * (15 - (f as i32 - 25).abs().min(15)) as f64
    }

    fn lean(f: usize) -> f64 {
        0.03 * f.saturating_sub(45) as f64
    }

    fn joint(
        dof: ScrewJoint,
        q: fn(usize) -> f64,
        members: std::ops::Range<usize>,
    ) -> JointEstimate {
        let paths = vec![vec![Point3::origin(); FRAMES]; 2 * POINTS];
        let view = TracksInFrame::from_base(&seen_along(&paths), (0..2 * POINTS).collect());
        let mut joint = JointEstimate::new(dof, &view, 0);
        joint.q = (0..FRAMES).map(q).collect();
        joint.known = vec![true; FRAMES];
        joint.points = places();
        joint.members = members.collect();
        joint.summarise();
        joint
    }

    fn places() -> Vec<Point3<f64>> {
        let on = |y: f64| {
            (0..POINTS)
                .map(move |i| Point3::new(0.05 + 0.01 * i as f64, y + 0.02 * (i % 4) as f64, 1.4))
        };
        on(0.0).chain(on(-0.4)).collect()
    }

    /// What becomes of the back while the seat turns.
    #[derive(Clone, Copy, PartialEq)]
    enum Back {
        /// The back goes along, and its tracks survive.
        GoesAlong,
        /// The back goes along; its tracks are lost, and depth images show it.
        IsSeenToGoAlong,
        /// The back stays; its tracks are lost, and depth images show it.
        IsSeenToStay,
        /// The back stays, and its tracks survive.
        Stays,
    }

    impl Back {
        fn goes_along(self) -> bool {
            matches!(self, Self::GoesAlong | Self::IsSeenToGoAlong)
        }

        fn is_in_pictures(self) -> bool {
            matches!(self, Self::IsSeenToGoAlong | Self::IsSeenToStay)
        }
    }

    /// Paths of the points of the seat, then of the back.
    fn paths(seat: &ScrewJoint, back: &ScrewJoint, case: Back) -> Vec<Vec<Point3<f64>>> {
        let path = |(i, place): (usize, &Point3<f64>)| -> Vec<Point3<f64>> {
            let turned = |f: usize, p: &Point3<f64>| seat.move_point(seat_turn(f), p);
            let at = |f: usize| match (i < POINTS, case.goes_along()) {
                (true, _) => turned(f, place),
                (false, true) => turned(f, &back.move_point(lean(f), place)),
                (false, false) => back.move_point(lean(f), place),
            };
            (0..FRAMES).map(at).collect()
        };
        places().iter().enumerate().map(path).collect()
    }

    /// A picture of points as small boards before a wall.
    fn picture(points: &[Point3<f64>]) -> RgbdFrame {
        seen(0, |x, y| {
            let covers = |p: &&Point3<f64>| (p.x / p.z - x).hypot(p.y / p.z - y) < 0.02;
            points.iter().filter(covers).map(|p| p.z).fold(3.0, f64::min)
        })
    }

    /// Number of the joint whose part carries the back, which was found on the base while the seat
    /// rested.
    fn carrier_of_back(case: Back) -> Option<usize> {
        let seat = ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5));
        let back = ScrewJoint::hinge(Vector3::x(), Point3::new(0.0, -0.2, 1.5));
        let paths = paths(&seat, &back, case);
        let mut base = seen_along(&paths);
        let mut keyframes = Keyframes::new(FRAMES);
        if case.is_in_pictures() {
            for f in (0..FRAMES).step_by(3) {
                let mut points: Vec<_> = paths.iter().map(|path| path[f]).collect();
                // What holds the back along its hinge.
                let bar = (-10..=10).map(|k| Point3::new(0.05 * f64::from(k), -0.2, 1.5));
                points.extend(bar.map(|p| seat.move_point(seat_turn(f), &p)));
                keyframes.offer(f, &picture(&points));
            }
            for track in &mut base.tracks[POINTS..] {
                let died = |f: usize| seat_turn(f) > 0.0;
                Arc::make_mut(track)
                    .points
                    .iter_mut()
                    .enumerate()
                    .filter(|(f, _)| died(*f))
                    .for_each(|(_, p)| *p = None);
            }
        }
        let track = |id| Track { id: TrackId(id), first_frame: 0, observations: Vec::new() };
        let tracks = (0..paths.len()).map(track).collect();
        let tracks = TrackSet { frame_utimes: (0..FRAMES as i64).collect(), tracks };
        let recording = Recording { tracks, ego_motion: base, keyframes };
        let joints = JointSearchConfig::default();
        let settings = SearchSettings { joints: &joints, seed: 1 };
        let nothing = WarmStart::default();
        let view = Arc::new(TracksInFrame::moving(&recording.ego_motion));
        let mut search = SearchState::new(&recording, settings, &view, &nothing, None);
        let mut alone = joint(back, lean, POINTS..2 * POINTS);
        alone.known.iter_mut().enumerate().for_each(|(f, known)| *known = seat_turn(f) == 0.0);
        search.joints = vec![alone, joint(seat, seat_turn, 0..POINTS)];
        search.renew_views(0);
        let mut back = search.joints[0].clone();
        back.gain = 100.0;
        back.evidence = evaluate(&search, &view, &back);
        search.joints[0] = back;
        reparent(&mut search);
        let back = search.joints.iter().find(|j| j.dof.axis.y.abs() < 0.9)?;
        back.parent
    }

    #[test]
    fn what_goes_along_with_a_part_hangs_on_it() {
        assert_eq!(carrier_of_back(Back::GoesAlong), Some(0));
        assert_eq!(carrier_of_back(Back::IsSeenToGoAlong), Some(0));
    }

    #[test]
    fn what_stays_where_it_is_hangs_on_the_base() {
        assert_eq!(carrier_of_back(Back::Stays), None);
        assert_eq!(carrier_of_back(Back::IsSeenToStay), None);
    }
}
