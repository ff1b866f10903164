//! Follows a part's own plane, keyframe by keyframe. It corrects slips of the tracks, and adds configurations where
//! no track shows the joint.
//!
//! In: planes and edges about a line, and the tracks' configurations by frame, radians.
//! Out: corrected and additional configurations, radians.

use super::planes_about_axis::{Edge, PlaneObservation, near};
use crate::math::rigid::wrapped;
use crate::math::robust::median;
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Largest deviation of a plane's turn from the joint's configuration plus a constant, radians.
const MAX_STRAY_RAD: f64 = 0.1;
/// Fewest keyframes in which tracks and plane must agree.
const MIN_AGREEING: usize = 2;
/// Largest slip between segments of tracks that are linked wrongly, radians.
const MAX_SLIP_RAD: f64 = 0.3;
/// Smallest slip that is corrected, radians: planes are about a third as far off.
const MIN_SLIP_RAD: f64 = 0.015;
/// Fewest keyframes that must show the plane for slips to be corrected.
const MIN_SHOWN: usize = 6;
/// Fewest tracks that link the keyframes of two faces for only one face to be used: the faces need not be parallel.
pub const LINKS: usize = 6;
/// Largest deviation of an edge's lead over the plane, radians.
const MAX_LEAD_STRAY_RAD: f64 = 0.03;
/// Width of a bin of turns that counts once, radians.
const TURN_STEP_RAD: f64 = 0.05;
/// Smallest range of turns over which an edge must keep its lead, radians.
const MIN_APART_RAD: f64 = 0.1;
/// Largest turn from one keyframe to the next, radians; as much is added for each keyframe that shows nothing.
const MAX_STEP_RAD: f64 = 0.9;

/// A part's own plane in the keyframes that show it.
pub struct PartPlane<'a> {
    /// At most one observation per keyframe, in time order.
    pub plane_observations: Vec<&'a PlaneObservation>,
    /// Angle of the plane at configuration 0, radians.
    zero: f64,
}

impl<'a> PartPlane<'a> {
    /// The plane whose turns agree with the tracks in most samples; `None` if too few keyframes agree. `known`:
    /// configuration by frame; `linked`: number of tracks that two frames share.
    pub fn of(
        all: &'a [PlaneObservation],
        known: &[Option<f64>],
        linked: impl Fn(usize, usize) -> usize,
    ) -> Option<Self> {
        let zeros: Vec<(f64, &PlaneObservation)> =
            all.iter().filter_map(|s| Some((wrapped(s.turn - known[s.frame]?), s))).collect();
        let agreeing =
            |zero: f64| zeros.iter().filter(move |(o, _)| wrapped(o - zero).abs() < MAX_STRAY_RAD);
        let samples = |zero: f64| agreeing(zero).map(|(_, s)| s.samples).sum::<usize>();
        let zero = zeros.iter().map(|(zero, _)| *zero).max_by_key(|zero| samples(*zero))?;
        let reference: &PlaneObservation =
            agreeing(zero).map(|(_, s)| *s).max_by_key(|s| s.samples)?;
        if agreeing(zero).count() < MIN_AGREEING {
            return None;
        }
        let mut plane_observations: Vec<&PlaneObservation> = Vec::new();
        for observation in all.iter().filter(|s| s.pose.alike(&reference.pose)) {
            match plane_observations.last_mut() {
                Some(last) if last.frame == observation.frame => {
                    if observation.samples > last.samples {
                        *last = observation;
                    }
                }
                _ => plane_observations.push(observation),
            }
        }
        let joins = |w: &[&PlaneObservation]| {
            w[0].fore != w[1].fore && linked(w[0].frame, w[1].frame) >= LINKS
        };
        if plane_observations.windows(2).any(joins) {
            plane_observations.retain(|s| s.fore == reference.fore);
        }
        Some(Self { plane_observations, zero })
    }

    /// Unit normals of the plane, base frame.
    pub fn normals(&self) -> Vec<Vector3<f64>> {
        self.plane_observations.iter().map(|s| s.normal).collect()
    }

    /// The plane's angle at configuration 0, and the tracks' configurations without their slips, radians.
    pub fn mended(&self, known: &[Option<f64>]) -> (f64, Vec<Option<f64>>) {
        let slips = self.slips(known);
        let Some(&(_, first)) = slips.first() else { return (self.zero, known.to_vec()) };
        let worst = slips.iter().map(|(_, slip)| (slip - first).abs()).fold(0.0, f64::max);
        if slips.len() < MIN_SHOWN || worst < MIN_SLIP_RAD {
            return (self.zero, known.to_vec());
        }
        let mend =
            |(frame, q): (usize, &Option<f64>)| q.map(|q| q + interpolated(&slips, frame) - first);
        (self.zero + first, known.iter().enumerate().map(mend).collect())
    }

    /// Keyframes, and by how much the plane is turned farther there than the tracks' configuration, radians. A median
    /// of three removes single outliers.
    fn slips(&self, known: &[Option<f64>]) -> Vec<(usize, f64)> {
        let raw: Vec<(usize, f64)> = self
            .plane_observations
            .iter()
            .filter_map(|s| Some((s.frame, wrapped(s.turn - self.zero - known[s.frame]?))))
            .filter(|(_, slip)| slip.abs() < MAX_SLIP_RAD)
            .collect();
        (0..raw.len())
            .map(|i| {
                let start = i.saturating_sub(1).min(raw.len().saturating_sub(3));
                let mut three: Vec<f64> = raw[start..].iter().take(3).map(|(_, s)| *s).collect();
                (raw[i].0, median(&mut three).unwrap_or_default())
            })
            .collect()
    }

    /// Configurations in keyframes in which no track shows the joint: from the plane or from an edge, whichever is
    /// nearer to the last configuration.
    pub fn alone(
        &self,
        edges: &[Edge],
        known: &[Option<f64>],
        zero: f64,
        keyframes: &[usize],
    ) -> Vec<(usize, f64)> {
        let edge = self.edge(edges);
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
            let own = self.plane_observations.iter().find(|s| s.frame == frame).map(|s| s.turn);
            let by_edge = edge.as_ref().and_then(|edge| edge.turn(frame));
            let shown = own.into_iter().chain(by_edge).map(|turn| near(turn - zero, before));
            let step = |q: &f64| (q - before).abs();
            if let Some(q) = shown.min_by(|a, b| step(a).total_cmp(&step(b)))
                && step(&q) < MAX_STEP_RAD * f64::from(unseen)
            {
                found.push((frame, q));
                (before, unseen) = (q, 0);
            }
        }
        found
    }

    /// The edge that keeps its lead over the plane at most turns.
    fn edge<'e>(&self, edges: &'e [Edge]) -> Option<PartEdge<'e>> {
        let like = |first: &Edge| {
            let alike = edges.iter().filter(|e| first.alike(e)).collect();
            let (lead, turn) = self.lead(first)?;
            Some(PartEdge { edges: alike, lead, turn })
        };
        edges
            .iter()
            .filter_map(|first| like(first).and_then(|edge| Some((self.agreement(&edge)?, edge))))
            .max_by_key(|(agreement, _)| *agreement)
            .map(|(_, edge)| edge)
    }

    /// Angle by which an edge is ahead of the plane, and the plane's turn, if the keyframe shows both; radians.
    fn lead(&self, edge: &Edge) -> Option<(f64, f64)> {
        let own = self.plane_observations.iter().find(|s| s.frame == edge.frame)?;
        Some((wrapped(edge.turn - own.turn), own.turn))
    }

    /// Number of turns at which an edge keeps its lead, and its samples there. `None` if these turns are close
    /// together, or if the lead differs at many others: a resting surface keeps a lead only while the plane rests
    /// too. A hand beside the edge in a few keyframes does not count.
    fn agreement(&self, edge: &PartEdge) -> Option<(usize, usize)> {
        let (mut with, mut without) = (BTreeMap::new(), BTreeSet::new());
        let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for e in &edge.edges {
            let Some((lead, turn)) = self.lead(e) else { continue };
            let turn = wrapped(turn - edge.turn);
            let step = (turn / TURN_STEP_RAD).round() as i64;
            if wrapped(lead - edge.lead).abs() < MAX_LEAD_STRAY_RAD {
                *with.entry(step).or_default() += e.samples;
                (lowest, highest) = (lowest.min(turn), highest.max(turn));
            } else {
                without.insert(step);
            }
        }
        without.retain(|step| !with.contains_key(step));
        let apart = highest - lowest > MIN_APART_RAD;
        let enough = apart && with.len() > 2 * without.len();
        enough.then(|| (with.len(), with.values().sum()))
    }
}

/// An edge that turns ahead of its part's plane by a constant angle.
struct PartEdge<'a> {
    edges: Vec<&'a Edge>,
    lead: f64,
    /// Turn of the plane where the lead was measured, radians.
    turn: f64,
}

impl PartEdge<'_> {
    /// Turn of the plane in a frame that shows the edge, radians.
    fn turn(&self, frame: usize) -> Option<f64> {
        let seen = self.edges.iter().filter(|e| e.frame == frame);
        Some(seen.max_by_key(|e| e.samples)?.turn - self.lead)
    }
}

/// The value at a frame, interpolated between the neighbouring values.
fn interpolated(values: &[(usize, f64)], frame: usize) -> f64 {
    let next = values.partition_point(|(f, _)| *f < frame);
    match (next.checked_sub(1).map(|i| values[i]), values.get(next)) {
        (Some((a, va)), Some(&(b, vb))) => va + (vb - va) * (frame - a) as f64 / (b - a) as f64,
        (Some((_, only)), None) | (None, Some(&(_, only))) => only,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::super::plane_segments::PlanePatch;
    use super::super::planes_about_axis::plane_observations;
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::Point3;

    const FRAMES: usize = 24;

    /// A line, upright at the origin.
    fn line() -> JointGeometry {
        JointGeometry::hinge(Vector3::y_axis(), Point3::origin())
    }

    /// A door of this width, turned about the line, as one keyframe shows it.
    fn door(frame: usize, turn: f64, width: f64) -> PlanePatch {
        let motion = line().motion(turn);
        let places = (0..100).map(|i| {
            let (out, up) = (f64::from(i % 10) / 9.0, f64::from(i / 10) / 9.0);
            motion * Point3::new(0.02 + out * (width - 0.02), 0.8 * up - 0.4, 0.0)
        });
        PlanePatch::through(places.collect(), frame, &(motion * -Vector3::z()))
    }

    fn opening(frame: usize) -> f64 {
        0.05 * frame as f64
    }

    fn observed(frames: impl Iterator<Item = usize>) -> Vec<PlaneObservation> {
        let patches: Vec<PlanePatch> = frames.map(|f| door(f, opening(f), 0.6)).collect();
        plane_observations(&line(), &patches)
    }

    /// Configuration from tracks in each frame.
    fn known(by: impl Fn(usize) -> Option<f64>) -> Vec<Option<f64>> {
        (0..FRAMES).map(by).collect()
    }

    fn unlinked(_: usize, _: usize) -> usize {
        0
    }

    #[test]
    fn the_plane_that_turns_as_tracks_say_is_the_parts() {
        let turning = (0..FRAMES).map(|f| door(f, opening(f), 0.6));
        let resting = (0..FRAMES).map(|f| door(f, 0.4, 1.1));
        let mut patches: Vec<PlanePatch> = turning.chain(resting).collect();
        patches.sort_by_key(|p| p.frame);
        let all = plane_observations(&line(), &patches);
        assert_eq!(all.len(), 2 * FRAMES);
        let tracks = known(|f| Some(opening(f)));
        let plane = PartPlane::of(&all, &tracks, unlinked).unwrap();
        assert_eq!(plane.plane_observations.len(), FRAMES, "one a keyframe");
        for (frame, normal) in plane.normals().iter().enumerate() {
            let expected = line().motion(opening(frame)) * -Vector3::z();
            assert!((normal - expected).norm() < 1e-6);
        }
    }

    #[test]
    fn there_is_none_where_tracks_and_planes_hardly_meet() {
        let all = observed(0..FRAMES);
        let at = |shown: usize| {
            PartPlane::of(&all, &known(|f| (f < shown).then(|| opening(f))), unlinked)
        };
        assert!(at(0).is_none() && at(1).is_none());
        assert!(at(2).is_some());
        assert!(PartPlane::of(&[], &known(|f| Some(opening(f))), unlinked).is_none());
    }

    #[test]
    fn tracks_that_slipped_are_mended_by_the_plane() {
        let all = observed(0..FRAMES);
        let slipped = known(|f| Some(opening(f) + if f < 12 { 0.0 } else { 0.08 }));
        let plane = PartPlane::of(&all, &slipped, unlinked).unwrap();
        let (zero, mended) = plane.mended(&slipped);
        for (frame, q) in mended.iter().enumerate() {
            assert!((q.unwrap() - opening(frame)).abs() < 1e-6, "{frame}: {q:?}");
            let turn = plane.plane_observations[frame].turn;
            assert!(wrapped(turn - zero - opening(frame)).abs() < 1e-6);
        }
    }

    #[test]
    fn tracks_that_did_not_slip_stay_as_they_are() {
        let tracks = known(|f| Some(opening(f)));
        let all = observed(0..FRAMES);
        assert_eq!(PartPlane::of(&all, &tracks, unlinked).unwrap().mended(&tracks).1, tracks);
        // Slips are not corrected from few planes.
        let slipped = known(|f| Some(opening(f) + if f < 3 { 0.0 } else { 0.08 }));
        let few = observed(0..MIN_SHOWN - 1);
        assert_eq!(PartPlane::of(&few, &slipped, unlinked).unwrap().mended(&slipped).1, slipped);
    }

    #[test]
    fn where_tracks_are_lost_the_plane_tells_the_configuration() {
        let all = observed(0..FRAMES);
        let tracks = known(|f| (!(8..14).contains(&f)).then(|| opening(f)));
        let plane = PartPlane::of(&all, &tracks, unlinked).unwrap();
        let keyframes: Vec<usize> = (0..FRAMES).filter(|f| f % 2 == 0).collect();
        let found = plane.alone(&[], &tracks, plane.zero, &keyframes);
        assert_eq!(found.iter().map(|(f, _)| *f).collect::<Vec<_>>(), [8, 10, 12]);
        assert!(found.iter().all(|(f, q)| (q - opening(*f)).abs() < 1e-6), "{found:?}");
        assert!(plane.alone(&[], &tracks, plane.zero, &[]).is_empty());
    }

    #[test]
    fn a_plane_that_leaps_is_not_believed() {
        // The plane leaps by 1.2 rad in the keyframe after the tracks are lost.
        let turn = |f: usize| if f < 10 { 0.0 } else { 1.2 };
        let patches: Vec<PlanePatch> = (0..12).map(|f| door(f, turn(f), 0.6)).collect();
        let all = plane_observations(&line(), &patches);
        let tracks = known(|f| (f < 10).then_some(0.0));
        let plane = PartPlane::of(&all, &tracks, unlinked).unwrap();
        let found = plane.alone(&[], &tracks, plane.zero, &[10, 11]);
        // By the second keyframe there was time for this turn.
        assert_eq!(found.iter().map(|(f, _)| *f).collect::<Vec<_>>(), [11]);
    }

    #[test]
    fn a_value_between_frames_is_interpolated_and_beyond_them_it_is_the_last() {
        let values = [(10, 1.0), (20, 3.0)];
        let at = |frame| interpolated(&values, frame);
        assert_eq!([at(0), at(10), at(15), at(20), at(99)], [1.0, 1.0, 2.0, 3.0, 3.0]);
        assert_eq!(interpolated(&[], 5), 0.0);
    }
}
