//! The search for an object in the room in which it was learned: most objects stay where they are, and a white door
//! has few features where the wall beside it has many.
//!
//! In: a refiner with the object's shape, and matches of the object's base and of its room.
//! Out: a [`Detection`]. The room determines where to search; only the object's own surface determines whether it is
//! there, and its configurations.

use super::ambiguity::told_by_surface;
use super::evidence::{Detection, RefinedPose, is_believed};
use super::hypothesis::{self, Hypothesis, agrees};
use super::kinematics::State;
use super::matching::Match;
use super::refine::Refiner;
use super::render_cloud::Cloud;
use super::shape::{Contours, EndsInSight, ends_in_sight};
use super::verdict::{PartVerdict, Verdict};
use super::verify::{likeness_in_any_light, verify};
use nalgebra::{Point3, Vector3};

/// Smallest number of places of the room and of the base whose matches must agree.
const LEAST_MATCHES: usize = 12;
/// Smallest standard deviation of the places of the matches that agree, metres: matches on one poster or box, which
/// may be elsewhere now, lie closer together.
const LEAST_SPREAD_M: f64 = 0.25;
/// Largest number of hypotheses of the room that are refined: a wall whose pattern repeats agrees at several places,
/// and the object stands at one of them.
const HYPOTHESES: usize = 6;
/// Largest distance of the object from the place that its room gives, metres. Of 96 encounters, things in their own
/// room had moved by up to 4 cm and things before the same wall in another room by up to 10, while a cabinet that
/// stood 20 or 31 cm from where another one was learned was taken for that one.
const FARTHEST_MOVED_M: f64 = 0.12;
/// Largest rotation of the object from the pose that its room gives, radians. Things that were found rightly had
/// turned by up to 0.10; a cabinet of which little more than its door was seen had turned by 0.40 about the hinge,
/// so that its door was reported 0.40 too far open.
const FARTHEST_TURNED_RAD: f64 = 0.2;
/// Smallest number of visible contour points that decide whether the moving parts are there.
const ENOUGH_ENDS: usize = 12;
/// Share of visible contour points confirmed by the image: score 0 at the first value, 1 at the second.
const FOUND: (f64, f64) = (0.2, 0.45);

/// With n confirmed contour points the evidence is 1 - exp(-n / ENDS).
const ENDS: f64 = 15.0;

/// Detection of the object where its room puts it; `None` if it is not certain. `matches`: those of the room and of
/// the object's own base.
pub fn find(
    refiner: &Refiner,
    contours: Contours,
    matches: &[Match],
    seed: u64,
) -> Option<Detection> {
    let refined = base_hypotheses(refiner, matches, seed).filter_map(|(hypothesis, room)| {
        let in_room = Refiner { room: &room, ..*refiner };
        refined(&in_room, contours, &hypothesis).map(|refined| (refined, room))
    });
    let (best, room) = refined.max_by(|a, b| a.0.score.total_cmp(&b.0.score))?;
    let found = decide(&Refiner { room: &room, ..*refiner }, contours, best);
    let is_certain = is_believed(found.score, refiner.config) && found.evident.contains(&true);
    is_certain.then_some(found)
}

/// Hypotheses of where the room puts the base, most support first, each with the matches that agree with it.
pub fn base_hypotheses(
    refiner: &Refiner,
    matches: &[Match],
    seed: u64,
) -> impl Iterator<Item = (Hypothesis, Vec<Match>)> {
    let hypotheses = hypothesis::all(refiner.articulated, matches, seed);
    let of_room = hypotheses.into_iter().filter(|h| h.part == 0);
    let told = of_room.filter_map(|h| agreeing(refiner, matches, &h).map(|room| (h, room)));
    told.take(HYPOTHESES)
}

/// Matches that agree with a hypothesis; `None` if they are few, or lie close together, as on one poster.
fn agreeing(refiner: &Refiner, matches: &[Match], hypothesis: &Hypothesis) -> Option<Vec<Match>> {
    let base = refiner.articulated.matrices(&hypothesis.state)[0];
    let agreeing: Vec<Match> =
        matches.iter().filter(|m| m.part == 0 && agrees(m, &base, 1.0)).cloned().collect();
    let places: Vec<Point3<f64>> = agreeing.iter().map(|m| m.model_point).collect();
    let is_told =
        hypothesis::places(agreeing.iter()) >= LEAST_MATCHES && spread(&places) >= LEAST_SPREAD_M;
    is_told.then_some(agreeing)
}

/// Standard deviation of places about their mean, metres.
fn spread(places: &[Point3<f64>]) -> f64 {
    let count = places.len().max(1) as f64;
    let middle = Point3::from(places.iter().fold(Vector3::zeros(), |a, p| a + p.coords) / count);
    (places.iter().map(|p| (p - middle).norm_squared()).sum::<f64>() / count).sqrt()
}

/// State that the room leads to, and its comparison with the image; `None` if the object is too far from where the
/// room puts it.
fn refined(refiner: &Refiner, contours: Contours, hypothesis: &Hypothesis) -> Option<RefinedPose> {
    let Refiner { scene, articulated, cloud, room, .. } = *refiner;
    let state = refiner.settle(hypothesis)?;
    let of_room = &hypothesis.state;
    let moved_m = moved_by(cloud, of_room, &state);
    let [was, is] = [of_room, &state].map(|s| s.camera_from_object.rotation);
    let turned_rad = was.angle_to(&is);
    tracing::debug!(moved_m, turned_rad, "moved from where its room says");
    if moved_m > FARTHEST_MOVED_M || turned_rad > FARTHEST_TURNED_RAD {
        return None;
    }
    let verdict = verify(scene, articulated, cloud, &state);
    let in_sight = ends_in_sight(scene, articulated, cloud, contours.shape, &state);
    let placed = placed_in_room(&verdict, &in_sight);
    let likeness = likeness_in_any_light(scene, articulated, cloud, &state);
    let score = room_score(&verdict, likeness, &in_sight, &placed);
    let inliers = hypothesis::places(room.iter());
    let (support, q) = (hypothesis.support, &state.q);
    tracing::debug!(support, score, ?q, ?placed, ?in_sight, ?verdict, "refined in its room");
    Some(RefinedPose { state, score, inliers, verdict })
}

/// Distance between the centres of the object's surface in two states, by the pose of the base alone, metres.
fn moved_by(cloud: &Cloud, from: &State, to: &State) -> f64 {
    let all = cloud.surfels.iter().fold(Vector3::zeros(), |sum, s| sum + s.point.coords);
    let middle = Point3::from(all / cloud.surfels.len().max(1) as f64);
    (from.camera_from_object * middle - to.camera_from_object * middle).norm()
}

/// Decides which configurations of a state are determined: the room fixes the base, and each part that stands where
/// the state puts it determines its configuration, unless it could as well be elsewhere.
fn decide(refiner: &Refiner, contours: Contours, refined: RefinedPose) -> Detection {
    let Refiner { scene, articulated, cloud, .. } = *refiner;
    let in_sight = ends_in_sight(scene, articulated, cloud, contours.shape, &refined.state);
    let placed = placed_in_room(&refined.verdict, &in_sight);
    told_by_surface(refiner, refined, placed)
}

/// For each part, true if it is where the state puts it: the base by its room, the others by surface and contour.
fn placed_in_room(verdict: &Verdict, in_sight: &[EndsInSight]) -> Vec<bool> {
    let is_placed = |(part, (seen, ends)): (usize, (&PartVerdict, &EndsInSight))| {
        part == 0 || seen.stands() && (ends.count() < ENOUGH_ENDS || ends.share() > FOUND.0)
    };
    verdict.parts.iter().zip(in_sight).enumerate().map(is_placed).collect()
}

/// Score of the object's own surface where the room puts it, 0 to 1: colour and texture, free space, edges, coverage
/// and contour. Another object of its size may stand in its place: a washing machine where a kitchen unit was, both
/// white.
fn room_score(verdict: &Verdict, likeness: f64, in_sight: &[EndsInSight], placed: &[bool]) -> f64 {
    let ends = share_of_ends(in_sight.get(1..).unwrap_or_default());
    let base_known = placed.iter().skip(1).any(|placed| *placed);
    // Another wall may have the same pattern: some contour of the object must be confirmed.
    let found = in_sight.iter().zip(placed).filter(|p| *p.1).map(|(ends, _)| ends.found);
    let evidence = 1.0 - (-(found.sum::<usize>() as f64) / ENDS).exp();
    likeness
        * verdict.own_texture()
        * verdict.free_space_of_shape(base_known)
        * verdict.end_share()
        * verdict.coverage(base_known)
        * ends
        * evidence
}

/// Score of the contours of the moving parts, 0 to 1, of all parts together: a closed drawer has few contour points,
/// and the image may confirm none of them.
fn share_of_ends(moving: &[EndsInSight]) -> f64 {
    let of = |count: fn(&EndsInSight) -> usize| moving.iter().map(count).sum::<usize>();
    let (found, all) = (of(|ends| ends.found), of(EndsInSight::count));
    if all < ENOUGH_ENDS {
        return 1.0;
    }
    ((found as f64 / all as f64 - FOUND.0) / (FOUND.1 - FOUND.0)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::recognise::shape::test_data::{WALL_M, look_for_plain_slider};
    use nalgebra::Rotation3;

    /// Matches of a wall that are so far from one to the next, metres, when the slider's frame is the
    /// camera's but for this shift in x.
    fn of_wall(step: f64, shift: f64) -> Vec<Match> {
        let places = (0..30).map(|i| (f64::from(i % 6) - 2.5, f64::from(i / 6) - 2.0));
        let matched = |(x, y): (f64, f64)| {
            let seen = Point3::new(step * x, step * y, WALL_M);
            let focal_px = 525.0 / WALL_M;
            Match {
                part: 0,
                model_point: seen - Vector3::new(shift, 0.0, 0.0),
                model_normal: -Vector3::z(),
                pixel: [seen.x, seen.y].map(|x| (focal_px * x) as f32),
                seen_point: Some(seen),
                seen_normal: -Vector3::z(),
                tolerance: 0.03,
                distance: 0.1,
                ratio: 0.5,
            }
        };
        places.map(matched).collect()
    }

    fn found(half: Option<f64>, matches: &[Match]) -> Option<Detection> {
        look_for_plain_slider(half, 0.06, |refiner, contours| find(refiner, contours, matches, 1))
    }

    #[test]
    fn a_plain_thing_stands_where_its_room_says_and_tells_its_configuration_itself() {
        let found = found(Some(0.2), &of_wall(0.2, 0.0)).unwrap();
        assert!((found.state.q[0] - 0.06).abs() < 0.015, "{:?}", found.state.q);
        assert_eq!(found.evident, [true]);
    }

    #[test]
    fn what_was_pushed_a_little_is_found_where_it_stands_now() {
        let found = found(Some(0.2), &of_wall(0.2, 0.03)).unwrap();
        let shift = found.state.camera_from_object.translation.vector.norm();
        assert!(shift < 0.02, "{shift} m");
    }

    #[test]
    fn what_stands_elsewhere_in_its_room_is_another_thing_of_its_shape() {
        let state = |z| State { camera_from_object: Pose::translation(0.0, 0.0, z), q: vec![0.0] };
        let moved = |z| {
            look_for_plain_slider(Some(0.2), 0.06, |refiner, _| {
                moved_by(refiner.cloud, &state(0.0), &state(z))
            })
        };
        assert!((moved(0.2) - 0.2).abs() < 1e-9);
        // The wall puts the slider farther away than it is.
        let farther: Vec<Match> = of_wall(0.2, 0.0)
            .into_iter()
            .map(|m| Match { model_point: m.model_point - 0.2 * Vector3::z(), ..m })
            .collect();
        assert!(found(Some(0.2), &farther).is_none());
    }

    #[test]
    fn what_is_turned_far_from_where_its_room_says_tells_nothing() {
        // The wall puts the slider rotated about its middle, which it is not.
        let turned = |turn: f64| -> Vec<Match> {
            let middle = Vector3::new(0.0, 0.0, 1.5);
            let about = Rotation3::from_axis_angle(&Vector3::y_axis(), turn);
            let about_middle = |p: Point3<f64>| Point3::from(about * (p.coords - middle) + middle);
            let turned = |m: Match| Match {
                model_point: about_middle(m.model_point),
                model_normal: about * m.model_normal,
                ..m
            };
            of_wall(0.2, 0.0).into_iter().map(turned).collect()
        };
        assert!(found(Some(0.2), &turned(0.02)).is_some());
        assert!(found(Some(0.2), &turned(0.35)).is_none());
    }

    #[test]
    fn a_room_from_which_the_thing_is_gone_does_not_tell_it() {
        assert!(found(None, &of_wall(0.2, 0.0)).is_none());
        // Another thing stands there.
        assert!(found(Some(0.08), &of_wall(0.2, 0.0)).is_none());
    }

    #[test]
    fn another_thing_of_its_size_in_its_place_has_another_texture() {
        let score = |correlation| {
            let base = PartVerdict { agree: 300, alike: 300, ..PartVerdict::default() };
            let door = PartVerdict { correlation: Some(correlation), texture: 0.6, ..base };
            let verdict = Verdict {
                judged: 600,
                agree: 600,
                agree_normal: 600,
                parts: vec![base, door],
                ..Verdict::default()
            };
            let ends = EndsInSight { found: 40, missing: 10, ..EndsInSight::default() };
            room_score(&verdict, 0.9, &[ends, ends], &[true, true])
        };
        assert!(score(0.5) > 0.7 && score(0.0) < 0.4, "{} {}", score(0.5), score(0.0));
    }

    #[test]
    fn one_poster_or_few_matches_are_no_room() {
        assert!(found(Some(0.2), &of_wall(0.05, 0.0)).is_none());
        assert!(found(Some(0.2), &of_wall(0.2, 0.0)[..LEAST_MATCHES - 1]).is_none());
    }
}
