//! Decides whether a plain part turns about a candidate's line: the planes about the line are followed in the depth
//! images, the line is aligned to them, and the part is accepted if all images confirm it.
//!
//! In: a candidate line, the plane patches, and the recording; base frame.
//! Out: a part with its hinge, a part whose line is not known, or no part.

use super::depth_following::{Following, MAX_POINTS, Search, Surface, follow};
use super::face_edge::{FaceEdges, face_edges};
use super::hinge::{Candidate, Hinge};
use super::line_alignment::{AlignedLine, align_line, largest_place_sigma};
use super::plane_segments::PlanePatch;
use crate::learn::attachment::{MAX_UNATTACHED, unattached_ratio};
use crate::learn::edge_on::{MAX_SPEED_RAD_S, long_edge_on};
use crate::learn::followed_surface::FollowedSurface;
use crate::learn::learned_joint::{LearnedJoint, RejectedCandidate};
use crate::learn::line_step::with_shared_errors;
use crate::learn::recording::Recording;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::Matrix6;
use std::collections::BTreeMap;

/// Fewest keyframes with a plane of the part.
const MIN_KEYFRAMES: usize = 8;
/// Smallest turn of a part that has many planes, radians: as it was followed, and between its planes, because
/// following alone does not establish a hinge.
const MIN_TURNS_RAD: [f64; 2] = [0.2, 0.15];
/// Smallest turn of a part that has few planes, radians: as it was followed, and between its planes. A limb may turn
/// by as much as [`MIN_TURNS_RAD`] for a while.
const MIN_TURNS_OF_FEW_PLANES_RAD: [f64; 2] = [0.35, 0.25];
/// Smallest turn of a part whose hinge is accepted without the near edge of its face, radians. Without the edge,
/// hinges of smaller turns were 7 to 20 cm off.
const LARGE_TURN_RAD: f64 = 0.35;
/// Largest root mean square distance of the planes from where the hinge puts them, metres.
const MAX_RMSE_M: f64 = 0.008;
/// Largest share of the part's points that may be seen through, if it has many planes.
const MAX_VIOLATION: f64 = 0.1;
/// Smallest share of the part's points that must be seen through if the part were turned aside by half its range.
const MIN_DISCRIMINABILITY: f64 = 0.5;
/// Largest difference between a plane's turn and the followed configuration, radians.
const SAME_TURN_RAD: f64 = 0.12;
/// How far beyond the range of its planes a part is followed, radians: a little, and far. The second counts where the
/// first shows no part or less of it: a lid that leans against what is behind it has no plane of its own there.
const BEYOND_RAD: [f64; 2] = [0.1, 1.6];
/// Largest difference between the turn of a plate and that of the planes of its two faces, radians.
const SAME_TURN_OF_FACES_RAD: f64 = 0.2;
/// Smallest share of the keyframes that must show the part.
const LEAST_KEYFRAMES: f64 = 0.7;
/// Largest share of the part's points that may be seen through, if fewer than half of the keyframes have a plane of
/// it.
const FEW_PLANES_VIOLATION: f64 = 0.06;
/// Smallest share of the keyframes that must show a part about the rough line, before it is refined.
const HOPELESS_SHOWN: f64 = 0.4;
/// Largest share of the part's points that may be seen through about the rough line, before it is refined.
const HOPELESS_VIOLATION: f64 = 0.35;
/// Most points by which a part is followed until its line is known.
const FIRST_POINTS: usize = 50;
/// Smallest turn of the planes that guide a part, radians. A trunk that its planes guided turned by 0.7 rad; thin lids
/// turn by 1.1 and more.
const GUIDED_TURN_RAD: f64 = 0.9;
/// Share of the largest speed at which a part may turn that is guided by its planes: it must not wait in keyframes
/// without a plane and then jump.
const GUIDED_SPEED: f64 = 0.6;
/// Consecutive keyframes for which a part must rest.
const REST_KEYFRAMES: usize = 4;
/// Largest turn of a part during its rest, radians.
const REST_RAD: f64 = 0.03;
/// Fewest consecutive planes that must have one turn. A person never stands quite still: the planes of trunks and
/// arms had 1 to 3 in a row, those of parts 4 to 18, with any limit of 0.014 to 0.020 rad.
const REST_PLANES: usize = 4;
/// Largest difference between the turns of a part's planes at rest, radians.
const REST_OF_PLANES_RAD: f64 = 0.016;
/// Largest turn from one keyframe to the next, radians.
const MAX_STEP_RAD: f64 = 1.3;
/// Largest turn of the planes of a hinged plate, radians, three quarters of a turn: a lid that is turned over turns by
/// less. The planes of a chest's top and front, which were taken for one plate, turned by 9.4 rad in all.
const MAX_TURN_RAD: f64 = 1.5 * std::f64::consts::PI;
/// Turn of the planes from which some of them must lie between the ends of the range, radians, unless the part is seen
/// to have come and left.
const TURNS_FAR_RAD: f64 = 0.9;
/// Share of the range at either end whose planes do not lie between the ends.
const AT_END: f64 = 0.2;
/// Smallest share of the visible points, at each end of the range, that must be seen through while the part is at the
/// other end, for it to have come and left.
const CAME_AND_LEFT: f64 = 0.8;
/// Consecutive steps at the largest speed from which the bound counts as holding a path back: without it, the path
/// would jump from one surface to another.
const HELD_BACK_STEPS: usize = 3;
/// Largest standard deviation of a line's place if it lies in the face of its part, metres. A robot must not pull
/// about a line that is less well known.
const MAX_PLACE_SIGMA_M: f64 = 0.025;
/// Largest ratio of the planes' residual with the edges of their face to that without; if it is larger, the edge is
/// not that next to the hinge.
const EDGE_AGREES: f64 = 1.5;
/// Added to the largest residual with the edges, metres.
const EDGE_AGREES_M: f64 = 0.001;
/// Errors of a hinge's direction, radians, and of its place, metres, that all planes share: ledges, the part's
/// thickness and the camera's motion shift them together. With half of these values the true line was in the 95 %
/// region of 27 of 35 plain joints by direction and of 24 of 30 by place; with these of 34 and of 29.
const SHARED_RAD: f64 = 0.0055;
const SHARED_M: f64 = 0.011;

/// Reason against a part with its hinge.
#[derive(Clone, Copy)]
enum Doubt {
    /// No part of an object, for this reason.
    NoPart(&'static str),
    /// A part that turned too little to determine its line.
    LineUnknown,
}

/// Result of following a candidate's line.
pub enum Followed {
    /// A part with its hinge.
    Part(PlainPart),
    /// A part that turned too little to determine its line.
    LineUnknown(PlainPart),
    /// No part.
    Nothing,
}

impl Followed {
    fn of(part: PlainPart) -> Self {
        let doubt = part.doubt();
        part.trace(doubt);
        match doubt {
            None => Self::Part(part),
            Some(Doubt::LineUnknown) => Self::LineUnknown(part),
            Some(Doubt::NoPart(_)) => Self::Nothing,
        }
    }

    /// The better of two results for one candidate.
    fn better(self, other: Self) -> Self {
        match (self, other) {
            (Self::Part(a), Self::Part(b)) => {
                Self::Part(if b.agrees_better_than(&a) { b } else { a })
            }
            (part @ Self::Part(_), _) | (_, part @ Self::Part(_)) => part,
            (unknown @ Self::LineUnknown(_), _) | (_, unknown) => unknown,
        }
    }
}

/// A plain part that turns.
pub struct PlainPart {
    hinge: Hinge,
    /// Line of the hinge, aligned to the depth images.
    line: AlignedLine,
    /// The part's plane at configuration 0.
    surface: Surface,
    /// Configuration of the part in each keyframe.
    followed: Following,
    /// True if the part moves faster than people open things.
    is_fast: bool,
    /// Indices of the planes that show the part, without outliers.
    support: Vec<usize>,
    /// Indices of the planes that show the part, with outliers: no other part needs to explain them.
    pub explained: Vec<usize>,
    /// Configuration of the hinge's first plane, radians.
    first_turn: f64,
    /// Share of the line that is attached to no visible surface.
    unattached_ratio: f64,
    /// True if it was followed with its planes as guides.
    is_guided: bool,
    /// Shares of its points that are seen through at each end of its range while it is at the other end.
    seen_through_at_other_end: [f64; 2],
}

/// The part that is seen to turn about a candidate's line. Two parts may turn about one line (a toilet's lid and
/// seat): the largest plane and the planes at both ends of the range are followed separately, and the part that most
/// planes agree with is taken.
pub fn follow_candidate(
    candidate: &Candidate,
    patches: &[PlanePatch],
    recording: &Recording,
) -> Followed {
    let rough = candidate.hinge(patches, &candidate.support, &FaceEdges::default());
    let Some(rough) = rough.filter(|r| r.turns.len() >= MIN_KEYFRAMES) else {
        return Followed::Nothing;
    };
    let [low, high] = rough.range();
    if high - low < MIN_TURNS_RAD[0] {
        return Followed::Nothing;
    }
    let best = |is_bounded| best_followed(&rough, is_bounded, candidate, patches, recording);
    // The speed is not bounded at first, because jumps reveal the wrong one of two surfaces. A bounded path that
    // fewer planes agree with is on the wrong side of the line.
    match best(false) {
        Followed::Part(fast) if fast.is_fast => match best(true) {
            Followed::Part(slower) if !slower.is_fast && slower.has_no_fewer_planes(&fast) => {
                Followed::Part(slower)
            }
            // If most keyframes have no plane, only the motion supports the part, and it is too fast.
            _ if !fast.has_many_planes() => Followed::Nothing,
            _ => Followed::Part(fast),
        },
        other => other,
    }
}

/// The part that most planes about a line agree with. If depth alone shows none, the planes guide it: a thin lid may
/// lie so close to what is below it that depth finds it there throughout. Its speed is then bounded, because keyframes
/// without a plane would leave it there.
fn best_followed(
    rough: &Hinge,
    is_bounded: bool,
    candidate: &Candidate,
    patches: &[PlanePatch],
    recording: &Recording,
) -> Followed {
    let by = |is_guided: bool| {
        let manner = SearchSpace { range: rough.range(), is_bounded, is_guided };
        near_or_beyond(rough, manner, candidate, patches, recording)
    };
    let [low, high] = rough.range();
    match by(false) {
        part @ Followed::Part(_) => part,
        other if high - low < GUIDED_TURN_RAD => other,
        other => other.better(by(true)),
    }
}

/// The part that most planes about a line agree with, near the range of these planes or far beyond it.
fn near_or_beyond(
    rough: &Hinge,
    manner: SearchSpace,
    candidate: &Candidate,
    patches: &[PlanePatch],
    recording: &Recording,
) -> Followed {
    let [low, high] = manner.range;
    let of_surfaces = |beyond: f64, surface_of: &dyn Fn(usize) -> Option<Surface>| {
        let search = SearchSpace { range: [low - beyond, high + beyond], ..manner };
        let parts = rough.ends().into_iter().filter_map(|seed| {
            followed(&surface_of(seed)?, rough, search, candidate, patches, recording)
        });
        parts.map(Followed::of).fold(Followed::Nothing, Followed::better)
    };
    let within = |beyond: f64| {
        let of_face = |seed| Some(face_of(seed, rough, candidate, patches));
        match of_surfaces(beyond, &of_face) {
            part @ Followed::Part(_) => part,
            other => {
                other.better(of_surfaces(beyond, &|seed| plate_of(seed, rough, candidate, patches)))
            }
        }
    };
    let [beside, beyond] = BEYOND_RAD;
    let near = within(beside);
    if let Followed::Part(part) = &near
        && part.followed.shown_ratio() >= 1.0
    {
        // All keyframes show the part, so no other path shows more.
        return near;
    }
    match (near, within(beyond)) {
        (Followed::Part(near), Followed::Part(far)) => {
            Followed::Part(if far.explains_more_than(&near) { far } else { near })
        }
        (near, far) => near.better(far),
    }
}

/// Fewest planes that show the other face of a plate.
const MIN_OF_OTHER_FACE: usize = 3;

/// The surface of one of the planes about a line, at configuration 0.
fn face_of(plane: usize, rough: &Hinge, candidate: &Candidate, patches: &[PlanePatch]) -> Surface {
    let patch = &patches[candidate.support[plane]];
    let back = rough.geometry().motion(-rough.turns[plane].1);
    let points = patch.points.iter().map(|p| back * p).collect();
    Surface { points, normal: back * patch.normal, back: Vec::new() }
}

/// The surface of one of the planes about a line, with that of the largest plane of its other face, at configuration
/// 0: no face of a thick lid is in sight both when it is closed and when it is open. `None` if few planes show
/// another face.
fn plate_of(
    plane: usize,
    rough: &Hinge,
    candidate: &Candidate,
    patches: &[PlanePatch],
) -> Option<Surface> {
    let others: Vec<usize> = rough.of_other_face(plane).collect();
    let size = |k: &usize| patches[candidate.support[*k]].points.len();
    let largest = others.iter().copied().max_by_key(size)?;
    let back = || face_of(largest, rough, candidate, patches).points;
    let face = face_of(plane, rough, candidate, patches);
    (others.len() >= MIN_OF_OTHER_FACE).then(|| Surface { back: back(), ..face })
}

/// Range in which a part is searched for, and what bounds it.
#[derive(Clone, Copy)]
struct SearchSpace {
    /// Range of configurations, radians.
    range: [f64; 2],
    /// True if the part may move no faster than people open things.
    is_bounded: bool,
    /// True if the part is where its planes are, in the keyframes that have one.
    is_guided: bool,
}

/// Follows a surface about a rough line, refines the line from the planes that agree, and follows the surface about
/// the refined line. `None` if few planes agree or they do not keep their distance from the line.
fn followed(
    surface: &Surface,
    rough: &Hinge,
    search: SearchSpace,
    candidate: &Candidate,
    patches: &[PlanePatch],
    recording: &Recording,
) -> Option<PlainPart> {
    // Each point is tested in each keyframe, so few points are used, and fewer still until the line is known.
    let [for_line, few] = [FIRST_POINTS, MAX_POINTS].map(|most| surface.thinned(most));
    let max_steps = recording.keyframes.largest_steps(MAX_SPEED_RAD_S);
    let bound: Vec<f64> = match (search.is_guided, search.is_bounded) {
        (true, _) => max_steps.iter().map(|max| GUIDED_SPEED * max).collect(),
        (_, true) => max_steps.clone(),
        _ => Vec::new(),
    };
    let guides = if search.is_guided { &rough.turns[..] } else { &[] };
    let follow = |surface: &Surface, geometry: &JointGeometry, reach: f64| {
        let guided_to = SAME_TURN_RAD;
        let search = Search { range: search.range, max_steps: &bound, guides, guided_to };
        follow(surface, geometry, reach, &search, recording)
    };
    let first = follow(&for_line, &rough.geometry(), rough.reach());
    if first.shown_ratio() < HOPELESS_SHOWN || first.free_space_violation() > HOPELESS_VIOLATION {
        return None;
    }
    let agrees = |(k, (frame, turn)): (usize, &(usize, f64))| {
        let q = first.at(*frame)?;
        ((turn - q).abs() < SAME_TURN_RAD).then_some(candidate.support[k])
    };
    let explained: Vec<usize> = rough.turns.iter().enumerate().filter_map(agrees).collect();
    let mut support = explained.clone();
    if support.len() < MIN_KEYFRAMES {
        return None;
    }
    let hinge = refined(candidate, patches, &mut support, recording)?;
    if support.len() < MIN_KEYFRAMES || hinge.rmse > MAX_RMSE_M {
        return None;
    }
    let is_first = |k: &usize| Some(&candidate.support[*k]) == support.first();
    let first_turn = rough.turns[(0..rough.turns.len()).find(is_first)?].1;
    let again = follow(&for_line, &hinge.geometry(), hinge.reach());
    let line = align_line(&few, &hinge, &again, recording);
    let followed = follow(&few, &line.geometry, hinge.reach());
    let camera_from_base = |frame: usize| recording.ego_motion.camera_from_base[frame];
    let unattached_ratio =
        unattached_ratio(&line.geometry, &few.points, recording, camera_from_base);
    let seen_through_at_other_end =
        followed.seen_through_at_other_end(&few, &line.geometry, AT_END, recording);
    let surface = surface.clone();
    let is_fast = !followed.keeps_within(&max_steps)
        || followed.longest_run_at(&max_steps) >= HELD_BACK_STEPS;
    let mut part = PlainPart {
        hinge,
        line,
        surface,
        followed,
        is_fast,
        support,
        explained,
        first_turn,
        unattached_ratio,
        is_guided: search.is_guided,
        seen_through_at_other_end,
    };
    part.find_edge_on(recording);
    Some(part)
}

/// The hinge of the planes, with the edges of their face if these agree. Outliers are removed from `support`.
fn refined(
    candidate: &Candidate,
    patches: &[PlanePatch],
    support: &mut Vec<usize>,
    recording: &Recording,
) -> Option<Hinge> {
    let hinge = candidate.hinge_without_outliers(patches, support, MAX_RMSE_M)?;
    let planes: Vec<&PlanePatch> = support.iter().map(|&k| &patches[k]).collect();
    let edges = face_edges(&hinge.geometry(), &planes, recording);
    let at_edge = candidate.hinge(patches, support, &edges)?;
    let agrees = at_edge.rmse < EDGE_AGREES * hinge.rmse + EDGE_AGREES_M;
    Some(if agrees { at_edge } else { hinge })
}

impl PlainPart {
    /// Distance from the line to the farthest point of the part, metres.
    pub fn reach(&self) -> f64 {
        self.hinge.reach()
    }

    /// True if this part does not jump but the other one does; or if more planes agree with it; or if as many agree
    /// and its line is better known.
    fn agrees_better_than(&self, other: &Self) -> bool {
        let steady = other.jumps().cmp(&self.jumps());
        let more = self.agreement().total_cmp(&other.agreement());
        let better_known = other.place_sigma().total_cmp(&self.place_sigma());
        steady.then(more).then(better_known).is_gt()
    }

    /// Finds the part in keyframes that see it from its edge, if few keyframes show it: a door that is left wide open
    /// shows no face until the end.
    fn find_edge_on(&mut self, recording: &Recording) {
        if self.followed.shown_ratio() >= LEAST_KEYFRAMES && self.followed.is_there_throughout() {
            return;
        }
        let mut told: BTreeMap<usize, f64> =
            self.followed.shown().map(|p| (p.frame, p.q)).collect();
        told.extend(self.configuration());
        let known: Vec<Option<f64>> =
            recording.keyframes.iter().map(|(frame, _)| told.get(&frame).copied()).collect();
        let (line, points) = (&self.line.geometry, &self.surface.points);
        let edge_on = long_edge_on(line, points, &known, recording);
        self.followed.set_edge_on(&edge_on);
    }

    /// Number of planes that agree with the part, reduced by their residual.
    fn agreement(&self) -> f64 {
        self.support.len() as f64 * (1.0 - (self.hinge.rmse / MAX_RMSE_M).powi(2))
    }

    /// Reason against the part; `None` if it is a part with its hinge.
    fn doubt(&self) -> Option<Doubt> {
        let seen = &self.followed;
        let [low, high] = seen.range();
        let max_violation =
            if self.has_many_planes() { MAX_VIOLATION } else { FEW_PLANES_VIOLATION };
        let [least_turn, least_turn_of_planes] = match (self.is_guided, self.has_many_planes()) {
            (true, _) => [GUIDED_TURN_RAD; 2],
            (_, true) => MIN_TURNS_RAD,
            _ => MIN_TURNS_OF_FEW_PLANES_RAD,
        };
        let reasons = [
            (high - low < least_turn, "it hardly turns"),
            (self.turn_of_planes() < least_turn_of_planes, "its planes do not turn"),
            (self.turn_of_planes() > MAX_TURN_RAD, "its planes turn farther than a hinge can"),
            (self.turns_unlike_its_planes(), "its two faces are not those of one plate"),
            (self.are_two_surfaces_in_turn(), "its planes show two positions and nothing between"),
            (!(self.has_many_planes() || seen.is_there_throughout()), "it comes and leaves"),
            (!seen.rests(REST_KEYFRAMES, REST_RAD), "it never rests"),
            (
                self.hinge.longest_rest(REST_OF_PLANES_RAD) < REST_PLANES,
                "its planes never stand still",
            ),
            (seen.free_space_violation() > max_violation, "it is seen through"),
            (
                seen.discriminability() < MIN_DISCRIMINABILITY,
                "the pictures tell nothing of where it is",
            ),
            (seen.shown_ratio() < LEAST_KEYFRAMES, "few pictures show it"),
            (self.unattached_ratio > MAX_UNATTACHED, "nothing holds its line"),
        ];
        if let Some((_, reason)) = reasons.into_iter().find(|(holds, _)| *holds) {
            return Some(Doubt::NoPart(reason));
        }
        let is_unknown = self.hinge.place_sigma_in_face() > MAX_PLACE_SIGMA_M
            || high - low < LARGE_TURN_RAD && !self.hinge.has_near_edge;
        is_unknown.then_some(Doubt::LineUnknown)
    }

    /// True if the planes turn far, none lies between both ends, and at one of the ends the images do not show free
    /// space while the part is at the other end. These are two static surfaces that are seen in turn, as the desk that
    /// rises shows the front of the cabinet below. (Of six doors and lids that turn as far, at least 3 planes lay
    /// between; of the desk, and of lids that were thrown open between two keyframes, none.)
    fn are_two_surfaces_in_turn(&self) -> bool {
        self.turn_of_planes() > TURNS_FAR_RAD
            && self.hinge.planes_between(AT_END * self.turn_of_planes()) == 0
            && self.seen_through_at_other_end.iter().any(|share| *share < CAME_AND_LEFT)
    }

    /// True if the part has two faces and its planes do not turn by as much as it does. The planes of one plate do;
    /// the front and the back of an arm do not.
    fn turns_unlike_its_planes(&self) -> bool {
        let [low, high] = self.followed.range();
        let apart = (high - low) - self.turn_of_planes();
        !self.surface.back.is_empty() && apart.abs() > SAME_TURN_OF_FACES_RAD
    }

    /// True if at least half of the keyframes have a plane of the part: the planes confirm it, even where an open
    /// door is seen edge-on.
    fn has_many_planes(&self) -> bool {
        2 * self.support.len() >= self.followed.keyframes()
    }

    /// True if more images show this part than the other one, and no more of its points are seen through: a door that
    /// opens beyond its planes.
    fn explains_more_than(&self, other: &Self) -> bool {
        let (more, less) = (&self.followed, &other.followed);
        !self.jumps()
            && (!self.is_fast || other.is_fast)
            && self.has_no_fewer_planes(other)
            && more.shown_ratio() > less.shown_ratio()
            && more.free_space_violation() <= less.free_space_violation()
    }

    /// True if at least as many planes agree with this part as with the other one.
    fn has_no_fewer_planes(&self, other: &Self) -> bool {
        self.support.len() >= other.support.len()
    }

    /// True if the part jumps between consecutive keyframes that show it. The planes of a part that slides, or of two
    /// parts that look the same, seem to turn over.
    pub fn jumps(&self) -> bool {
        self.followed.largest_step() > MAX_STEP_RAD
    }

    /// Range of the turns of the planes that show the part, radians.
    fn turn_of_planes(&self) -> f64 {
        let [low, high] = self.hinge.range();
        high - low
    }

    fn trace(&self, doubt: Option<Doubt>) {
        let rejected = match doubt {
            None => "no",
            Some(Doubt::NoPart(reason)) => reason,
            Some(Doubt::LineUnknown) => "it turns too little to tell about which line",
        };
        let [low, high] = self.followed.range();
        tracing::debug!(
            planes = self.support.len(),
            turn_of_planes = self.turn_of_planes(),
            turn = high - low,
            rmse = self.hinge.rmse,
            residual = self.line.rmse,
            free_space_violation = self.followed.free_space_violation(),
            discriminability = self.followed.discriminability(),
            shown = self.followed.shown_ratio(),
            unattached = self.unattached_ratio,
            place_sigma = self.place_sigma(),
            axis = ?self.line.geometry.axis.as_slice(),
            origin = ?self.line.geometry.origin.coords.as_slice(),
            jumps = self.jumps(),
            step = self.followed.largest_step(),
            low, high,
            other_end = ?self.seen_through_at_other_end,
            rejected,
            "plain hinge"
        );
    }

    /// Largest standard deviation of the line's place, metres.
    fn place_sigma(&self) -> f64 {
        largest_place_sigma(&self.line.covariance)
    }

    /// Covariance of (axis, origin), including the errors that all readings share.
    fn covariance(&self) -> Matrix6<f64> {
        let line = &self.line;
        with_shared_errors(line.covariance, &line.geometry, SHARED_RAD, SHARED_M)
    }

    /// Configuration by frame, radians: the turn of a plane that shows the part, which is the most exact; else the
    /// followed configuration, if the keyframe is certain of it.
    fn configuration(&self) -> BTreeMap<usize, f64> {
        let followed = self.followed.certain().map(|p| (p.frame, p.q));
        let planes = self.hinge.turns.iter().map(|(frame, turn)| (*frame, self.first_turn + turn));
        followed.chain(planes).collect()
    }

    /// Report on a part whose hinge is not known.
    pub fn unknown_line(&self) -> RejectedCandidate {
        let [low, high] = self.followed.range();
        let reason = format!(
            "a flat part turned by {:.0} degrees, but that is too little to tell about which line; open \
             it further, or show the side of its hinge",
            (high - low).to_degrees()
        );
        let frames = self.followed.shown().count();
        RejectedCandidate { kind: JointKind::Revolute, tracks: 0, frames, reason, needs_more: true }
    }

    /// The part as a joint of the base. The configuration is known in the keyframes that show the part.
    pub fn to_learned(&self, recording: &Recording) -> LearnedJoint {
        let surface = FollowedSurface {
            geometry: self.line.geometry,
            covariance: self.covariance(),
            points: &self.surface.points,
            configuration: self.configuration().into_iter().collect(),
            rmse: self.line.rmse,
        };
        surface.into_learned(recording)
    }
}

#[cfg(test)]
mod tests {
    use super::super::hinge::candidates;
    use super::super::plane_segments::{Sampling, moving_patches};
    use super::super::test_data::{HINGE_M, door_recording, left_edge_on_recording, turn};
    use super::*;
    use crate::math::rigid::{distance_to_line, line_angle};
    use nalgebra::{Point3, Vector3};

    /// What is found about the line that most planes of a recording turn about.
    fn found(recording: &Recording) -> Followed {
        let patches = moving_patches(recording, Sampling::Coarse, None);
        let best = candidates(&patches, 1);
        best.first().map_or(Followed::Nothing, |best| follow_candidate(best, &patches, recording))
    }

    fn part(recording: &Recording) -> PlainPart {
        match found(recording) {
            Followed::Part(part) => part,
            Followed::LineUnknown(_) => panic!("its line is not known"),
            Followed::Nothing => panic!("nothing is found"),
        }
    }

    /// A door that is opened this far, of the whole way, and rests before and after.
    fn opened(share: f64) -> Recording {
        door_recording(24, |f| share * turn(f))
    }

    #[test]
    fn a_plain_door_is_a_part_that_turns_about_its_hinge_as_far_as_it_was_opened() {
        let part = part(&opened(1.0));
        let line = &part.line.geometry;
        assert!(line_angle(&line.axis, &Vector3::y()) < 0.02);
        let hinge = Point3::new(HINGE_M[0], 0.0, HINGE_M[1]);
        let apart = distance_to_line(&hinge, &line.axis, &line.origin);
        assert!(apart < 0.02, "{apart} m off");
        let [low, high] = part.followed.range();
        assert!((high - low - turn(23)).abs() < 0.08, "{low} to {high}");
        assert!(!part.jumps() && part.doubt().is_none());
        assert!(part.seen_through_at_other_end.iter().all(|share| *share > CAME_AND_LEFT));
    }

    #[test]
    fn a_door_that_is_left_so_wide_open_that_it_shows_its_edge_is_a_part() {
        let part = part(&left_edge_on_recording(40));
        assert!(2 * part.followed.shown().count() < part.followed.keyframes());
        assert!(part.doubt().is_none());
    }

    #[test]
    fn two_surfaces_that_are_seen_in_turn_are_no_part_that_turned() {
        let mut part = part(&opened(1.0));
        let [low, high] = part.hinge.range();
        part.hinge.turns.retain(|(_, q)| *q < low + 0.1 || *q > high - 0.1);
        assert_eq!(part.hinge.range(), [low, high]);
        assert!(
            part.doubt().is_none(),
            "a door that is thrown open: both its places are empty without it"
        );
        // The second surface was hidden by the first one, not absent.
        part.seen_through_at_other_end[1] = 0.0;
        let Some(Doubt::NoPart(reason)) = part.doubt() else { panic!("a part") };
        assert_eq!(reason, "its planes show two positions and nothing between");
    }

    #[test]
    fn planes_that_wind_round_their_line_are_no_part() {
        let mut part = part(&opened(1.0));
        let last = part.hinge.turns.len() - 1;
        part.hinge.turns[last].1 += 6.0;
        let Some(Doubt::NoPart(reason)) = part.doubt() else { panic!("a part") };
        assert_eq!(reason, "its planes turn farther than a hinge can");
    }

    #[test]
    fn its_configuration_is_told_in_the_keyframes_that_show_it() {
        let part = part(&opened(1.0));
        let q = part.configuration();
        let sense = (q[&23] - q[&6]).signum();
        for frame in [7, 10, 14, 20, 23] {
            let turned = sense * (q[&frame] - q[&6]);
            assert!((turned - turn(frame)).abs() < 0.05, "frame {frame}: {turned}");
        }
    }

    #[test]
    fn no_line_is_told_more_exactly_than_ledges_and_thickness_allow() {
        let recording = opened(1.0);
        let learned = part(&recording).to_learned(&recording);
        assert_eq!(learned.joint.kind, JointKind::Revolute);
        assert!(!learned.plain_surface.is_empty() && learned.tracks.is_empty());
        let variance = |k: usize| learned.joint.covariance[k][k];
        assert!((3..6).map(variance).fold(0.0, f64::max).sqrt() >= SHARED_M);
        assert!((0..3).map(variance).fold(0.0, f64::max).sqrt() >= SHARED_RAD);
    }

    #[test]
    fn a_door_that_is_hardly_opened_is_no_part_with_a_hinge() {
        assert!(!matches!(found(&opened(0.1)), Followed::Part(_)));
        assert!(matches!(found(&opened(0.0)), Followed::Nothing));
    }

    #[test]
    fn a_door_that_never_rests_is_no_part() {
        let swings = door_recording(24, |f| 0.65 - 0.65 * (0.9 * f as f64).cos());
        assert!(!matches!(found(&swings), Followed::Part(_)));
    }

    #[test]
    fn what_sways_by_half_a_degree_at_either_end_of_its_turn_is_a_person() {
        let sways = |f: usize| turn(f) + 0.012 * (1.9 * f as f64).sin();
        assert!(matches!(found(&door_recording(24, sways)), Followed::Nothing));
    }

    #[test]
    fn what_needs_more_is_told_with_how_far_it_turned_and_what_to_do() {
        let told = part(&opened(1.0)).unknown_line();
        assert!(told.needs_more && told.kind == JointKind::Revolute);
        let [degrees] =
            told.reason.split(' ').filter_map(|w| w.parse::<f64>().ok()).collect::<Vec<_>>()[..]
        else {
            panic!("one number: {}", told.reason)
        };
        assert!((degrees - turn(23).to_degrees()).abs() < 5.0, "{}", told.reason);
        assert!(told.reason.contains("open it further"));
    }

    #[test]
    fn of_two_followings_a_part_is_better_than_an_unknown_line_and_that_than_nothing() {
        let recording = opened(1.0);
        let known = || Followed::Part(part(&recording));
        let unknown = || Followed::LineUnknown(part(&recording));
        assert!(matches!(known().better(unknown()), Followed::Part(_)));
        assert!(matches!(unknown().better(known()), Followed::Part(_)));
        assert!(matches!(Followed::Nothing.better(unknown()), Followed::LineUnknown(_)));
        assert!(matches!(Followed::Nothing.better(Followed::Nothing), Followed::Nothing));
    }

    #[test]
    fn a_following_agrees_better_with_more_planes_and_as_many_by_a_line_that_is_known_better() {
        let recording = opened(1.0);
        let (whole, mut less) = (part(&recording), part(&recording));
        assert!(!whole.agrees_better_than(&less), "they are alike");
        less.support.truncate(MIN_KEYFRAMES);
        assert!(whole.agrees_better_than(&less) && !less.agrees_better_than(&whole));
        assert!(whole.has_no_fewer_planes(&less) && !less.has_no_fewer_planes(&whole));
        let mut unsure = part(&recording);
        unsure.line.covariance *= 4.0;
        assert!(whole.agrees_better_than(&unsure) && !unsure.agrees_better_than(&whole));
    }
}
