//! Learns parts that have neither features nor planes to follow: a lever, the spokes of a valve's wheel.
//!
//! A part rests before or after it is moved, and other keyframes see through the place where it was: its surface is
//! what was vacated (`rest_surface.rs`). Joint hypotheses (`hypotheses.rs`) are scored against what moves in the
//! other keyframes (`moving_points.rs`), the best are aligned (`alignment.rs`), and one is accepted if all keyframes
//! confirm it (`vacated_part.rs`).
//!
//! In: the known joints, and the recording.
//! Out: these joints and those of other parts; base frame, metres and radians.

mod alignment;
mod connected_body;
mod directions;
mod hypotheses;
mod moving_points;
mod point_grid;
mod rest_frame;
mod rest_surface;
mod slide_or_hinge;
mod stillness;
#[cfg(test)]
mod test_data;
mod tilt;
mod vacated_part;
mod view;

use super::free_space::{FreeSpaceCounts, count_free_space};
use super::learned_joint::{LearnedJoint, LearnedJoints, RejectedCandidate, TurningPlane};
use super::plane_hinges::{is_same_hinge, moves_together, take_turns};
use super::recording::Recording;
use crate::math::rigid::{Pose, distance_to_line, line_angle};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::Joint;
use connected_body::Body;
use directions::axis_directions;
use hypotheses::{Hypothesis, best_hypotheses};
use moving_points::MovingPoints;
use nalgebra::{Point3, UnitVector3, Vector3};
use rayon::prelude::*;
use rest_frame::RestFrame;
use rest_surface::{End, RestSurface, vacated_surfaces};
use stillness::{RoomShifts, sways};
use vacated_part::{PARALLEL_RAD, Rivals, VacatedPart};
use view::View;

/// Most surfaces that are tried at each end of the recording, the largest first.
const MOST_SURFACES: usize = 4;
/// Most surfaces that are reported with the reason for which they are no parts.
const MOST_REJECTIONS: usize = 3;
/// Largest radius of a surface, metres; a larger one has features or planes.
const MAX_RADIUS_M: f64 = 0.8;
/// Most hinges and most slides that are aligned, the best first.
const MOST_ALIGNED: [usize; 2] = [10, 2];
/// How far a part may move, in radii of its surface.
const TRAVEL_RADII: f64 = 3.0;
/// How much farther a part may move, metres.
const TRAVEL_M: f64 = 0.1;
/// Smallest ratio of a slide's agreement to a hinge's at which the slide is preferred, because it is simpler. A hinge
/// on the line of a known one is preferred likewise: doors above each other hang on one line. So is a slide along the
/// normal of its flat front, or parallel to a known slide, if the other one is a slide as well.
const SIMPLER: f64 = 0.97;
/// Standard deviation of the direction of a hinge that is built square to its surroundings, radians.
const SQUARE_RAD: f64 = 0.035;
/// Standard deviation of a free direction, radians.
const ANY_RAD: f64 = 0.3;
/// Largest angle between a slide and the normal of its flat front, or a known slide, for the slide to take that
/// direction, radians.
const ALONG_RAD: f64 = 0.15;
/// Standard deviation of a slide's direction that is that of a front's normal or of a known slide, radians.
const FRONT_RAD: f64 = 0.012;
/// Ratio of agreement above which a free direction is taken instead of a square one, or a plate with two faces
/// instead of one face.
const BETTER: f64 = 1.03;
/// Thicknesses that are tried for a part that shows its other face, metres: sheet metal to a copier's lid. A reading
/// supports a point up to 12 mm away.
const THICKNESSES_M: [f64; 5] = [0.0, 0.012, 0.024, 0.036, 0.05];
/// Ratio of keyframes that show a part, above which a new joint replaces the known one.
const MANY_MORE: f64 = 1.2;
/// Angle below which two lines may count as one, radians.
const SAME_LINE_RAD: f64 = 0.2;
/// Distance below which two lines may count as one, metres.
const SAME_LINE_M: f64 = 0.06;
/// Share of a part's points at each end along its line that is left out.
const OUTERMOST: f64 = 0.05;
/// Largest distance from the middle of a surface to a plane that may turn with it, in radii of the surface.
const PLANES_RADII: f64 = 2.0;
/// Largest share of a surface's visible points that may be seen through where a known joint puts them, for the
/// surface to be of the joint's part.
const EXPLAINED_THROUGH: f64 = 0.2;
/// Smallest share of a surface's points that must be found where a known joint puts them, for the surface to be of
/// the joint's part.
const EXPLAINED_FOUND: f64 = 0.3;
/// Motion from which a known part is clearly elsewhere than while the surface rests, metres.
const ELSEWHERE_M: f64 = 0.04;
/// Largest share of the visible points that may be seen through while a known part is elsewhere, for a surface of that
/// part which is hidden most of the time.
const HIDDEN_THROUGH: f64 = 0.05;
/// Why a surface is refused that two quite different hinges explain.
const AMBIGUOUS: &str =
    "another hinge, in another direction or at another place, explains it nearly as well";

/// Why a surface is refused that hangs on what sways.
const LIMB: &str = "it hangs on a body that sways, as a forearm does";

/// Adds the joints of parts that were seen to leave their places and that no joint explains.
pub fn complete(found: LearnedJoints, recording: &Recording) -> LearnedJoints {
    let LearnedJoints { joints, mut rejections, turning } = found;
    let views = View::all(recording);
    let mut search = Search {
        joints,
        waiting: Vec::new(),
        refused: Vec::new(),
        turning: &turning,
        recording,
        views: &views,
    };
    for end in [End::First, End::Last] {
        let mut surfaces = vacated_surfaces(&views, end, |frame| places_on(&search.joints, frame));
        surfaces.retain(|surface| surface.radius() < MAX_RADIUS_M);
        surfaces.truncate(MOST_SURFACES);
        if surfaces.is_empty() {
            continue;
        }
        let room = RoomShifts::of(end, &views);
        for surface in surfaces {
            if !search.explains(&surface) {
                search.consider_whole_or_parted(&surface, &room);
            }
        }
    }
    search.consider_waiting();
    let Search { joints, refused, .. } = search;
    // The largest of the first end come first.
    for candidate in refused.into_iter().take(MOST_REJECTIONS) {
        if !rejections.contains(&candidate) {
            rejections.push(candidate);
        }
    }
    LearnedJoints { joints, rejections, turning }
}

/// Joints and surfaces known so far, and the data of the search.
struct Search<'r> {
    joints: Vec<LearnedJoint>,
    /// Slides that are not confirmed yet: another drawer of the cabinet may be found later.
    waiting: Vec<(RestSurface, LearnedJoint)>,
    /// Surfaces that are no parts, and why.
    refused: Vec<RejectedCandidate>,
    turning: &'r [TurningPlane],
    recording: &'r Recording,
    views: &'r [View<'r>],
}

impl Search<'_> {
    /// True if the surface is of a known joint's part.
    fn explains(&self, surface: &RestSurface) -> bool {
        self.joints.iter().any(|j| explains(j, surface, self.recording, self.views))
    }

    /// Considers a surface, and if that is rejected its pieces by the time at which they left: a surface may be
    /// several parts, the first of which was not put back before the next one left.
    fn consider_whole_or_parted(&mut self, surface: &RestSurface, room: &RoomShifts) {
        let refused_before = self.refused.len();
        if self.consider(surface, room) {
            return;
        }
        let mut is_part = false;
        for part in surface.parted_by_time(self.views, room.end) {
            tracing::debug!("a surface that left in two steps");
            is_part |= self.consider(&part, room);
        }
        if is_part {
            self.refused.truncate(refused_before);
        }
    }

    /// Adds the joint of a surface if it is accepted, or keeps it until another slide is known. True in both cases.
    fn consider(&mut self, surface: &RestSurface, room: &RoomShifts) -> bool {
        let Self { recording, views, turning, .. } = *self;
        if sways(surface, views, room) {
            tracing::debug!(centre = ?surface.centre().coords.as_slice(), "a surface that sways");
            return false;
        }
        let frame = RestFrame::of(surface, views, room);
        tracing::debug!(?frame, "what is beside it");
        let part = match part_of(surface, frame, &self.joints, turning, recording, views) {
            Ok(part) => part,
            Err(refused) => {
                self.refused.extend(refused);
                return false;
            }
        };
        if frame.body == Body::Sways {
            self.refused.push(refused(part.geometry().kind, part.shown().count(), LIMB));
            return false;
        }
        let learned = part.to_learned(surface, recording);
        let may_be_set_in = !frame.is_open() && frame.body != Body::Nothing;
        let is_drawer = frame.is_set_in()
            || part.is_clearly_a_slide() && may_be_set_in
            || part.keeps_direction() && frame.has_something_beside();
        if is_drawer || may_be_of(&learned.joint, &self.joints) {
            add(learned, &mut self.joints);
        } else {
            self.waiting.push((surface.clone(), learned));
        }
        true
    }

    /// Adds the waiting slides that another slide confirms by now.
    fn consider_waiting(&mut self) {
        for (surface, learned) in std::mem::take(&mut self.waiting) {
            if may_be_of(&learned.joint, &self.joints) && !self.explains(&surface) {
                add(learned, &mut self.joints);
            } else if !self.explains(&surface) {
                let reason =
                    "nothing holds it: it closes no opening, and no other slide is parallel to it";
                let frames = learned.joint.configuration.len();
                self.refused.push(refused(learned.joint.kind, frames, reason));
            }
        }
    }
}

/// A surface that is no part, in the report.
fn refused(kind: JointKind, frames: usize, reason: &str) -> RejectedCandidate {
    RejectedCandidate { kind, tracks: 0, frames, reason: reason.to_owned(), needs_more: false }
}

/// Adds a joint, unless it is one of the known ones. A joint that shows a plain part in many more keyframes replaces
/// the known joint of that part.
fn add(mut learned: LearnedJoint, joints: &mut Vec<LearnedJoint>) {
    // A hand that pulls a drawer slides along with it.
    let is_hand = |j: &LearnedJoint| {
        learned.joint.kind == JointKind::Prismatic && moves_together(j, &learned)
    };
    // Planes may have found one face of a thick lid, and the new joint is of its other face.
    let is_other_face =
        |j: &LearnedJoint| is_same_hinge(&j.joint, &learned.joint) && moves_together(j, &learned);
    let is_same = |j: &LearnedJoint| {
        is_about_one_line(&j.joint, &learned.joint) && !are_two_parts(j, &learned)
            || is_hand(j)
            || is_other_face(j)
    };
    let Some(known) = joints.iter().position(is_same) else {
        learned.joint.child = joints.len() + 1;
        learned.joint.name = format!("joint{}", joints.len() + 1);
        joints.push(learned);
        return;
    };
    let shown = |j: &LearnedJoint| j.joint.configuration.len() as f64;
    let joint = &joints[known];
    let is_plain = joint.tracks.is_empty() && joint.joint.parent == 0;
    if is_plain && is_other_face(joint) && shown(&learned) > MANY_MORE * shown(joint) {
        learned.joint.child = joint.joint.child;
        learned.joint.name.clone_from(&joint.joint.name);
        joints[known] = learned;
    }
}

/// True if both joints have about the same line; a known slide matches only a new slide.
fn is_about_one_line(known: &Joint, new: &Joint) -> bool {
    let axis = known.axis.into();
    (known.kind != JointKind::Prismatic || new.kind == JointKind::Prismatic)
        && line_angle(&axis, &new.axis.into()) < SAME_LINE_RAD
        && distance_to_line(&known.origin.into(), &axis, &new.origin.into()) < SAME_LINE_M
}

/// True if two joints about one line are of two parts: drawers that are pulled in turn, or doors above each other.
fn are_two_parts(known: &LearnedJoint, new: &LearnedJoint) -> bool {
    let is_slide = |j: &LearnedJoint| j.joint.kind == JointKind::Prismatic;
    is_slide(known) && is_slide(new) && take_turns(known, new) || are_beside_each_other(known, new)
}

/// True if two parts are clearly apart along one line and do not move together: doors above each other. A part
/// elsewhere on the line, but not clearly apart, is more often the known part, badly followed.
fn are_beside_each_other(known: &LearnedJoint, new: &LearnedJoint) -> bool {
    let axis = Vector3::from(known.joint.axis);
    let along = |j: &LearnedJoint| {
        let mut places: Vec<f64> = j.plain_surface.iter().map(|p| axis.dot(&p.coords)).collect();
        places.sort_by(f64::total_cmp);
        let at = |share: f64| places.get((share * places.len() as f64) as usize).copied();
        Some([at(OUTERMOST)?, at(1.0 - OUTERMOST)?])
    };
    let (Some([a, b]), Some([c, d])) = (along(known), along(new)) else { return false };
    known.joint.kind == JointKind::Revolute && (c > b || a > d) && !moves_together(known, new)
}

/// True if a surface goes where a known joint's part goes. The inside of a drawer is hidden while the drawer is shut:
/// it is the drawer's if keyframes find it, all points once on the average, while the drawer is elsewhere than at the
/// surface's rest, and hardly any keyframe sees through it.
fn explains(
    learned: &LearnedJoint,
    surface: &RestSurface,
    recording: &Recording,
    views: &[View],
) -> bool {
    let known: Vec<(&View, &Pose)> =
        views.iter().filter_map(|v| Some((v, learned.base_from_part[v.frame].as_ref()?))).collect();
    let rest = views[surface.keyframe].frame;
    let Some((_, at_rest)) = known.iter().min_by_key(|(v, _)| v.frame.abs_diff(rest)) else {
        return false;
    };
    let (back, centre) = (at_rest.inverse(), surface.centre());
    let (mut seen, mut elsewhere) = (FreeSpaceCounts::default(), FreeSpaceCounts::default());
    for (view, pose) in &known {
        let moved = **pose * back;
        let camera_from_surface = recording.ego_motion.camera_from_base[view.frame] * moved;
        let counts = count_free_space(view.picture, &surface.points, &camera_from_surface);
        seen.add(counts);
        if (moved * centre - centre).norm() > ELSEWHERE_M {
            elsewhere.add(counts);
        }
    }
    let asked = known.len() * surface.points.len();
    let is_found = seen.share_through() < EXPLAINED_THROUGH
        && seen.agrees as f64 > EXPLAINED_FOUND * asked as f64;
    let is_hidden_at_times = seen.share_through() < HIDDEN_THROUGH
        && elsewhere.share_through() < HIDDEN_THROUGH
        && elsewhere.agrees > surface.points.len();
    is_found || is_hidden_at_times
}

/// The part that a surface is of, with its joint; else the best candidate and why it was refused, if there is one.
fn part_of(
    surface: &RestSurface,
    frame: RestFrame,
    joints: &[LearnedJoint],
    turning: &[TurningPlane],
    recording: &Recording,
    views: &[View],
) -> Result<VacatedPart, Option<RejectedCandidate>> {
    let radius = TRAVEL_RADII * surface.radius() + TRAVEL_M;
    let moving =
        MovingPoints::near(&surface.centre(), radius, views, &|frame| places_on(joints, frame));
    let hinges =
        joints.iter().filter(|j| j.joint.parent == 0 && j.joint.kind == JointKind::Revolute);
    let lines: Vec<JointGeometry> = hinges
        .map(|j| {
            let axis = UnitVector3::new_normalize(Vector3::from(j.joint.axis));
            JointGeometry::hinge(axis, Point3::from(j.joint.origin))
        })
        .collect();
    // The drawers of a cabinet slide in parallel.
    let axes = joints.iter().filter(|j| j.joint.parent == 0).map(|j| Vector3::from(j.joint.axis));
    let of_planes = || turning_near(surface, turning);
    let axes_of_planes = of_planes().map(|plane| plane.axis);
    let directions = axis_directions(surface, &views[surface.keyframe], axes, axes_of_planes);
    let lines_of_planes: Vec<JointGeometry> = of_planes()
        .map(|plane| JointGeometry::hinge(UnitVector3::new_normalize(plane.axis), plane.origin))
        .collect();
    tracing::debug!(
        points = surface.points.len(),
        radius = surface.radius(),
        centre = ?surface.centre().coords.as_slice(),
        keyframe = surface.keyframe,
        directions = directions.len(),
        "vacated surface at rest"
    );
    let hypotheses =
        best_hypotheses(surface, &directions, &lines, &lines_of_planes, &moving, MOST_ALIGNED);
    let slides: Vec<Vector3<f64>> = known_slides(joints).collect();
    best_part(surface, frame, &slides, &hypotheses, &moving, recording)
}

/// Planes near a surface that turned: the other faces of a part turn with it.
fn turning_near<'t>(
    surface: &RestSurface,
    turning: &'t [TurningPlane],
) -> impl Iterator<Item = &'t TurningPlane> {
    let (centre, radius) = (surface.centre(), PLANES_RADII * surface.radius());
    turning.iter().filter(move |t| (t.middle - centre).norm() < radius)
}

/// True if the joint is a hinge, or a slide parallel to a known slide. Images show what holds a hinge, but not what
/// holds a slide, and a person who steps aside slides as well; the drawers of a cabinet are parallel. (A slide is also
/// accepted if its surface closes an opening, see [`RestFrame::is_set_in`], if no hinge explains it and it is not in
/// the open, see [`VacatedPart::is_clearly_a_slide`], or if it keeps its direction, see
/// [`VacatedPart::keeps_direction`].)
fn may_be_of(joint: &Joint, joints: &[LearnedJoint]) -> bool {
    let axis = joint.axis.into();
    joint.kind == JointKind::Revolute
        || known_slides(joints).any(|slide| line_angle(&slide, &axis) < PARALLEL_RAD)
}

/// Directions of the base's known slides.
fn known_slides(joints: &[LearnedJoint]) -> impl Iterator<Item = Vector3<f64>> {
    let of_base = joints.iter().filter(|j| j.joint.parent == 0);
    of_base.filter(|j| j.joint.kind == JointKind::Prismatic).map(|j| j.joint.axis.into())
}

/// The part of a surface that explains most, if it is accepted. Where the surroundings close the surface in, hinges
/// that hardly turn do not compete with a slide: about a line far away the surface slides. `slides`: directions of
/// known slides.
fn best_part(
    surface: &RestSurface,
    frame: RestFrame,
    slides: &[Vector3<f64>],
    hypotheses: &[Hypothesis],
    moving: &[MovingPoints],
    recording: &Recording,
) -> Result<VacatedPart, Option<RejectedCandidate>> {
    let follow = |h: &Hypothesis, direction_sigma: f64| {
        VacatedPart::follow(surface, h, direction_sigma, moving, recording).on(frame.body)
    };
    let known = slides.iter().map(|slide| UnitVector3::new_normalize(*slide));
    let told: Vec<UnitVector3<f64>> = known.chain(surface.flat_normal()).collect();
    let square = hypotheses.par_iter().map(|h| match told.iter().find(|axis| is_along(h, axis)) {
        Some(axis) => {
            let mut along = *h;
            along.geometry.axis = *axis;
            (along, follow(&along, FRONT_RAD).along_known_direction())
        }
        None => (*h, follow(h, SQUARE_RAD)),
    });
    let square: Vec<(Hypothesis, VacatedPart)> = square.collect();
    let rivals = Rivals::of(square.iter().map(|(_, part)| part));
    let square: Vec<(Hypothesis, VacatedPart)> =
        square.into_iter().map(|(h, part)| (h, part.beside(&rivals, slides))).collect();
    square.iter().for_each(|(_, part)| part.trace());
    let may_slide = frame.is_closed()
        && square.iter().any(|(_, part)| is_slide(part) && part.doubt().is_none());
    let mut parts: Vec<(Hypothesis, VacatedPart)> =
        square.into_iter().filter(|(_, part)| !(may_slide && part.hardly_turns())).collect();
    let best = best_of(&parts).ok_or(None)?;
    let (hypothesis, square) = parts.swap_remove(best);
    let any = follow(&hypothesis, ANY_RAD).beside(&rivals, slides);
    any.trace();
    let is_any = value(&any) > BETTER * value(&square);
    let (best, sigma) = if is_any { (any, ANY_RAD) } else { (square, SQUARE_RAD) };
    let best = with_other_face(best, surface, |surface| {
        let part = VacatedPart::follow(surface, &hypothesis, sigma, moving, recording);
        part.on(frame.body).beside(&rivals, slides)
    });
    let rival = parts.iter().any(|(_, part)| part.contradicts(&best)).then_some(AMBIGUOUS);
    match best.doubt().or(rival) {
        None => Ok(best),
        Some(reason) => Err(Some(refused(best.geometry().kind, best.shown().count(), reason))),
    }
}

/// Index of the part of largest value. If that part is a slide, an accepted slide along a known direction that agrees
/// nearly as well is taken instead. The depth of a flat front hardly changes as it shifts in its plane, so its
/// agreement does not tell the direction.
fn best_of(parts: &[(Hypothesis, VacatedPart)]) -> Option<usize> {
    let value_of = |k: &usize| value(&parts[*k].1);
    let by_value = |a: &usize, b: &usize| value_of(a).total_cmp(&value_of(b));
    let best = (0..parts.len()).max_by(by_value)?;
    let is_as_good = |k: &usize| {
        let (part, best) = (&parts[*k].1, &parts[best].1);
        part.is_along_known_direction
            && is_slide(best)
            && part.agreement() >= SIMPLER * best.agreement()
            && (part.doubt().is_none() || best.doubt().is_some())
    };
    (0..parts.len()).filter(is_as_good).max_by(by_value).or(Some(best))
}

/// The part followed by both faces, if it shows its other face, as a lid that stands open does, and is accepted and
/// agrees better then; else the part as it was. What may as well slide does not turn, and has no other face to show.
fn with_other_face(
    part: VacatedPart,
    surface: &RestSurface,
    follow: impl Fn(&RestSurface) -> VacatedPart + Sync,
) -> VacatedPart {
    if !part.shows_other_face() || part.may_as_well_slide() {
        return part;
    }
    let follow = |thickness: &f64| follow(&surface.with_other_face(*thickness));
    let plates: Vec<VacatedPart> = THICKNESSES_M.par_iter().map(follow).collect();
    plates.iter().for_each(VacatedPart::trace);
    let believed = plates.into_iter().filter(|plate| plate.doubt().is_none());
    let best = believed.max_by(|a, b| value(a).total_cmp(&value(b)));
    best.filter(|plate| value(plate) > BETTER * value(&part)).unwrap_or(part)
}

/// Points on the known plain parts in a frame, base frame.
fn places_on(joints: &[LearnedJoint], frame: usize) -> Vec<Point3<f64>> {
    let of = |j: &LearnedJoint| {
        let pose = j.base_from_part[frame]?;
        Some(j.plain_surface.iter().map(move |p| pose * p).collect::<Vec<_>>())
    };
    joints.iter().filter_map(of).flatten().collect()
}

/// Agreement of a part, with the preference for simpler joints.
fn value(part: &VacatedPart) -> f64 {
    part.agreement() / if is_slide(part) || part.is_on_known_line { SIMPLER } else { 1.0 }
}

/// True if a hypothesis is a slide about along a direction.
fn is_along(hypothesis: &Hypothesis, direction: &UnitVector3<f64>) -> bool {
    hypothesis.geometry.kind == JointKind::Prismatic
        && line_angle(&hypothesis.geometry.axis, direction) < ALONG_RAD
}

/// True if the part's joint is a slide.
fn is_slide(part: &VacatedPart) -> bool {
    part.geometry().kind == JointKind::Prismatic
}

#[cfg(test)]
mod tests {
    use super::test_data::{
        FRAMES, PIVOT_M, TRAY_BOTTOM_M, bar_on_post, drawer, flap, lever,
        recording as recording_with, slider, swaying, tray, turn,
    };
    use super::*;

    fn joints(recording: &Recording) -> Vec<LearnedJoint> {
        complete(LearnedJoints::default(), recording).joints
    }

    #[test]
    fn a_plain_lever_is_learned_by_the_places_that_it_leaves() {
        let learned = joints(&lever(turn));
        assert_eq!(learned.len(), 1);
        let joint = &learned[0].joint;
        assert_eq!((joint.kind, joint.parent, joint.child), (JointKind::Revolute, 0, 1));
        let axis = Vector3::from(joint.axis);
        assert!(axis.z.abs() > 0.999);
        let off = distance_to_line(&joint.origin.into(), &axis, &Point3::from(PIVOT_M));
        // A reading is 9 mm from the next one in these pictures.
        assert!(off < 0.015, "{off} m off");
        assert!((joint.range[1] - joint.range[0] - 1.2).abs() < 0.05, "{:?}", joint.range);
        // The uncertainty is small, but not smaller than depth readings allow.
        let sigma = joint.known_covariance().unwrap().diagonal().map(f64::sqrt);
        assert!(sigma.max() > 0.003 && sigma.max() < 0.05, "{sigma}");
    }

    #[test]
    fn a_flap_is_followed_by_its_other_face_to_where_it_lies_open() {
        let open = |frame: usize| 1.9 * turn(frame);
        let learned = joints(&flap(open));
        let [flap] = &learned[..] else { panic!("{}", learned.len()) };
        assert!(Vector3::from(flap.joint.axis).x.abs() > 0.99);
        let [low, high] = flap.joint.range;
        assert!((high - low - open(FRAMES - 1)).abs() < 0.1, "{low} to {high}");
    }

    /// Joints that are added to a known slide along this direction.
    fn beside_a_slide(recording: &Recording, direction: [f64; 3]) -> Vec<LearnedJoint> {
        beside_a_moving_slide(recording, direction, |_| 0.0)
    }

    fn beside_a_moving_slide(
        recording: &Recording,
        direction: [f64; 3],
        way: impl Fn(usize) -> f64,
    ) -> Vec<LearnedJoint> {
        let axis = UnitVector3::new_normalize(Vector3::from(direction));
        let frames: Vec<usize> = (0..FRAMES).collect();
        let q: Vec<f64> = frames.iter().map(|f| way(*f)).collect();
        let slide = Joint::of(&JointGeometry::slide(axis, Point3::origin()));
        let known = LearnedJoint {
            joint: Joint { configuration: recording.tracks.timed(&frames, &q), ..slide },
            base_from_part: vec![None; FRAMES],
            tracks: Vec::new(),
            plain_surface: Vec::new(),
        };
        let known = LearnedJoints { joints: vec![known], ..Default::default() };
        complete(known, recording).joints.split_off(1)
    }

    #[test]
    fn the_inside_of_a_tray_that_is_hidden_until_it_is_pulled_is_the_trays() {
        let way = |frame: usize| 0.25 * turn(frame);
        let recording = tray(way);
        let slide = JointGeometry::slide(-Vector3::z_axis(), Point3::origin());
        let pose = |frame: usize| Some(slide.motion(way(frame)));
        let moved = |base_from_part: Vec<Option<Pose>>| LearnedJoint {
            joint: Joint::of(&slide),
            base_from_part,
            tracks: Vec::new(),
            plain_surface: Vec::new(),
        };
        let places = (0..60).map(|k| {
            let [right, behind] = [k % 10, k / 10].map(f64::from);
            Point3::new(-0.15 + 0.03 * right, TRAY_BOTTOM_M, 0.95 + 0.04 * behind)
        });
        let bottom = RestSurface {
            keyframe: FRAMES - 1,
            points: places.collect(),
            normals: vec![-Vector3::y(); 60],
            thickness: None,
        };
        let views = View::all(&recording);
        let is_its = |joint: &LearnedJoint| explains(joint, &bottom, &recording, &views);
        assert!(is_its(&moved((0..FRAMES).map(pose).collect())));
        let at_rest = |frame: usize| pose(frame).map(|_| Pose::identity());
        assert!(!is_its(&moved((0..FRAMES).map(at_rest).collect())), "it was not there before");
    }

    #[test]
    fn what_sways_is_no_part_though_the_places_that_it_leaves_show_one() {
        // It nods by half a centimetre while it rests.
        let nods = |frame: usize| 0.005 * f64::from(!(7..17).contains(&frame) && frame % 2 == 1);
        let recording = swaying(turn, nods);
        let views = View::all(&recording);
        let surface = vacated_surfaces(&views, End::First, |_| Vec::new()).remove(0);
        let frame = RestFrame::of(&surface, &views, &RoomShifts::of(End::First, &views));
        assert!(part_of(&surface, frame, &[], &[], &recording, &views).is_ok());
        assert!(joints(&recording).is_empty());
        assert_eq!(joints(&swaying(turn, |_| 0.0)).len(), 1);
    }

    #[test]
    fn what_hangs_on_a_body_that_sways_is_no_part() {
        let on_post =
            |sway_m: f64| bar_on_post(turn, move |f| sway_m * (0.8 * f as f64).sin(), |_| None);
        assert_eq!(joints(&on_post(0.0)).len(), 1);
        let found = complete(LearnedJoints::default(), &on_post(0.01));
        assert!(found.joints.is_empty());
        assert!(found.rejections.iter().any(|r| r.reason == LIMB), "{:?}", found.rejections);
    }

    #[test]
    fn a_surface_that_is_no_part_is_reported_with_its_reason() {
        let told = |recording: &Recording| {
            let all = complete(LearnedJoints::default(), recording).rejections;
            all.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
        };
        let aside = told(&slider(|frame| 0.25 * turn(frame)));
        // Both ends of the recording show it.
        assert_eq!(aside, "a plain revolute candidate (24 frames): nothing holds its line");
        assert_eq!(told(&lever(turn)), "", "it is a part");
    }

    #[test]
    fn a_plain_drawer_is_learned_where_another_slides_in_parallel() {
        let opened = slider(|frame| 0.25 * turn(frame));
        let found = beside_a_slide(&opened, [1.0, 0.02, 0.0]);
        assert_eq!(found.len(), 1);
        let joint = &found[0].joint;
        assert_eq!((joint.kind, joint.parent, joint.child), (JointKind::Prismatic, 0, 2));
        assert!(joint.axis[0].abs() > 0.999, "{:?}", joint.axis);
        assert!((joint.range[1] - joint.range[0] - 0.3).abs() < 0.02, "{:?}", joint.range);
        assert!(joints(&opened).is_empty(), "a person slides aside, too");
        assert!(beside_a_slide(&opened, [0.0, 1.0, 0.0]).is_empty());
        let with_it = |frame: usize| 0.3 * turn(frame);
        assert!(beside_a_moving_slide(&opened, [1.0, 0.0, 0.0], with_it).is_empty(), "a hand");
        let hardly = slider(|frame| 0.04 * turn(frame));
        assert!(beside_a_slide(&hardly, [1.0, 0.02, 0.0]).is_empty(), "it may as well turn");
    }

    #[test]
    fn a_plain_drawer_is_learned_alone_where_its_front_is_set_in_its_cabinet() {
        let learned = joints(&drawer(|frame| 0.25 * turn(frame), 0.2));
        assert_eq!(learned.len(), 1);
        let joint = &learned[0].joint;
        assert_eq!(joint.kind, JointKind::Prismatic);
        assert!(joint.axis[2].abs() > 0.999, "{:?}", joint.axis);
        assert!((joint.range[1] - joint.range[0] - 0.3).abs() < 0.02, "{:?}", joint.range);
        assert!(joints(&drawer(|frame| 0.25 * turn(frame), 0.0)).is_empty(), "nothing holds it");
    }

    #[test]
    fn of_two_slides_that_agree_alike_the_one_along_a_known_direction_is_taken() {
        let recording = drawer(|frame| 0.25 * turn(frame), 0.2);
        let views = View::all(&recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let moving = MovingPoints::near(&surface.centre(), 1.0, &views, &|_| Vec::new());
        let followed = |line: &JointGeometry| {
            let hypotheses = best_hypotheses(surface, &[], &[*line], &[], &moving, [1, 1]);
            let part = VacatedPart::follow(surface, &hypotheses[0], FRONT_RAD, &moving, &recording);
            (hypotheses[0], part)
        };
        let slide = JointGeometry::slide(Vector3::z_axis(), surface.centre());
        let along_known = |(h, part): (Hypothesis, VacatedPart)| (h, part.along_known_direction());
        // Of parts of equal value the last would be taken.
        assert_eq!(best_of(&[along_known(followed(&slide)), followed(&slide)]), Some(0));
        assert_eq!(best_of(&[followed(&slide), along_known(followed(&slide))]), Some(1));
        // Across its front it hardly agrees, whatever is known.
        let across = JointGeometry::slide(Vector3::x_axis(), surface.centre());
        assert_eq!(best_of(&[along_known(followed(&across)), followed(&slide)]), Some(1));
        assert_eq!(best_of(&[]), None);
    }

    #[test]
    fn a_direction_that_planes_near_a_surface_tell_is_tried_although_it_is_askew() {
        let recording = lever(turn);
        let views = View::all(&recording);
        let surface = &vacated_surfaces(&views, End::First, |_| Vec::new())[0];
        let askew = Vector3::new(0.1, 0.0, 1.0).normalize();
        let at = |middle| [TurningPlane { axis: askew, origin: middle, middle }];
        let tried = |turning: &[TurningPlane]| {
            let of_planes = turning_near(surface, turning).map(|plane| plane.axis);
            axis_directions(surface, &views[surface.keyframe], std::iter::empty(), of_planes)
        };
        let is_tried = |turning: &[TurningPlane]| tried(turning).contains(&askew);
        assert!(is_tried(&at(surface.centre() + Vector3::new(0.0, 0.1, 0.0))));
        assert!(!is_tried(&at(surface.centre() + Vector3::new(0.0, 1.0, 0.0))), "a person");
    }

    #[test]
    fn a_lever_that_stays_is_no_joint() {
        assert!(joints(&lever(|_| 0.4)).is_empty());
    }

    #[test]
    fn what_moves_together_with_something_else_from_the_first_is_a_limb() {
        // The block leaves when the bar begins to turn, as a forearm does with its upper arm.
        let together = |frame: usize| Some([0.22, -0.25 + 0.25 * turn(frame)]);
        assert!(joints(&recording_with(turn, together)).is_empty());
        // What hangs on a post is no limb, however early something moves beside it.
        assert_eq!(joints(&bar_on_post(turn, |_| 0.0, together)).len(), 1);
    }

    #[test]
    fn what_moves_after_something_came_to_it_is_a_part() {
        let comes = |frame: usize| Some([0.35 - 0.03 * frame.min(5) as f64, -0.2]);
        assert_eq!(joints(&recording_with(turn, comes)).len(), 1);
    }

    #[test]
    fn what_slides_on_the_track_of_a_known_slide_is_its_part_and_the_next_drawer_is_not() {
        let slide = |origin: [f64; 3]| {
            Joint::of(&JointGeometry::slide(Vector3::y_axis(), Point3::from(origin)))
        };
        let known = slide([0.0, 0.2, 1.7]);
        assert!(is_about_one_line(&known, &slide([0.01, -0.11, 1.7])), "a shutter, further up");
        assert!(!is_about_one_line(&known, &slide([0.15, 0.2, 1.7])), "the next drawer");
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.0, 0.0, 1.7));
        assert!(!is_about_one_line(&known, &Joint::of(&hinge)));
    }

    #[test]
    fn drawers_on_one_line_that_are_pulled_in_turn_are_two_parts() {
        let slide = JointGeometry::slide(Vector3::z_axis(), Point3::origin());
        let pulled = |times: std::ops::Range<usize>| {
            let q = |k: usize| if times.contains(&k) { 0.2 } else { 0.0 };
            let configuration = (0..20).map(|k| [k as f64, q(k)]).collect();
            LearnedJoint {
                joint: Joint { configuration, ..Joint::of(&slide) },
                base_from_part: Vec::new(),
                tracks: Vec::new(),
                plain_surface: Vec::new(),
            }
        };
        let added = |new: LearnedJoint| {
            let mut joints = vec![pulled(3..9)];
            add(new, &mut joints);
            joints.len()
        };
        assert_eq!(added(pulled(11..17)), 2);
        // Together with the other one it is known only at rest, to 2 mm.
        let mut at_rest = pulled(11..17);
        at_rest.joint.configuration.truncate(10);
        at_rest.joint.configuration.iter_mut().for_each(|q| q[1] = 0.002 * (q[0] % 2.0));
        at_rest.joint.configuration.push([30.0, 0.2]);
        assert_eq!(added(at_rest), 1, "noise is no motion");
        assert_eq!(added(pulled(3..20)), 1, "it is never away without the other one");
    }

    #[test]
    fn doors_above_each_other_on_one_line_are_two_parts() {
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.0, 0.0, 1.7));
        let door = |places: [f64; 2], opens: usize| {
            let at = |k: usize| places[0] + (places[1] - places[0]) * k as f64 / 19.0;
            let opened = |k: usize| if k.abs_diff(opens) < 4 { 0.9 } else { 0.0 };
            let configuration = (0..20).map(|k| [k as f64, opened(k)]).collect();
            LearnedJoint {
                joint: Joint { configuration, ..Joint::of(&line) },
                base_from_part: Vec::new(),
                tracks: Vec::new(),
                plain_surface: (0..20).map(|k| Point3::new(0.2, at(k), 1.7)).collect(),
            }
        };
        let upper = door([-0.5, -0.02], 5);
        assert!(are_beside_each_other(&upper, &door([0.02, 0.5], 14)));
        assert!(!are_beside_each_other(&upper, &door([-0.3, 0.5], 14)), "not clearly apart");
        assert!(!are_beside_each_other(&upper, &door([0.02, 0.5], 5)), "they turn together");
    }

    #[test]
    fn what_turns_about_the_line_of_a_known_joint_is_its_part() {
        let recording = lever(turn);
        let mut known = joints(&recording);
        // Without poses the known joint explains nothing.
        known[0].base_from_part = vec![None; known[0].base_from_part.len()];
        known[0].joint.origin[0] += 0.02;
        let again = complete(LearnedJoints { joints: known, ..Default::default() }, &recording);
        assert_eq!(again.joints.len(), 1);
    }

    #[test]
    fn the_other_face_of_a_lid_takes_the_place_of_the_first_where_it_is_shown_much_more() {
        let recording = lever(turn);
        let whole = joints(&recording).remove(0);
        let other_face = |shown: usize| {
            let mut face = whole.clone();
            face.joint.name = "joint1".into();
            face.joint.origin[0] += 0.1;
            face.joint.configuration.truncate(shown);
            face
        };
        for (shown, is_replaced) in [(FRAMES / 2, true), (FRAMES - 2, false)] {
            let mut joints = vec![other_face(shown)];
            add(whole.clone(), &mut joints);
            assert_eq!(joints.len(), 1, "one lid is one joint");
            assert_eq!(joints[0].joint.configuration.len() > shown, is_replaced);
            assert_eq!(joints[0].joint.name, "joint1");
        }
    }

    #[test]
    fn a_part_that_is_known_is_not_found_again() {
        let recording = lever(turn);
        let known = joints(&recording);
        let again = complete(LearnedJoints { joints: known, ..Default::default() }, &recording);
        assert_eq!(again.joints.len(), 1);
    }
}
