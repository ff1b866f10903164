//! Follows a vacated surface as the part of a joint through all keyframes, and decides whether it is accepted.
//!
//! In: a surface at rest, a joint hypothesis, and the moving readings of each keyframe; base frame, metres.
//! Out: the part with its line and one configuration per keyframe (radians or metres), and the reason against it, if
//! any.
//! From: dynamic programming (Viterbi) for the configurations; the limits were measured, see each constant.

use super::alignment::{Aligned, LinePrior, align};
use super::connected_body::Body;
use super::hypotheses::{Hypothesis, configurations, reach};
use super::moving_points::{Evidence, MovingPoints};
use super::point_grid::PointGrid;
use super::rest_surface::RestSurface;
use super::slide_or_hinge::{SHORT, SHORT_KEEPING_DIRECTION, is_as_good, is_unlike_a_hinge};
use super::tilt::tilt;
use crate::learn::attachment::{MAX_UNATTACHED, unattached_ratio};
use crate::learn::best_path::best_path;
use crate::learn::edge_on::long_edge_on;
use crate::learn::followed_surface::FollowedSurface;
use crate::learn::learned_joint::{LearnedJoint, span_of};
use crate::learn::line_step::{line_covariance, with_shared_errors};
use crate::learn::recording::Recording;
use crate::math::rigid::{Pose, distance_to_line, line_angle};
use crate::math::robust::median;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::{Matrix6, Point3, Vector3};
use std::collections::BTreeMap;

/// Distance that the surface moves between two configurations that are tried, metres.
const STEP_M: f64 = 0.015;
/// Most points of the surface in the first alignment.
const FEW_POINTS: usize = 40;
/// Cost of a metre of travel between two keyframes, as a share of the agreement of all points.
const COST_PER_METRE: f64 = 2.0;
/// Largest speed at which people open hinges, radians a second.
const MAX_SPEED_RAD_S: f64 = 4.0;
/// Largest speed at which people open slides, metres a second.
const MAX_SPEED_M_S: f64 = 1.5;
/// Smallest share of the points found, less those seen through, in a keyframe that shows the part.
const LEAST_SHOWN: f64 = 0.15;
/// Smallest share of the keyframes that must show the part.
const LEAST_KEYFRAMES: f64 = 0.7;
/// Share of the keyframes at either end of the recording; at least half of these must show the part.
const END: f64 = 0.1;
/// Largest share of the part's visible points that may be seen through.
const MAX_VIOLATION: f64 = 0.1;
/// Largest median distance of the part's points from the readings next to them, metres. It does not grow with the
/// distance from the camera: of a gate 2.3 m away it was 6.6 mm, but of a person there 7.0.
const MAX_MEDIAN_M: f64 = 0.006;
/// Largest ratio of a rigid part's distance from the readings away from its rest to that at rest. At 2.3 m from the
/// camera, doors and drawers had 0.75 to 1.08; persons 1.25 to 1.75.
const SAME_AT_REST: f64 = 1.12;
/// Largest median distance of a part that is as far from the readings at rest, or whose motion excludes a person,
/// metres.
const MAX_NOISY_MEDIAN_M: f64 = 0.008;
/// Smallest ratio of points seen at rest to points seen away, for their distances to be compared.
const TELLING_REST: f64 = 0.1;
/// Distance from which a reading does not support a point, metres.
const OWN_M: f64 = 0.0125;
/// Smallest agreement in the keyframes in which the part is away from its rest.
const MIN_AGREEMENT: f64 = 0.25;
/// Smallest turn of a hinge, radians.
const MIN_TURN_RAD: f64 = 0.35;
/// Smallest motion of the part's farthest point, metres.
const MIN_TRAVEL_M: f64 = 0.04;
/// Largest median angle between a surface, where its joint puts it, and its readings, radians. Fronts of drawers had up
/// to 0.037, slides that were wrong and that all other tests accepted 0.12 and more.
const MAX_TILT_RAD: f64 = 0.035;
/// Largest angle between slides that are parallel, radians: the alignment of a drawer's front is 2 degrees off.
pub const PARALLEL_RAD: f64 = 0.08;
/// Motion below which a surface is still at rest, metres.
const REST_M: f64 = 0.015;
/// Number of keyframes whose median configuration is the rest position.
const REST_KEYFRAMES: usize = 3;
/// Fewest readings of something that has come; a hand has more.
const MIN_ARRIVED: usize = 30;
/// Smallest time for which a hand moves before it moves the part, seconds. Of 24 parts it was 0.53 and more, of arms
/// and of what hangs on them up to 0.40.
const MIN_LEAD_S: f64 = 0.45;
/// Readings farther than this from the part belong to something else, metres.
const APART_M: f64 = 0.05;
/// Readings farther than this from a large part belong to something else, in radii of the part.
const APART_RADII: f64 = 0.5;
/// Without a person, nothing else moves near the part in at least this share of keyframes.
const LEAST_ALONE: f64 = 0.9;
/// Turn of a hinge, radians, above which keyframes must show the part between both ends.
const FAR_RAD: f64 = 0.8;
/// Share of a hinge's range at each of its ends that counts as that end.
const AT_ENDS: f64 = 0.1;
/// Fewest keyframes between both ends of a hinge that turns by more than [`FAR_RAD`].
const LEAST_BETWEEN: usize = 2;
/// Share of the keyframes that show the other face of a part, above which that face is searched for.
const LEAST_TURNED_AWAY: f64 = 0.1;
/// A hinge whose agreement is at least this share of the best one's explains the surface about as well.
const AS_WELL: f64 = 0.85;
/// Two hinges whose directions differ by more than this cannot both be right, radians.
const OTHER_DIRECTION_RAD: f64 = 0.26;
/// Distance from the surface at rest up to which a place may be its own, metres.
const OWN_PLACE_M: f64 = 0.06;
/// Largest share of the places of a slide away from its rest that showed a surface while it rested. A lid that seemed
/// to slide onto the next one had 0.99 and more.
const MAX_THERE_BEFORE: f64 = 0.5;
/// Fewest places that are compared, as a share of the surface's points.
const LEAST_COMPARED: f64 = 0.25;
/// Two hinges that are farther apart, in radii of the surface, cannot both be right. Of a letter box's lid, which
/// turned as well about either side, they were 1.75 radii apart; of seven surfaces whose best hinge was right, others
/// that were as good were up to 0.4 radii away.
const OTHER_PLACE_RADII: f64 = 1.0;
/// Error of a line's direction that all readings share, radians.
const SYSTEMATIC_RAD: f64 = 0.011;
/// Error of a line's place that all readings share, metres.
const SYSTEMATIC_M: f64 = 0.011;

/// A surface that was followed along a joint, with all that decides whether it is a part.
#[derive(Clone)]
pub struct VacatedPart {
    /// The aligned joint; configuration 0 is the rest.
    aligned: Aligned,
    /// What each keyframe shows of the surface.
    seen: Vec<Seen>,
    /// Distances of points from the readings next to them.
    distances: Distances,
    /// Distance of the farthest point from the line, metres; 1 for a slide.
    reach: f64,
    /// Largest distance of a point from the middle of the surface, metres.
    radius: f64,
    /// True if the line is that of a known joint.
    pub is_on_known_line: bool,
    /// True if the joint is a slide along the normal of its flat front or parallel to a known slide.
    pub is_along_known_direction: bool,
    /// Share of the line that is attached to no visible surface; 0 for a slide.
    unattached_ratio: f64,
    /// How long something else moved near the surface while it still was at rest, seconds.
    lead_s: f64,
    /// True if nothing else moves near the surface; tested only if nothing moved long enough before it.
    is_alone: bool,
    /// Share of the places away from the rest, where the part is found, that showed a surface while it rested; 0 for a
    /// hinge.
    there_before: f64,
    /// Median angle between the surface and the readings in the keyframes in which it is away from its rest, radians;
    /// `None` if none of these shows enough of it.
    tilt: Option<f64>,
    /// What the surface is connected with at rest.
    body: Body,
    /// Share of the keyframes in which the other face is turned to the camera.
    turned_away: f64,
    /// Other motions that the same surface may have.
    rivals: Rivals,
    /// True if the joint is a slide parallel to a known slide.
    is_parallel: bool,
}

/// How well the keyframes agree with other motions that a surface may have.
#[derive(Debug, Clone, Default)]
pub struct Rivals {
    /// Agreement with the best hinge that is attached and turns; 0 without any.
    hinge: f64,
    /// Agreement with each slide: in all keyframes, and in those in which the surface is away from its rest.
    slides: Vec<[f64; 2]>,
}

impl Rivals {
    /// The rivals among all motions that were followed.
    pub fn of<'p>(parts: impl Iterator<Item = &'p VacatedPart> + Clone) -> Self {
        let held = parts.clone().filter(|part| part.is_held_hinge());
        let slides = parts.filter(|part| !part.is_hinge() && part.turn() > MIN_TRAVEL_M);
        Self {
            hinge: held.map(VacatedPart::agreement).fold(0.0, f64::max),
            slides: slides.map(|part| [part.agreement(), part.agreement_elsewhere()]).collect(),
        }
    }
}

/// What one keyframe shows of the surface.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    frame: usize,
    /// Points that are found, less those that are seen through, as a share of all.
    margin: f64,
    /// Points next to a moving reading, weighted by their distance from it, less those that are seen through, as a
    /// share of all.
    agreement: f64,
    found: usize,
    through: usize,
    /// True if the part shows its edge, as what is seen through tells: the keyframe counts neither for nor against it.
    edge_on: bool,
}

impl Seen {
    /// True if the keyframe shows enough of the surface.
    fn is_shown(&self) -> bool {
        self.margin >= LEAST_SHOWN && !self.edge_on
    }
}

/// Median distances of points from the readings next to them, metres; infinite where there are none.
#[derive(Debug, Clone, Copy)]
struct Distances {
    /// Median over all keyframes but the one that the surface was taken from.
    all: f64,
    /// Median over those of them in which the part is at rest.
    at_rest: f64,
    /// Median over the keyframes in which the part is away from its rest.
    away: f64,
    /// True if enough points were seen at rest to compare both.
    is_rest_told: bool,
}

impl Distances {
    fn of(mut at_rest: Vec<f64>, mut away: Vec<f64>) -> Self {
        let is_rest_told = at_rest.len() as f64 >= TELLING_REST * away.len() as f64;
        let mut all: Vec<f64> = at_rest.iter().chain(&away).copied().collect();
        let median_of = |all: &mut Vec<f64>| median(all).unwrap_or(f64::INFINITY);
        let [all, at_rest, away] = [&mut all, &mut at_rest, &mut away].map(median_of);
        Self { all, at_rest, away, is_rest_told }
    }

    /// True if the surface that is seen away is the one that rested. The distances may be larger if they are so at
    /// rest too, or if the motion excludes a person (`is_no_person`).
    fn are_of_one_shape(&self, is_no_person: bool) -> bool {
        let is_as_at_rest = self.is_rest_told && self.away <= SAME_AT_REST * self.at_rest;
        let may_be_noisy = is_as_at_rest || is_no_person;
        // The overall median of a part that rests for long is small, however far it is from its readings when away.
        let median = if self.is_rest_told { self.all.max(self.away) } else { self.all };
        median <= if may_be_noisy { MAX_NOISY_MEDIAN_M } else { MAX_MEDIAN_M }
    }
}

/// True if two hinges differ so much in direction that at most one can be right.
fn are_two_directions(a: &JointGeometry, b: &JointGeometry) -> bool {
    line_angle(&a.axis, &b.axis) > OTHER_DIRECTION_RAD
}

impl VacatedPart {
    /// Follows a surface along a hypothesis and aligns the line, first with some of the surface's points, then with
    /// all.
    pub fn follow(
        surface: &RestSurface,
        hypothesis: &Hypothesis,
        direction_sigma: f64,
        moving: &[MovingPoints],
        recording: &Recording,
    ) -> Self {
        let Hypothesis { geometry, is_known, .. } = *hypothesis;
        let expected = LinePrior {
            direction: geometry.axis.into_inner(),
            direction_sigma,
            place: is_known.then_some(geometry.origin),
        };
        let few = surface.thinned(FEW_POINTS);
        let q = path(&few, &geometry, moving, recording);
        let geometry = align(&few, &geometry, &q, &expected, moving).geometry;
        let q = path(surface, &geometry, moving, recording);
        let aligned = align(surface, &geometry, &q, &expected, moving);
        let (seen, distances) = what_is_seen(surface, &aligned, moving, &[]);
        let camera_from_base = |frame: usize| recording.ego_motion.camera_from_base[frame];
        let line = &aligned.geometry;
        let unattached_ratio = match line.kind {
            JointKind::Revolute => {
                unattached_ratio(line, &surface.points, recording, camera_from_base)
            }
            _ => 0.0,
        };
        let reach = reach(line, &surface.points);
        let lead_s = lead_of_others(surface, &aligned.q, reach, moving);
        let is_alone = lead_s < MIN_LEAD_S && is_alone(surface, &aligned, moving);
        let there_before = match line.kind {
            JointKind::Prismatic => share_there_before(surface, &aligned, moving),
            _ => 0.0,
        };
        let turned_away = share_turned_away(surface, &aligned, moving);
        let radius = surface.radius();
        let mut part = Self {
            aligned,
            seen,
            distances,
            reach,
            radius,
            is_on_known_line: is_known,
            is_along_known_direction: false,
            unattached_ratio,
            lead_s,
            is_alone,
            there_before,
            tilt: None,
            body: Body::Nothing,
            turned_away,
            rivals: Rivals::default(),
            is_parallel: false,
        };
        part.find_edge_on(surface, moving, recording);
        part.tilt = part.tilt_away(surface, moving);
        part
    }

    /// Finds a hinged part in keyframes that see it from its edge, if few keyframes show it: a door that is left wide
    /// open shows no face until the end.
    fn find_edge_on(
        &mut self,
        surface: &RestSurface,
        moving: &[MovingPoints],
        recording: &Recording,
    ) {
        if !self.is_hinge() || self.is_shown_in_most() && self.is_there_throughout() {
            return;
        }
        let shown: BTreeMap<usize, f64> = self.shown().collect();
        let known: Vec<Option<f64>> =
            recording.keyframes.iter().map(|(frame, _)| shown.get(&frame).copied()).collect();
        let edge_on = long_edge_on(self.geometry(), &surface.points, &known, recording);
        if edge_on.is_empty() {
            return;
        }
        for (frame, q) in &edge_on {
            if let Some(k) = moving.iter().position(|view| view.frame() == *frame) {
                self.aligned.q[k] = *q;
            }
        }
        (self.seen, self.distances) = what_is_seen(surface, &self.aligned, moving, &edge_on);
    }

    /// Median angle between the surface, where the joint puts it, and the readings there, radians: in the keyframes in
    /// which it is away from its rest and shows its face.
    fn tilt_away(&self, surface: &RestSurface, moving: &[MovingPoints]) -> Option<f64> {
        let line = self.geometry();
        let all = moving.iter().zip(&self.seen).zip(&self.aligned.q);
        let away = all.filter(|((_, s), q)| !s.edge_on && q.abs() * self.reach > MIN_TRAVEL_M);
        let tilts = away.filter_map(|((view, _), q)| tilt(surface, &line.motion(*q), view));
        median(&mut tilts.collect::<Vec<_>>())
    }

    /// True if the part is left so that it shows its edge. A person who has gone is nowhere, and is seen through. (Two
    /// doors that were left wide open were 6.7 and 7.2 mm from their readings while they moved.)
    fn is_long_edge_on(&self) -> bool {
        self.seen.iter().any(|s| s.edge_on)
    }

    /// True if most of the keyframes show the part, among those that do not see it from its edge.
    fn is_shown_in_most(&self) -> bool {
        let may_show = self.seen.iter().filter(|s| !s.edge_on).count();
        self.shown().count() as f64 >= LEAST_KEYFRAMES * may_show as f64
    }

    /// The part, as a slide along the normal of its flat front or parallel to a known slide.
    pub fn along_known_direction(self) -> Self {
        Self { is_along_known_direction: true, ..self }
    }

    /// The part, with what its surface is connected with at rest.
    pub fn on(self, body: Body) -> Self {
        Self { body, ..self }
    }

    /// The part, compared with the other motions of the same surface and with the directions of known slides.
    pub fn beside(self, rivals: &Rivals, slides: &[Vector3<f64>]) -> Self {
        let axis = self.geometry().axis;
        let is_parallel =
            !self.is_hinge() && slides.iter().any(|slide| line_angle(slide, &axis) < PARALLEL_RAD);
        Self { rivals: rivals.clone(), is_parallel, ..self }
    }

    /// The joint's line.
    pub fn geometry(&self) -> &JointGeometry {
        &self.aligned.geometry
    }

    /// Mean agreement of all keyframes with the part.
    pub fn agreement(&self) -> f64 {
        self.seen.iter().map(|s| s.agreement).sum::<f64>() / self.seen.len().max(1) as f64
    }

    /// Reason against the part; `None` if it is accepted.
    pub fn doubt(&self) -> Option<&'static str> {
        let turn = self.turn();
        let (found, through) =
            self.seen.iter().fold((0, 0), |(f, t), s| (f + s.found, t + s.through));
        let reasons = [
            (self.hardly_turns(), "it hardly turns"),
            (turn * self.reach < MIN_TRAVEL_M, "it hardly moves"),
            (!self.is_shown_in_most(), "few pictures show it"),
            (self.may_as_well_turn(), "it may as well turn"),
            (self.may_as_well_slide(), "it may as well slide"),
            (!self.is_there_throughout(), "it comes and leaves"),
            (through as f64 > MAX_VIOLATION * (found + through) as f64, "it is seen through"),
            (!self.distances.are_of_one_shape(self.is_no_person()), "it does not keep its shape"),
            (self.agreement_elsewhere() < MIN_AGREEMENT, "it is not found elsewhere"),
            (self.is_another_surface(), "what is found elsewhere was there before"),
            (self.unattached_ratio > MAX_UNATTACHED, "nothing holds its line"),
            (self.may_be_limb(), "it moves by itself"),
            (self.shows_only_its_ends(), "it turns far, and no picture shows it in between"),
        ];
        reasons.into_iter().find(|(holds, _)| *holds).map(|(_, reason)| reason)
    }

    /// Both are hinges that nothing speaks against and that explain about as much, in directions or at places of which
    /// at most one can be right. What a known line confirms is not contradicted, and the line of another part
    /// contradicts only by its direction.
    pub fn contradicts(&self, best: &VacatedPart) -> bool {
        let may_be = self.is_hinge() && self.doubt().is_none();
        let (line, origin) = (self.geometry(), best.geometry().origin);
        let apart = distance_to_line(&line.origin, &line.axis, &origin);
        may_be
            && best.is_hinge()
            && !best.is_on_known_line
            && self.agreement() >= AS_WELL * best.agreement()
            && (are_two_directions(self.geometry(), best.geometry())
                || !self.is_on_known_line && apart > OTHER_PLACE_RADII * best.radius)
    }

    /// True if the joint is a slide, and what is found away from its rest was there while it rested: a lid next to it,
    /// which is opened later. (Of hinges this is not asked. A leaf that turns flat onto a wall, or a spoke that takes
    /// the place of the next one, also comes to places that showed a surface.)
    fn is_another_surface(&self) -> bool {
        self.there_before > MAX_THERE_BEFORE
    }

    /// True if something else moves near the surface, did not move long before it, and the surface does not hang on
    /// what stands still: an upper arm moves together with the hand.
    fn may_be_limb(&self) -> bool {
        self.lead_s < MIN_LEAD_S && !self.is_alone && self.body != Body::StandsStill
    }

    /// True if the joint is a hinge that turns far, no other evidence gives its line, and hardly any keyframe shows the
    /// part between both ends: some turn takes any flat surface to any other one. The top of a lid that was thrown open
    /// seemed to turn to where its inside was seen, about a line 15 cm off.
    fn shows_only_its_ends(&self) -> bool {
        let told: Vec<f64> = self.shown().map(|(_, q)| q).collect();
        let (low, high) = told.iter().fold((0.0_f64, 0.0_f64), |(l, h), q| (l.min(*q), h.max(*q)));
        let margin = AT_ENDS * (high - low);
        let between = told.iter().filter(|q| (low + margin..=high - margin).contains(*q)).count();
        self.is_hinge() && !self.is_on_known_line && high - low > FAR_RAD && between < LEAST_BETWEEN
    }

    /// True if the joint is a hinge about which the part shows its other face for a while.
    pub fn shows_other_face(&self) -> bool {
        self.is_hinge() && self.turned_away > LEAST_TURNED_AWAY
    }

    /// True if the joint is a hinge about which the part hardly turns.
    pub fn hardly_turns(&self) -> bool {
        self.is_hinge() && self.turn() < MIN_TURN_RAD
    }

    /// True if the joint is a hinge about which the part turns, and the line is attached to something.
    pub fn is_held_hinge(&self) -> bool {
        self.is_hinge() && self.unattached_ratio <= MAX_UNATTACHED && !self.hardly_turns()
    }

    /// True if the joint is a hinge and a slide agrees nearly as well: a sliding door, whose depth does not change,
    /// may turn in its plane, and so may a sleeve.
    pub fn may_as_well_slide(&self) -> bool {
        let hinge = [self.agreement(), self.agreement_elsewhere()];
        self.is_hinge() && self.rivals.slides.iter().any(|slide| is_as_good(hinge, *slide))
    }

    /// True if the joint is a slide, and attached hinges agree much worse.
    pub fn is_clearly_a_slide(&self) -> bool {
        !self.is_hinge() && is_unlike_a_hinge(self.agreement(), self.rivals.hinge)
    }

    /// True if the joint is a slide whose motion is too short to distinguish it from a turn about the best hinge. No
    /// hinge speaks against a slide parallel to a known one: the drawers of a cabinet slide in parallel.
    fn may_as_well_turn(&self) -> bool {
        let way_in_radii = self.turn() / self.radius;
        let of_hinges = if self.is_parallel { 0.0 } else { self.rivals.hinge };
        let limits = if self.keeps_direction() { &SHORT_KEEPING_DIRECTION } else { &SHORT };
        !self.is_hinge() && limits.is_too_short(way_in_radii, self.agreement(), of_hinges)
    }

    /// True if the joint is a slide, and the readings away from the rest are not turned against the surface.
    pub fn keeps_direction(&self) -> bool {
        !self.is_hinge() && self.tilt.is_some_and(|tilt| tilt < MAX_TILT_RAD)
    }

    /// True if the motion excludes a person, whatever the distance of the surface from its readings.
    fn is_no_person(&self) -> bool {
        self.is_clearly_a_slide() || self.is_long_edge_on()
    }

    /// True if the joint is a hinge.
    fn is_hinge(&self) -> bool {
        self.geometry().kind == JointKind::Revolute
    }

    /// Range of the configurations in keyframes that show the part, its edge included, radians or metres.
    fn turn(&self) -> f64 {
        let all = self.seen.iter().zip(&self.aligned.q);
        let told = all.filter(|(s, _)| s.is_shown() || s.edge_on);
        span_of(&told.map(|(_, q)| *q).collect::<Vec<_>>())
    }

    /// Mean agreement of the keyframes in which the part is far from its rest. (Those that show the other face, as of
    /// a lid that stands open, count too: without them one more lid of 80 was learned, with half of its range, and
    /// the ranges of two others became 0.3 and 0.4 rad wrong.)
    fn agreement_elsewhere(&self) -> f64 {
        let away = |q: f64| q.abs() * self.reach > MIN_TRAVEL_M;
        let all = self.seen.iter().zip(&self.aligned.q);
        let seen = all.filter(|(s, q)| !s.edge_on && away(**q));
        let (sum, n) = seen.fold((0.0, 0), |(sum, n), (s, _)| (sum + s.agreement, n + 1));
        sum / f64::from(n.max(1))
    }

    /// True if at least half of the keyframes at each end of the recording show the part, among those that do not see
    /// it from its edge: parts stay, hands come and leave.
    fn is_there_throughout(&self) -> bool {
        let n = ((END * self.seen.len() as f64).ceil() as usize).clamp(1, self.seen.len());
        let (first, last) = (&self.seen[..n], &self.seen[self.seen.len() - n..]);
        let shown = |end: &[Seen]| end.iter().filter(|s| s.is_shown()).count();
        let may_show = |end: &[Seen]| end.iter().filter(|s| !s.edge_on).count();
        [first, last].iter().all(|end| 2 * shown(end) >= may_show(end))
    }

    /// Frames that show the part, with the configuration.
    pub fn shown(&self) -> impl Iterator<Item = (usize, f64)> {
        let all = self.seen.iter().zip(&self.aligned.q);
        all.filter(|(s, _)| s.is_shown()).map(|(s, q)| (s.frame, *q))
    }

    /// Logs what was found, and why it is accepted or not.
    pub fn trace(&self) {
        tracing::debug!(
            kind = self.geometry().kind.name(),
            agreement = self.agreement(),
            elsewhere = self.agreement_elsewhere(),
            median = self.distances.all,
            rest = self.distances.at_rest,
            away = self.distances.away,
            shown = self.shown().count(),
            keyframes = self.seen.len(),
            edge_on = self.seen.iter().filter(|s| s.edge_on).count(),
            unattached = self.unattached_ratio,
            lead = self.lead_s,
            alone = self.is_alone,
            turned_away = self.turned_away,
            there_before = self.there_before,
            turn = self.turn(),
            reach = self.reach,
            tilt = self.tilt,
            axis = ?self.geometry().axis.as_slice(),
            origin = ?self.geometry().origin.coords.as_slice(),
            rejected = self.doubt().unwrap_or("no"),
            "vacated surface"
        );
    }

    /// The part as a joint of the base.
    pub fn to_learned(&self, surface: &RestSurface, recording: &Recording) -> LearnedJoint {
        let surface = FollowedSurface {
            geometry: *self.geometry(),
            covariance: self.covariance(),
            points: &surface.points,
            configuration: self.shown().collect(),
            rmse: self.distances.all,
        };
        surface.into_learned(recording)
    }

    /// Covariance of (axis, origin), including the errors that all readings share.
    fn covariance(&self) -> Matrix6<f64> {
        let covariance = line_covariance(self.geometry(), &self.aligned.information);
        with_shared_errors(covariance, self.geometry(), SYSTEMATIC_RAD, SYSTEMATIC_M)
    }
}

/// The configuration in each keyframe that all keyframes together agree with best (Viterbi); about 0 where the
/// surface rests.
fn path(
    surface: &RestSurface,
    geometry: &JointGeometry,
    moving: &[MovingPoints],
    recording: &Recording,
) -> Vec<f64> {
    let (configurations, step) = configurations(geometry, &surface.points, STEP_M);
    let motions: Vec<Pose> = configurations.iter().map(|q| geometry.motion(*q)).collect();
    let row = |(k, view): (usize, &MovingPoints)| -> Vec<f64> {
        let at = |(q, motion): (&f64, &Pose)| {
            let must_rest = k == surface.keyframe && q.abs() > step;
            if must_rest { -1e6 } else { surface.margin(view, motion) }
        };
        configurations.iter().zip(&motions).map(at).collect()
    };
    let table: Vec<Vec<f64>> = moving.iter().enumerate().map(row).collect();
    let cost = COST_PER_METRE * step * reach(geometry, &surface.points);
    // Without a bound on the speed, a wheel with equal spokes would jump from one to the next.
    let is_hinge = geometry.kind == JointKind::Revolute;
    let speed = if is_hinge { MAX_SPEED_RAD_S } else { MAX_SPEED_M_S };
    let largest = recording.keyframes.largest_steps(speed);
    let largest: Vec<usize> = largest.iter().map(|max| (max / step).ceil() as usize).collect();
    best_path(&table, cost, &largest).into_iter().map(|i| configurations[i]).collect()
}

/// True if the surface has moved less than `REST_M` from its rest. The rest position is the median of
/// `REST_KEYFRAMES` keyframes, because one is too noisy.
fn is_at_rest(q: &[f64], keyframe: usize, k: usize, reach: f64) -> bool {
    let first = keyframe.min(q.len().saturating_sub(REST_KEYFRAMES));
    let beside = &q[first..(first + REST_KEYFRAMES).min(q.len())];
    let rest = median(&mut beside.to_vec()).unwrap_or_default();
    (q[k] - rest).abs() * reach < REST_M
}

/// Time for which something else moved near the surface while that still was at rest, seconds: after the keyframe
/// that shows it at rest, or before it if the surface rests last. A hand takes its time to come to a part; a limb
/// moves when the hand does.
fn lead_of_others(surface: &RestSurface, q: &[f64], reach: f64, moving: &[MovingPoints]) -> f64 {
    let rest = &moving[surface.keyframe];
    let at_rest = |k: &usize| is_at_rest(q, surface.keyframe, *k, reach);
    let others_move = |k: &usize| moving[*k].has_arrived_since(rest, MIN_ARRIVED);
    let before: Vec<usize> = (0..surface.keyframe).rev().take_while(at_rest).collect();
    let after: Vec<usize> = (surface.keyframe..q.len()).take_while(at_rest).collect();
    let lead = |run: Vec<usize>| {
        let first = run.iter().copied().find(others_move);
        let both = first.zip(run.last().copied());
        both.map_or(0.0, |(a, b)| moving[a].utime().abs_diff(moving[b].utime()) as f64 * 1e-6)
    };
    lead(before).max(lead(after))
}

/// True if nothing else moves near the surface in nearly all keyframes.
fn is_alone(surface: &RestSurface, aligned: &Aligned, moving: &[MovingPoints]) -> bool {
    let apart = APART_M.max(APART_RADII * surface.radius());
    let others = moving.iter().zip(&aligned.q).filter(|(view, q)| {
        let motion = aligned.geometry.motion(**q);
        let places: Vec<Point3<f64>> = surface.points.iter().map(|p| motion * p).collect();
        view.has_apart_from(&places, apart, MIN_ARRIVED)
    });
    let most = ((1.0 - LEAST_ALONE) * moving.len() as f64) as usize;
    others.take(most + 1).count() <= most
}

/// Share of the places away from the rest, where the surface is found, that showed a surface in the keyframe in which
/// it rests; 0 if few can be compared. The surface's own places at rest are not counted, nor are places that were not
/// seen then, or at which a surface was near: a sliding door runs closely before another one.
fn share_there_before(surface: &RestSurface, aligned: &Aligned, moving: &[MovingPoints]) -> f64 {
    let own = PointGrid::new(&surface.points, OWN_PLACE_M);
    let rest = &moving[surface.keyframe];
    let reach = reach(&aligned.geometry, &surface.points);
    let (mut there, mut free) = (0_u32, 0_u32);
    for (k, (view, q)) in moving.iter().zip(&aligned.q).enumerate() {
        if is_at_rest(&aligned.q, surface.keyframe, k, reach) {
            continue;
        }
        let motion = aligned.geometry.motion(*q);
        let camera_from_part = view.camera_from_part(&motion);
        for (place, normal) in surface.places() {
            let moved = motion * place;
            let is_found =
                || surface.evidence(view, &camera_from_part, &place, &normal) == Evidence::Found;
            if own.nearest(&moved).is_none() && is_found() {
                there += u32::from(rest.shows_within(OWN_M, &moved));
                free += u32::from(rest.shows_behind(&moved));
            }
        }
    }
    let compared = (there + free) as f64;
    let is_told = compared > 0.0 && compared >= LEAST_COMPARED * surface.points.len() as f64;
    if is_told { f64::from(there) / compared } else { 0.0 }
}

/// Share of the keyframes in which most of the surface has its other face turned to the camera.
fn share_turned_away(surface: &RestSurface, aligned: &Aligned, moving: &[MovingPoints]) -> f64 {
    let is_turned_away = |(view, q): &(&MovingPoints, &f64)| {
        let motion = aligned.geometry.motion(**q);
        let sides = surface.points.iter().zip(&surface.normals);
        let away = sides.filter(|(p, n)| view.faces(&(motion * *p), &-(motion * *n))).count();
        2 * away > surface.points.len()
    };
    let away = moving.iter().zip(&aligned.q).filter(is_turned_away).count();
    away as f64 / moving.len().max(1) as f64
}

/// What each keyframe shows of the surface where the joint puts it, and the distances of its points from the
/// readings next to them.
fn what_is_seen(
    surface: &RestSurface,
    aligned: &Aligned,
    moving: &[MovingPoints],
    edge_on: &[(usize, f64)],
) -> (Vec<Seen>, Distances) {
    let n = surface.points.len().max(1) as f64;
    let reach = reach(&aligned.geometry, &surface.points);
    let (mut at_rest, mut away) = (Vec::new(), Vec::new());
    let mut seen = Vec::with_capacity(moving.len());
    for (k, (view, q)) in moving.iter().zip(&aligned.q).enumerate() {
        let is_at_rest = is_at_rest(&aligned.q, surface.keyframe, k, reach);
        let distances = if is_at_rest { &mut at_rest } else { &mut away };
        let mut one = Seen { frame: view.frame(), ..Seen::default() };
        if edge_on.iter().any(|(frame, _)| *frame == one.frame) {
            seen.push(Seen { edge_on: true, ..one });
            continue;
        }
        let motion = aligned.geometry.motion(*q);
        let camera_from_part = view.camera_from_part(&motion);
        for (place, normal) in surface.places() {
            match surface.evidence(view, &camera_from_part, &place, &normal) {
                Evidence::Through => {
                    one.through += 1;
                    one.agreement -= 1.0 / n;
                }
                Evidence::Found => one.found += 1,
                Evidence::Unknown => {}
            }
            let (p, normal) = (motion * place, motion * normal);
            if let Some(reading) = view.nearest(&p, &normal) {
                let distance = (reading - p).norm();
                one.agreement += (1.0 - (distance / OWN_M).powi(2)).max(0.0).powi(2) / n;
                // The surface's own keyframe has its points as readings.
                if k != surface.keyframe {
                    distances.push(distance);
                }
            }
        }
        one.margin = (one.found as f64 - one.through as f64) / n;
        seen.push(one);
    }
    (seen, Distances::of(at_rest, away))
}

#[cfg(test)]
mod tests {
    use super::super::hypotheses::best_hypotheses;
    use super::super::rest_surface::{End, vacated_surfaces};
    use super::super::test_data::{
        FRAMES, PIVOT_M, hinge, lever, recording, slider, turn, two_sliders,
    };
    use super::super::view::View;
    use super::*;
    use crate::learn::plane_hinges::test_data::{HINGE_M, edge_on_rad, left_edge_on_recording};
    use nalgebra::{Matrix4, UnitVector3};
    use std::f64::consts::PI;

    /// Gives `look` the part of a lever's surface at rest, followed along a line.
    fn followed<T>(
        recording: &Recording,
        geometry: &JointGeometry,
        look: impl FnOnce(&VacatedPart, &RestSurface, &[MovingPoints]) -> T,
    ) -> T {
        let views = View::all(recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let moving = MovingPoints::near(&surface.centre(), 0.8, &views, &|_| Vec::new());
        let mut hypothesis =
            best_hypotheses(surface, &[*geometry.axis], &[], &[], &moving, [1, 0]).remove(0);
        hypothesis.geometry = *geometry;
        let part = VacatedPart::follow(surface, &hypothesis, 0.035, &moving, recording);
        look(&part, surface, &moving)
    }

    #[test]
    fn a_door_that_is_left_so_wide_open_that_it_shows_its_edge_has_neither_left_nor_is_missed() {
        let [x, z] = HINGE_M;
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(x, 0.0, z));
        followed(&left_edge_on_recording(40), &line, |part, _, _| {
            let edge_on = part.seen.iter().filter(|s| s.edge_on).count();
            assert!((20..=24).contains(&edge_on), "{edge_on}");
            assert!(
                part.is_long_edge_on() && part.is_shown_in_most() && part.is_there_throughout()
            );
            let last = part.aligned.q.last().unwrap().abs();
            assert!((last - edge_on_rad()).abs() < 0.1, "{last}");
        });
        followed(&lever(turn), &hinge(), |part, _, _| assert!(!part.is_long_edge_on()));
    }

    #[test]
    fn a_lever_is_followed_about_its_pivot_and_comes_to_every_configuration() {
        followed(&lever(turn), &hinge(), |part, _, _| {
            let line = part.geometry();
            assert!(line_angle(&line.axis, &Vector3::z()) < 0.03);
            assert!(distance_to_line(&line.origin, &line.axis, &Point3::from(PIVOT_M)) < 0.015);
            let sense = part.aligned.q[FRAMES - 1].signum();
            for (frame, q) in part.shown() {
                assert!((sense * q - turn(frame)).abs() < 0.06, "frame {frame}: {q}");
            }
            assert!(part.shown().count() as f64 > LEAST_KEYFRAMES * FRAMES as f64);
            assert!(part.is_there_throughout() && part.distances.all < MAX_MEDIAN_M);
        });
    }

    #[test]
    fn a_lever_becomes_a_hinge_whose_line_is_not_known_without_error() {
        let recording = lever(turn);
        followed(&recording, &hinge(), |part, surface, _| {
            let learned = part.to_learned(surface, &recording);
            assert_eq!(learned.joint.kind, JointKind::Revolute);
            let [low, high] = learned.joint.range;
            assert!((high - low - turn(FRAMES - 1)).abs() < 0.08, "{low} to {high}");
            let covariance = part.covariance();
            let across = covariance.fixed_view::<3, 3>(3, 3).into_owned().symmetric_eigenvalues();
            assert!(across.max().sqrt() >= SYSTEMATIC_M);
        });
    }

    #[test]
    fn about_a_line_far_from_the_pivot_it_is_no_part() {
        let mut off = hinge();
        off.origin.y += 0.25;
        followed(&lever(turn), &off, |part, _, _| assert!(part.doubt().is_some()));
    }

    #[test]
    fn what_slides_and_what_hardly_turns_is_refused_with_the_reason() {
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::from(PIVOT_M));
        followed(&lever(turn), &slide, |part, _, _| assert!(part.doubt().is_some()));
        followed(&lever(|f| 0.25 * turn(f)), &hinge(), |part, _, _| {
            assert_eq!(part.doubt(), Some("it hardly turns"));
        });
    }

    #[test]
    fn what_turns_far_must_be_seen_between_its_ends() {
        // The lever is thrown over between two keyframes.
        let thrown = |f: usize| if 2 * f < FRAMES { 0.0 } else { turn(FRAMES - 1) };
        assert!(turn(FRAMES - 1) > FAR_RAD);
        followed(&lever(thrown), &hinge(), |part, _, _| {
            assert!(part.shows_only_its_ends() && part.doubt().is_some());
            let on_known_line = VacatedPart { is_on_known_line: true, ..part.clone() };
            assert!(!on_known_line.shows_only_its_ends());
        });
        followed(&lever(turn), &hinge(), |part, _, _| assert!(!part.shows_only_its_ends()));
    }

    #[test]
    fn what_is_as_far_from_its_readings_at_rest_as_away_is_rigid_far_from_the_camera() {
        let seen = |at_rest: f64, away: f64| {
            Distances::of(vec![at_rest; 40], vec![away; 60]).are_of_one_shape(false)
        };
        assert!(seen(0.004, 0.0055), "near the camera");
        assert!(seen(0.0068, 0.0066), "a door 2.3 m away");
        assert!(!seen(0.0055, 0.0072), "a person there");
        assert!(!seen(0.009, 0.009));
        let long_at_rest = Distances::of(vec![0.004; 90], vec![0.0064; 10]);
        assert!(!long_at_rest.are_of_one_shape(false), "it rests most of the time");
        let hardly_at_rest = Distances::of(vec![0.0068; 2], vec![0.0066; 98]);
        assert!(!hardly_at_rest.are_of_one_shape(false));
        assert!(hardly_at_rest.are_of_one_shape(true), "a drawer there");
    }

    #[test]
    fn of_two_hinges_in_quite_different_directions_at_most_one_is_right() {
        let at = |angle: f64| {
            JointGeometry::hinge(
                UnitVector3::new_normalize(Vector3::new(angle.cos(), angle.sin(), 0.0)),
                Point3::origin(),
            )
        };
        assert!(are_two_directions(&at(1.1), &at(0.0)), "the wing of a sewing box");
        assert!(
            !are_two_directions(&at(0.1), &at(0.0)) && !are_two_directions(&at(PI - 0.1), &at(0.0))
        );
    }

    #[test]
    fn a_hinge_at_the_other_side_that_explains_as_much_contradicts() {
        followed(&lever(turn), &hinge(), |best, _, _| {
            let elsewhere = |away: f64, is_on_known_line| {
                let mut rival = best.clone();
                rival.aligned.geometry.origin.x += away;
                rival.is_on_known_line = is_on_known_line;
                rival
            };
            assert!(best.doubt().is_none());
            assert!(elsewhere(1.5 * best.radius, false).contradicts(best));
            assert!(!elsewhere(0.3 * best.radius, false).contradicts(best), "it is the same one");
            assert!(
                !elsewhere(1.5 * best.radius, true).contradicts(best),
                "the line of another part"
            );
            let mut worse = elsewhere(1.5 * best.radius, false);
            worse.seen.iter_mut().for_each(|seen| seen.agreement *= 0.7);
            assert!(!worse.contradicts(best), "it explains clearly less");
        });
    }

    #[test]
    fn a_lever_turns_and_does_not_slide_unless_a_slide_agrees_as_well() {
        followed(&lever(turn), &hinge(), |part, _, _| {
            let own = [part.agreement(), part.agreement_elsewhere()];
            let beside = |share: f64| {
                let slides = vec![own.map(|agreement| share * agreement)];
                part.clone().beside(&Rivals { hinge: 0.0, slides }, &[])
            };
            assert!(!beside(0.5).may_as_well_slide() && beside(1.0).may_as_well_slide());
        });
    }

    #[test]
    fn rest_is_what_the_first_keyframes_have_in_common() {
        // The line is a little off: the keyframe of the surface itself is put apart from the others.
        let q = [0.0, 0.05, 0.05, 0.05, 0.5, 1.0];
        let at_rest: Vec<usize> = (0..6).filter(|k| is_at_rest(&q, 0, *k, 0.3)).collect();
        assert_eq!(at_rest, [1, 2, 3]);
    }

    #[test]
    fn it_rests_in_the_keyframe_in_which_it_was_found() {
        let recording = lever(turn);
        followed(&recording, &hinge(), |_, surface, moving| {
            let q = path(surface, &hinge(), moving, &recording);
            assert_eq!(q.len(), moving.len());
            let (_, step) = configurations(&hinge(), &surface.points, STEP_M);
            assert!(q[surface.keyframe].abs() <= step);
        });
    }

    #[test]
    fn a_plate_beside_another_one_does_not_slide_onto_its_place() {
        // The left plate goes upwards and is gone; the right one follows later.
        let up = |frame: usize, first: usize| if frame < first { 0.0 } else { 0.4 };
        let recording = two_sliders(|frame| [up(frame, 8), up(frame, 16)]);
        let views = View::all(&recording);
        let both = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let parts = both.parted_by_time(&views, End::First);
        let left = parts.iter().find(|part| part.centre().x < 0.0).expect("two plates");
        let moving = MovingPoints::near(&left.centre(), 0.8, &views, &|_| Vec::new());
        let there_before = |axis: Vector3<f64>, way: f64| {
            let axis = UnitVector3::new_normalize(axis);
            let geometry = JointGeometry::slide(axis, left.centre());
            let q = (0..moving.len()).map(|k| if k < 8 { 0.0 } else { way }).collect();
            let aligned = Aligned { geometry, q, information: Matrix4::identity() };
            share_there_before(left, &aligned, &moving)
        };
        assert!(there_before(Vector3::x(), 0.13) > 0.9, "the right plate was there before");
        assert_eq!(there_before(-Vector3::y(), 0.4), 0.0, "only the wall was there");
    }

    #[test]
    fn what_is_found_where_something_was_before_is_no_slide() {
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::from(PIVOT_M));
        followed(&slider(|frame| 0.3 * turn(frame)), &slide, |part, _, _| {
            let reason = |there_before: f64| VacatedPart { there_before, ..part.clone() }.doubt();
            assert_eq!(reason(0.9), Some("what is found elsewhere was there before"));
            assert_ne!(reason(0.3), reason(0.9));
        });
    }

    #[test]
    fn the_keyframe_that_a_surface_was_taken_from_tells_nothing_of_its_distances() {
        followed(&lever(turn), &hinge(), |part, surface, moving| {
            let (_, own) = what_is_seen(surface, &part.aligned, &moving[..1], &[]);
            let (_, next) = what_is_seen(surface, &part.aligned, &moving[..2], &[]);
            assert_eq!(surface.keyframe, 0);
            assert!(own.all.is_infinite() && next.all < MAX_MEDIAN_M);
        });
    }

    #[test]
    fn a_lever_without_anybody_is_alone_and_one_beside_a_block_is_not() {
        followed(&lever(turn), &hinge(), |part, _, _| assert!(part.is_alone));
        // A block passes below the bar all the time.
        let passing = recording(turn, |f| Some([-0.35 + 0.025 * f as f64, -0.2]));
        followed(&passing, &hinge(), |part, _, _| assert!(!part.is_alone));
    }

    #[test]
    fn a_hand_that_comes_before_the_lever_moves_leads_it() {
        let coming = recording(turn, |f| (f < 12).then_some([0.35 - 0.02 * f as f64, 0.2]));
        let lead = followed(&coming, &hinge(), |part, _, _| part.lead_s);
        assert!(lead >= MIN_LEAD_S, "{lead}");
        assert_eq!(followed(&lever(turn), &hinge(), |part, _, _| part.lead_s), 0.0);
    }
}
