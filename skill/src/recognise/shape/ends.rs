//! Test whether the surface in the image ends where a contour predicts: quickly by the contour of the image, for the
//! many poses of the search, and by the depth image itself, for verification.
//!
//! In: a contour point and the pose of its part (camera frame, metres), or a whole state.
//! Out: confirmed, not confirmed or not visible; by part, the number of each.

use super::super::kinematics::{Articulated, State};
use super::super::render_cloud::{Cloud, DepthBuffer, visible};
use super::super::scene::Scene;
use super::contour::ContourPoint;
use super::contour_grid::{ContourGrid, gate};
use super::end_profile::{SeenEnd, pixel_of, seen_end};
use super::object_shape::ObjectShape;
use nalgebra::IsometryMatrix3;
use std::collections::HashMap;

/// Smallest distance before a contour point at which a reading occludes it, metres.
const HIDDEN_M: f64 = 0.05;
/// Largest distance of a confirmed end from the learned one, metres, however far away it is.
const FARTHEST_M: f64 = 0.03;
/// Smallest number of visible points of a side that decide whether it is there.
const ENOUGH_OF_SIDE: usize = 8;
/// Largest share of a side's visible points that are confirmed where the part ends elsewhere.
const OTHER_SIDE: f64 = 0.25;
/// Distance from an end at which another part of the object may be beside it, metres.
const BESIDE_M: f64 = 0.03;

/// True if the surface in the image ends as a contour point predicts; `None` if the point is not visible.
pub fn ends(
    scene: &Scene,
    seen: &ContourGrid,
    pose: &IsometryMatrix3<f64>,
    c: &ContourPoint,
) -> Option<bool> {
    let (point, normal) = (pose * c.point, pose * c.normal);
    let (u, v) = pixel_of(scene, &point, &normal)?;
    let z = f64::from(scene.frame.depth.at(u, v)?);
    if seen.has(&point, &normal, &(pose * c.outward)) {
        return Some(true);
    }
    (z > point.z - HIDDEN_M).then_some(false)
}

/// Visible contour points of a part, counted by whether the image confirms them.
#[derive(Debug, Clone, Copy, Default)]
pub struct EndsInSight {
    /// Number of points at which the surface in the image ends too.
    pub found: usize,
    /// Number of points at which the surface in the image does not end.
    pub missing: usize,
    /// How exactly the image ends at a point, 0 to 1, summed over the confirmed points.
    pub closeness: f64,
    /// Number of sides where the part does not end as learned: a longer board ends as learned at all sides but one.
    pub other_sides: usize,
}

impl EndsInSight {
    /// Number of visible points.
    pub fn count(&self) -> usize {
        self.found + self.missing
    }

    /// Share of the visible points that is confirmed; 1 if none is visible.
    pub fn share(&self) -> f64 {
        if self.count() == 0 { 1.0 } else { self.found as f64 / self.count() as f64 }
    }
}

/// Visible contour points by part, of the contour that is known at a state. Where another part of the object is seen
/// just outside the end, before it or at most 3 cm behind it, no end is expected.
pub fn ends_in_sight(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    shape: &ObjectShape,
    state: &State,
) -> Vec<EndsInSight> {
    let camera = &scene.frame.camera;
    let poses = articulated.matrices(state);
    let buffer = DepthBuffer::of(&visible(scene, cloud, &articulated.poses(state)));
    let mut counts = vec![EndsInSight::default(); articulated.parts];
    let mut sides: HashMap<(usize, usize), (usize, usize)> = HashMap::new();
    for c in shape.known_at(articulated, state) {
        let pose = &poses[c.part];
        let beyond = pose * (c.point + c.outward * BESIDE_M);
        let shows_another_part = pixel_of(scene, &beyond, &(pose * c.normal))
            .is_some_and(|pixel| buffer.shows_another_part(pixel, c.part, beyond.z));
        if shows_another_part {
            continue;
        }
        let Some(seen) = seen_end(scene, pose, c) else { continue };
        let (found, missing) = sides.entry((c.part, c.side)).or_default();
        let gate = gate((pose * c.point).z, camera.depth_sensor, camera.fx).min(FARTHEST_M);
        match seen {
            SeenEnd::At(distance) if distance.abs() < gate => {
                *found += 1;
                counts[c.part].closeness += 1.0 - distance.abs() / gate;
            }
            _ => *missing += 1,
        }
    }
    for ((part, _), (found, missing)) in sides {
        let part = &mut counts[part];
        part.found += found;
        part.missing += missing;
        let all = found + missing;
        let is_other = all >= ENOUGH_OF_SIDE && (found as f64) < OTHER_SIDE * all as f64;
        part.other_sides += usize::from(is_other);
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::super::test_data::look_for_plain_slider;
    use super::*;
    use crate::math::rigid::Pose;
    use crate::test_data::{board, seen as picture};
    use nalgebra::{Point3, Vector3};

    /// A place at which a surface that faces the camera is said to end.
    fn end(x: f64, z: f64, outward: Vector3<f64>) -> ContourPoint {
        let point = Point3::new(x, 0.0, z);
        let normal = -Vector3::z();
        ContourPoint { part: 0, point, normal, outward, side: 0, configurations: [0.0; 2] }
    }

    /// Test of a contour point on a board 40 cm wide, 1.5 m away and a metre before a wall; its lower left
    /// corner has no depth.
    fn told(c: &ContourPoint) -> Option<bool> {
        let of_board = board(0.2, 1.5, 2.5);
        let depth = |x, y| if x < -0.1 && y > 0.1 { f64::NAN } else { of_board(x, y) };
        let scene = Scene::plain(&picture(1, depth)).unwrap();
        ends(&scene, &ContourGrid::of(&scene), &IsometryMatrix3::identity(), c)
    }

    #[test]
    fn a_surface_ends_where_the_picture_shows_its_border_and_to_that_side_only() {
        assert_eq!(told(&end(0.2, 1.5, Vector3::x())), Some(true));
        assert_eq!(told(&end(-0.2, 1.5, -Vector3::x())), Some(true));
        assert_eq!(told(&end(0.2, 1.5, -Vector3::x())), Some(false), "to the other side");
    }

    #[test]
    fn a_surface_does_not_end_where_it_goes_on_or_where_nothing_is() {
        assert_eq!(told(&end(0.05, 1.5, Vector3::x())), Some(false), "it goes on");
        assert_eq!(told(&end(0.4, 1.5, Vector3::x())), Some(false), "the wall is seen there");
    }

    #[test]
    fn what_is_hidden_turned_away_or_out_of_sight_says_nothing() {
        assert_eq!(told(&end(0.1, 2.0, Vector3::x())), None, "behind the board");
        let turned = ContourPoint { normal: Vector3::z(), ..end(0.2, 1.5, Vector3::x()) };
        assert_eq!(told(&turned), None, "turned away");
        assert_eq!(told(&end(2.0, 1.5, Vector3::x())), None, "beside the picture");
        assert_eq!(told(&end(0.0, -1.5, Vector3::x())), None, "behind the camera");
        let mut dark = end(-0.18, 1.5, -Vector3::x());
        dark.point.y = 0.18;
        assert_eq!(told(&dark), None, "no depth");
    }

    /// Ends in sight of a slider that stands at 0.06 m, where it is taken to stand at `q`.
    fn in_sight_at(q: f64) -> Vec<EndsInSight> {
        look_for_plain_slider(Some(0.2), 0.06, |refiner, contours| {
            let state = State { camera_from_object: Pose::identity(), q: vec![q] };
            ends_in_sight(refiner.scene, refiner.articulated, refiner.cloud, contours.shape, &state)
        })
    }

    #[test]
    fn parts_in_their_places_show_their_ends() {
        for part in in_sight_at(0.06) {
            assert!(part.count() > 20 && part.share() > 0.9, "{part:?}");
            assert!(part.closeness > 0.5 * part.found as f64, "{part:?}");
            assert!(part.closeness <= part.found as f64, "{part:?}");
            assert_eq!(part.other_sides, 0);
        }
    }

    #[test]
    fn a_part_beside_its_place_lacks_ends_and_the_others_do_not() {
        let [plate, board] = in_sight_at(0.0)[..] else { panic!("two parts") };
        assert!(plate.share() > 0.9, "{plate:?}");
        // The upper and the lower side are displaced along themselves, the left and the right one across.
        assert!(board.share() < 0.75, "{board:?}");
        assert_eq!(board.other_sides, 2);
    }

    #[test]
    fn ends_that_are_not_known_at_a_configuration_are_not_asked_for() {
        let [plate, board] = in_sight_at(0.25)[..] else { panic!("two parts") };
        assert_eq!((board.count(), board.share()), (0, 1.0));
        assert!(plate.count() > 0);
    }
}
