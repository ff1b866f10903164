//! The search for an object by its shape, for plain objects.
//!
//! In: a refiner with the object's shape and without matches.
//! Out: a [`Detection`]; `None` unless a moving part shows where it ends and both sides of a joint are seen: a plain
//! board alone is like many others.
//! From: ours; the limits were chosen on demonstrations and encounters of ten plain things (doors, drawers, lids, a
//! chair) with about 380 wrong pairs, of which none is reported.

use super::ambiguity::told_by_surface;
use super::evidence::{Detection, RefinedPose, evident_joints, is_believed};
use super::hypothesis::Hypothesis;
use super::normal_equations::System;
use super::refine::Refiner;
use super::shape::{Contours, EndsInSight, ends_in_sight, shape_hypotheses};
use super::verdict::{PartVerdict, Verdict};
use super::verify::verify;

/// Smallest score of an object that is found by shape alone.
const LEAST_SCORE: f64 = 0.5;
/// Largest number of hypotheses by shape that are refined.
const HYPOTHESES: usize = 8;
/// Smallest number of visible contour points of a part that decide whether the part is there. A part with fewer is not
/// placed: any surface agrees with it.
const ENOUGH_ENDS: usize = 12;
/// Share of visible contour points confirmed by the image: score 0 at the first value, 1 at the second.
const FOUND: (f64, f64) = (0.65, 0.9);
/// Smallest share of the base's contour points in sight that the image confirms.
const FOUND_OF_BASE: f64 = 0.5;
/// Number of confirmed contour points, and their share of those in sight, by which a part that hardly shows a surface
/// is where the state puts it: an open door that the camera sees from its edge.
const EDGE_ON: (usize, f64) = (20, 0.85);
/// With n confirmed contour points the evidence is 1 - exp(-n / ENDS).
const ENDS: f64 = 25.0;
/// Largest standard deviation of a pose that the shape determines: rotation in radians, translation in metres.
const TOLD: (f64, f64) = (0.03, 0.012);

/// What is found by shape.
pub struct FoundByShape {
    /// Detection of the object.
    pub detection: Detection,
    /// How much of the image it explains: surfels and contour points, weighted by the score and the number of placed
    /// parts. Of two objects of about one shape in one place, the one that explains more is there.
    pub explained: f64,
}

/// Detection of the object by the contours of its parts; `None` if it is not certain.
pub fn find(refiner: &Refiner, contours: Contours) -> Option<FoundByShape> {
    let (explained, best) = best(refiner, contours)?;
    let found = decide(refiner, contours, best);
    let is_certain = found.score > LEAST_SCORE
        && is_believed(found.score, refiner.config)
        && found.evident.contains(&true);
    is_certain.then_some(FoundByShape { detection: found, explained })
}

/// Best state that the contours of the parts lead to. A state that places parts on both sides of a joint is preferred:
/// a board alone fits any other board, as a door fits the side of its own cabinet, and determines no configuration.
fn best(refiner: &Refiner, contours: Contours) -> Option<(f64, RefinedPose)> {
    let Refiner { scene, articulated, cloud, .. } = *refiner;
    let mut hypotheses = shape_hypotheses(scene, contours.seen, articulated, contours.shape);
    hypotheses.truncate(HYPOTHESES);
    let refined = |hypothesis: &Hypothesis| {
        let state = refiner.settle(hypothesis)?;
        let verdict = verify(scene, articulated, cloud, &state);
        let in_sight = ends_in_sight(scene, articulated, cloud, contours.shape, &state);
        let placed = placed_by_shape(&verdict, &in_sight);
        let score = shape_score(&verdict, &in_sight, &placed, &refiner.system(&state));
        let (part, support) = (hypothesis.part, hypothesis.support);
        tracing::debug!(part, support, score, ?in_sight, q = ?state.q, ?verdict, "refined by shape");
        // A board fits another one in several poses: the one that places more parts is preferred.
        let parts = placed.iter().filter(|placed| **placed).count() as f64;
        let ends: f64 = in_sight.iter().map(|ends| ends.closeness - ends.missing as f64).sum();
        let explained = score * parts * (verdict.fit_of_shape() + ends).max(0.0);
        let places_both_sides = evident_joints(articulated, &placed).contains(&true);
        let rank = (places_both_sides && score > 0.0, explained);
        Some((rank, RefinedPose { state, score, inliers: 0, verdict }))
    };
    let all = hypotheses.iter().filter_map(refined);
    let best =
        all.max_by(|((both_a, a), _), ((both_b, b), _)| both_a.cmp(both_b).then(a.total_cmp(b)));
    best.map(|((_, explained), best)| (explained, best))
}

/// Decides which configurations of a state found by shape are determined: a part that stands fixes its place,
/// whatever its texture, unless it could as well be elsewhere.
fn decide(refiner: &Refiner, contours: Contours, refined: RefinedPose) -> Detection {
    let Refiner { scene, articulated, cloud, .. } = *refiner;
    let in_sight = ends_in_sight(scene, articulated, cloud, contours.shape, &refined.state);
    let placed = placed_by_shape(&refined.verdict, &in_sight);
    told_by_surface(refiner, refined, placed)
}

/// For each part, true if it stands and ends where the state puts it, on all of its sides. Of a texture only one that
/// is contrary to the learned one counts, and of a colour only one that most of a moving part has: other light changes
/// the rest. Of the base, half of the ends suffice, since what stood beside it is learned with it.
pub fn placed_by_shape(verdict: &Verdict, in_sight: &[EndsInSight]) -> Vec<bool> {
    let ends_there =
        |ends: &EndsInSight, least: f64| ends.count() >= ENOUGH_ENDS && ends.share() > least;
    let base_holds = verdict.parts[0].holds()
        && verdict.parts[0].through <= verdict.parts[0].agree
        && ends_there(&in_sight[0], FOUND_OF_BASE);
    let is_placed = |(part, (seen, ends)): (usize, (&PartVerdict, &EndsInSight))| {
        if part == 0 {
            return base_holds;
        }
        let is_there = ends_there(ends, FOUND.0) && ends.other_sides == 0;
        let is_alike = 2 * seen.alike >= seen.agree;
        seen.stands() && is_alike && !seen.is_unlike() && is_there
            || base_holds && is_edge_on(seen, ends)
    };
    verdict.parts.iter().zip(in_sight).enumerate().map(is_placed).collect()
}

/// True if hardly any surface of a part is in sight, its colour is not contrary to the learned one, and the image
/// confirms its contour.
fn is_edge_on(seen: &PartVerdict, ends: &EndsInSight) -> bool {
    let is_there = ends.found >= EDGE_ON.0 && ends.share() > EDGE_ON.1 && ends.other_sides == 0;
    seen.hardly_shows() && !seen.is_unlike() && is_there
}

/// Score of a state by shape alone, 0 to 1: colour of the surface, free space, edges, contours of the moving parts,
/// and number of their confirmed contour points. 0 if the image does not determine the pose: a board whose ends are
/// occluded slides in its plane.
fn shape_score(
    verdict: &Verdict,
    in_sight: &[EndsInSight],
    placed: &[bool],
    system: &System,
) -> f64 {
    let told = |(k, deviation): (usize, &Option<f64>)| {
        deviation.is_some_and(|d| d < if k < 3 { TOLD.0 } else { TOLD.1 })
    };
    if !system.pose_deviations().iter().enumerate().all(told) {
        return 0.0;
    }
    // Contour points of the base may refute it, but are no evidence: a base is a box like many others.
    let moving = || in_sight.iter().skip(1);
    let found =
        moving().zip(&placed[1..]).filter(|m| *m.1).map(|(ends, _)| ends.found).sum::<usize>();
    let ends = share_of_ends(moving());
    let evidence = 1.0 - (-(found as f64) / ENDS).exp();
    let base_known = placed[0] && placed.iter().skip(1).any(|placed| *placed);
    verdict.likeness()
        * verdict.free_space_of_shape(base_known)
        * verdict.end_share()
        * verdict.coverage(base_known)
        * ends
        * evidence
}

/// Score of the contours of the moving parts, 0 to 1: of all parts together, but 0 if one of them does not fit. A
/// handle or a hand occludes some contour points of each part; the more parts fit, the more certain the score is.
fn share_of_ends<'e>(moving: impl Iterator<Item = &'e EndsInSight>) -> f64 {
    let judged: Vec<&EndsInSight> = moving.filter(|ends| ends.count() >= ENOUGH_ENDS).collect();
    if judged.is_empty() {
        return 1.0;
    }
    if judged.iter().any(|ends| ends.share() <= FOUND.0 || ends.other_sides > 0) {
        return 0.0;
    }
    let of = |count: fn(&EndsInSight) -> usize| judged.iter().map(|e| count(e)).sum::<usize>();
    let share = of(|ends| ends.found) as f64 / of(EndsInSight::count) as f64;
    ((share - FOUND.0) / (FOUND.1 - FOUND.0)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::recognise::shape::test_data::look_for_plain_slider;

    #[test]
    fn a_plain_thing_lies_where_its_parts_end() {
        let (_, best) = look_for_plain_slider(Some(0.2), 0.06, |refiner, contours| {
            best(refiner, contours).unwrap()
        });
        let pose = best.state.camera_from_object;
        assert!(best.score > LEAST_SCORE);
        // A pixel is half a centimetre wide there.
        assert!((best.state.q[0] - 0.06).abs() < 0.015, "{:?}", best.state.q);
        assert!(pose.translation.vector.norm() < 0.015 && pose.rotation.angle() < 0.02);
        assert_ne!(pose, Pose::identity());
    }

    #[test]
    fn a_plate_whose_ends_do_not_tell_its_place_tells_no_configuration() {
        // Within the gate for ends the plate could as well be two centimetres beside.
        assert!(look_for_plain_slider(Some(0.2), 0.06, find).is_none());
    }

    #[test]
    fn a_door_seen_from_its_edge_is_placed_by_its_contour_where_the_base_stands() {
        let ends = |found, missing| EndsInSight { found, missing, ..EndsInSight::default() };
        let of = |agree, through| PartVerdict { agree, through, ..PartVerdict::default() };
        let is_placed = |base: PartVerdict, door: PartVerdict, ends_of_door: EndsInSight| {
            let verdict = Verdict { parts: vec![base, door], ..Verdict::default() };
            placed_by_shape(&verdict, &[ends(100, 0), ends_of_door])[1]
        };
        assert!(is_placed(of(500, 0), of(10, 0), ends(30, 1)));
        assert!(!is_placed(of(0, 500), of(10, 0), ends(30, 1)), "no base");
        assert!(!is_placed(of(500, 0), of(10, 0), ends(15, 0)), "too few ends");
        assert!(!is_placed(of(500, 0), of(10, 0), ends(30, 20)), "it ends elsewhere");
        assert!(!is_placed(of(500, 0), of(10, 40), ends(30, 1)), "it is seen through");
        assert!(!is_placed(of(500, 0), of(400, 300), ends(30, 1)), "much of it is seen through");
        let other_side = EndsInSight { other_sides: 1, ..ends(30, 1) };
        assert!(!is_placed(of(500, 0), of(10, 0), other_side), "it is longer");
        let unlike = PartVerdict { texture: 1.0, correlation: Some(-0.6), ..of(10, 0) };
        assert!(!is_placed(of(500, 0), unlike, ends(30, 1)), "another texture");
    }

    #[test]
    fn a_base_is_placed_unless_it_is_seen_through_or_ends_elsewhere() {
        let ends = |found, missing| EndsInSight { found, missing, ..EndsInSight::default() };
        let is_placed = |agree, through, ends_of_base| {
            let base = PartVerdict { agree, through, ..PartVerdict::default() };
            let verdict = Verdict { parts: vec![base], ..Verdict::default() };
            placed_by_shape(&verdict, &[ends_of_base])[0]
        };
        assert!(is_placed(500, 0, ends(60, 30)));
        assert!(!is_placed(500, 0, ends(30, 60)), "it ends elsewhere");
        assert!(!is_placed(500, 0, ends(8, 0)), "hardly any end is in sight");
        assert!(!is_placed(100, 300, ends(60, 0)), "most of it is seen through");
    }

    #[test]
    fn ends_of_all_moving_parts_count_together_but_each_must_be_there() {
        let share = |ends: &[(usize, usize)]| {
            let ends: Vec<EndsInSight> = ends
                .iter()
                .map(|&(found, missing)| EndsInSight { found, missing, ..EndsInSight::default() })
                .collect();
            share_of_ends(ends.iter())
        };
        assert!(share(&[(87, 11), (73, 15)]) > share(&[(73, 15)]));
        assert_eq!(share(&[(90, 0), (10, 10)]), 0.0);
        assert_eq!(share(&[(90, 0), (1, 10)]), 1.0, "few ends decide nothing");
        let longer = EndsInSight { found: 90, other_sides: 1, ..EndsInSight::default() };
        assert_eq!(share_of_ends([longer].iter()), 0.0);
    }

    #[test]
    fn a_board_of_another_height_is_another_thing() {
        for half in [0.26, 0.13] {
            let best = look_for_plain_slider(Some(half), 0.06, best);
            assert!(best.is_none_or(|(_, best)| best.score < LEAST_SCORE));
        }
    }
}
