//! Finds where the demonstrator's hand held a part: at places that moved with the part while it
//! moved, were empty while it rested, and left with it the place where they were. A planner may hold the part in the
//! same place.
//!
//! In: poses of the part and of its parent in the camera, points of the part, and the keyframes;
//! metres.
//! Out: the middle of the grip, in part coordinates; `None` if no hand is found.

use super::keyframes::Keyframes;
use super::tracking::Trajectory;
use crate::math::rigid::Pose;
use crate::math::robust::{median_point, without_isolated};
use linkage_frames::RgbdFrame;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Side of a cell of space for a part up to 1 m away, metres; beyond, it grows in proportion to the
/// depth.
const CELL_M: f64 = 0.015;
/// Step from one pixel that is read to the next, in columns and in rows.
const PIXEL_STRIDE: usize = 3;
/// Frames before and after a keyframe over which the travel of a part is measured.
const SPAN: usize = 4;
/// Smallest travel of the part's middle around a keyframe in which the part moves, metres.
const MOVES_M: f64 = 0.008;
/// Largest travel of the part's middle around a keyframe in which the part rests, metres.
const RESTS_M: f64 = 0.002;
/// Smallest and largest number of keyframes in which the part moves, and of those in which it
/// rests.
const KEYFRAMES: [usize; 2] = [4, 14];
/// Smallest share of the moving keyframes in which a held place is filled.
const FILLED: f64 = 0.6;
/// Smallest share of the resting keyframes that agree on what is at a place, of those that show it.
const AGREEING: f64 = 0.7;
/// Smallest share of the views in which something that stays where it is must be seen there. The part itself may rest
/// where a hand was, but not at both ends of its range.
const STAYS: f64 = 0.8;
/// Largest difference in depth between a place and a reading that shows the place itself, metres.
const THICKNESS_M: f64 = 0.02;
/// Distance from the known points of the part within which its surface and the hand are searched,
/// metres.
const REACH_M: f64 = 0.15;
/// Largest distance of the hand from the part's surface, metres.
const HAND_M: f64 = 0.1;
/// Largest additional distance of the grip from the surface, beyond that of the hand's nearest
/// place, metres.
const GRIP_M: f64 = 0.02;
/// Smallest travel of a held place, as a share of the farthest travel of the part's points,
/// outliers included. A hand holds a part where little force moves it; near a hinge hardly anything
/// moves, whatever it is.
const LEVER: f64 = 0.5;
/// Largest distance between connected cells, in sides of a cell.
const LINKED: f64 = 2.0;
/// Smallest number of cells of a hand.
const LEAST_CELLS: usize = 12;

/// A part with its motion and its surface.
pub struct GraspEstimator<'h> {
    /// Pose of the part in the camera, for each frame; the part has the axes of the camera at the
    /// first frame.
    pub camera_from_part: &'h Trajectory,
    /// Pose of the parent, which carries the part, in the camera, for each frame.
    pub camera_from_parent: &'h Trajectory,
    /// Points of the part, in part coordinates, metres.
    pub surface: Vec<Point3<f64>>,
}

impl GraspEstimator<'_> {
    /// The point that was held, in part coordinates; `None` if no hand is found that holds the
    /// part.
    pub fn grasp(&self, keyframes: &Keyframes) -> Option<Point3<f64>> {
        let middle = median_point(&self.surface)?;
        let views = |wanted: fn(f64) -> bool| -> Vec<View> {
            let of = |(f, frame)| {
                if !wanted(self.travel(f, &middle)?) {
                    return None;
                }
                let (part, parent) = (self.camera_from_part[f]?, self.camera_from_parent[f]?);
                Some(View { camera_from_part: part, camera_from_parent: parent, frame })
            };
            let all: Vec<_> = keyframes.iter().filter_map(of).collect();
            let stride = all.len().div_ceil(KEYFRAMES[1]).max(1);
            all.into_iter().step_by(stride).collect()
        };
        let (moving, resting) = (views(|m| m > MOVES_M), views(|m| m < RESTS_M));
        if moving.len() < KEYFRAMES[0] || resting.len() < KEYFRAMES[0] {
            return None;
        }
        let cell = CELL_M * (moving[0].camera_from_part * middle).z.max(1.0);
        let surface = without_isolated(&self.surface, OUTLIER_M, OUTLIER_NEIGHBOURS);
        let near = Cells::around(&surface, REACH_M, REACH_M / 2.0);
        let far = self.surface.iter().map(|p| way(&moving, p)).fold(0.0, f64::max);
        let (mut hand, mut own) = (Vec::new(), Vec::new());
        for place in filled(&moving, &near, cell) {
            if way(&moving, &place) < LEVER * far {
                continue;
            }
            match when_resting(&resting, &place) {
                Some(Resting::Free) if !stays_behind(&moving, &resting, &place) => hand.push(place),
                Some(Resting::Free) => {}
                Some(Resting::There) => own.push(place),
                None => {}
            }
        }
        grip(&largest_piece(&hand, LINKED * cell), &own)
    }

    /// Travel of the part's middle relative to its parent, from `SPAN` frames before a frame to
    /// `SPAN` frames after it, metres.
    fn travel(&self, frame: usize, middle: &Point3<f64>) -> Option<f64> {
        let at = |f: usize| {
            let parent_from_camera = (*self.camera_from_parent.get(f)?)?.inverse();
            Some(parent_from_camera * (*self.camera_from_part.get(f)?)? * middle)
        };
        let before = at(frame.saturating_sub(SPAN)).or_else(|| at(frame))?;
        let after = at(frame + SPAN).or_else(|| at(frame))?;
        Some((after - before).norm())
    }
}

/// A keyframe, with where the part and what carries it are in it.
struct View<'k> {
    camera_from_part: Pose,
    camera_from_parent: Pose,
    frame: &'k RgbdFrame,
}

/// Radius within which the neighbours of a point of the part are counted, metres.
const OUTLIER_M: f64 = 0.1;
/// Smallest number of neighbours of a point of the part that is no outlier.
const OUTLIER_NEIGHBOURS: usize = 4;

/// Cells of space.
struct Cells {
    side: f64,
    cells: HashSet<[i32; 3]>,
}

fn cell_of(p: &Point3<f64>, side: f64) -> [i32; 3] {
    std::array::from_fn(|i| (p[i] / side).floor() as i32)
}

impl Cells {
    /// All cells within about `reach` of the points.
    fn around(points: &[Point3<f64>], reach: f64, side: f64) -> Self {
        let far = (reach / side).ceil() as i32;
        let mut cells = HashSet::new();
        let seeds: HashSet<[i32; 3]> = points.iter().map(|p| cell_of(p, side)).collect();
        for [x, y, z] in seeds {
            for dx in -far..=far {
                for dy in -far..=far {
                    for dz in -far..=far {
                        cells.insert([x + dx, y + dy, z + dz]);
                    }
                }
            }
        }
        Self { side, cells }
    }

    fn hold(&self, p: &Point3<f64>) -> bool {
        self.cells.contains(&cell_of(p, self.side))
    }
}

/// Places in part coordinates, one for each cell that is filled in at least `FILLED` of the
/// keyframes.
fn filled(views: &[View], near: &Cells, side: f64) -> Vec<Point3<f64>> {
    let here: Vec<_> =
        views.par_iter().map(|v| filled_in(&v.camera_from_part, v.frame, near, side)).collect();
    let mut counts: HashMap<[i32; 3], (usize, Vector3<f64>, f64)> = HashMap::new();
    for (cell, (sum, n)) in here.into_iter().flatten() {
        let count = counts.entry(cell).or_default();
        *count = (count.0 + 1, count.1 + sum, count.2 + n);
    }
    let often = FILLED * views.len() as f64;
    let mut places: Vec<([i32; 3], Point3<f64>)> = counts
        .into_iter()
        .filter(|(_, (frames, _, _))| *frames as f64 >= often)
        .map(|(cell, (_, sum, n))| (cell, Point3::from(sum / n)))
        .collect();
    // The order of a hash map is not deterministic.
    places.sort_by_key(|p| p.0);
    places.into_iter().map(|p| p.1).collect()
}

/// Cells that are filled in one keyframe: sum and number of the places that are seen in each.
fn filled_in(
    camera_from_part: &Pose,
    frame: &RgbdFrame,
    near: &Cells,
    side: f64,
) -> HashMap<[i32; 3], (Vector3<f64>, f64)> {
    let mut here: HashMap<[i32; 3], (Vector3<f64>, f64)> = HashMap::new();
    for v in (0..frame.camera.height).step_by(PIXEL_STRIDE) {
        for u in (0..frame.camera.width).step_by(PIXEL_STRIDE) {
            let Some(seen) = frame.point_at(u, v) else { continue };
            let place = camera_from_part.inverse_transform_point(&seen);
            if near.hold(&place) {
                let sum = here.entry(cell_of(&place, side)).or_default();
                *sum = (sum.0 + place.coords, sum.1 + 1.0);
            }
        }
    }
    here
}

/// Largest distance of a place from where it is in the first of the frames, in the camera frame,
/// metres.
fn way(views: &[View], place: &Point3<f64>) -> f64 {
    let first = views.first().map_or(*place, |v| v.camera_from_part * place);
    views.iter().map(|v| (v.camera_from_part * place - first).norm()).fold(0.0, f64::max)
}

/// What is at a place while the part rests.
enum Resting {
    Free,
    There,
}

/// What a keyframe shows at a place, in the camera frame; `None` if something hides it, or nothing is read there.
fn at_place(frame: &RgbdFrame, expected: &Point3<f64>) -> Option<Resting> {
    let pixel = frame.camera.project(expected)?;
    let z = f64::from(frame.depth.at_nearest(pixel.x, pixel.y)?);
    if z > expected.z + THICKNESS_M {
        return Some(Resting::Free);
    }
    (z > expected.z - THICKNESS_M).then_some(Resting::There)
}

/// What the resting keyframes show at a place of the part; `None` if they disagree, or if fewer than two show it.
fn when_resting(views: &[View], place: &Point3<f64>) -> Option<Resting> {
    let (mut free, mut there) = (0, 0);
    for view in views {
        match at_place(view.frame, &(view.camera_from_part * place)) {
            Some(Resting::Free) => free += 1,
            Some(Resting::There) => there += 1,
            None => {}
        }
    }
    let most = AGREEING * f64::from(free + there);
    match (f64::from(free) >= most, f64::from(there) >= most) {
        _ if free + there < 2 => None,
        (true, _) => Some(Resting::Free),
        (_, true) => Some(Resting::There),
        _ => None,
    }
}

/// True if what fills a place while the part moves is still there when the part rests elsewhere. Seen from a door, the
/// table top below it seems to turn with the door.
fn stays_behind(moving: &[View], resting: &[View], place: &Point3<f64>) -> bool {
    let (mut free, mut there) = (0, 0);
    let fills = |v: &&View| {
        matches!(at_place(v.frame, &(v.camera_from_part * place)), Some(Resting::There))
    };
    for view in moving.iter().filter(fills) {
        let in_parent = view.camera_from_parent.inverse() * view.camera_from_part * place;
        for rest in resting {
            match at_place(rest.frame, &(rest.camera_from_parent * in_parent)) {
                Some(Resting::Free) => free += 1,
                Some(Resting::There) => there += 1,
                None => {}
            }
        }
    }
    there > 0 && f64::from(there) >= STAYS * f64::from(there + free)
}

/// The largest set of connected places: the hand, not the rim of the part.
fn largest_piece(places: &[Point3<f64>], linked: f64) -> Vec<Point3<f64>> {
    let mut left: Vec<usize> = (0..places.len()).collect();
    let mut largest: Vec<Point3<f64>> = Vec::new();
    while let Some(first) = left.pop() {
        let mut piece = vec![first];
        let mut reached = 0;
        while let Some(&at) = piece.get(reached) {
            let touches = |i: &mut usize| (places[*i] - places[at]).norm() < linked;
            piece.extend(left.extract_if(.., touches));
            reached += 1;
        }
        if piece.len() > largest.len() {
            largest = piece.into_iter().map(|i| places[i]).collect();
        }
    }
    largest
}

/// The middle of those places of the hand that are nearest to the part's surface; `None` if the
/// hand is too small or too far from the surface.
fn grip(hand: &[Point3<f64>], surface: &[Point3<f64>]) -> Option<Point3<f64>> {
    let distance = |p: &Point3<f64>| {
        surface.iter().map(|s| (p - s).norm_squared()).fold(f64::INFINITY, f64::min).sqrt()
    };
    let distances: Vec<f64> = hand.iter().map(distance).collect();
    let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
    let held: Vec<Point3<f64>> = hand
        .iter()
        .zip(&distances)
        .filter(|(_, d)| **d <= nearest + GRIP_M)
        .map(|(p, _)| *p)
        .collect();
    if hand.len() < LEAST_CELLS || nearest > HAND_M {
        return None;
    }
    tracing::debug!(hand = hand.len(), own = surface.len(), held = held.len(), nearest, "grasp");
    median_point(&held)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};
    use nalgebra::Translation3;

    /// A board that slides towards the camera, from 1.5 m, with or without a fist before its
    /// middle.
    fn frame(index: usize, slid: f64, fist: bool) -> RgbdFrame {
        let front = 1.5 - slid;
        let drawer = board(0.2, front, 2.5);
        seen(index as i64 + 1, |x, y| {
            let held = |c: f64, centre: f64| (c * (front - 0.05) - centre).abs() < 0.04;
            if fist && held(x, 0.1) && held(y, 0.05) { front - 0.05 } else { drawer(x, y) }
        })
    }

    fn grasp(fist: bool) -> Option<Point3<f64>> {
        let mut keyframes = Keyframes::new(60);
        // It rests, slides for 30 frames with the fist, and rests without it.
        let slid = |f: usize| 0.01 * (f.clamp(10, 40) - 10) as f64;
        (0..50).for_each(|f| keyframes.offer(f, &frame(f, slid(f), fist && (10..40).contains(&f))));
        let poses = |slides: bool| -> Trajectory {
            let z = |f: usize| if slides { -slid(f) } else { 0.0 };
            (0..50).map(|f| Some(Pose::from(Translation3::new(0.0, 0.0, z(f))))).collect()
        };
        let grid =
            |i: i32| Point3::new(0.03 * f64::from(i % 11 - 5), 0.03 * f64::from(i / 11 - 5), 1.5);
        let (camera_from_part, camera_from_parent) = (poses(true), poses(false));
        let held = GraspEstimator {
            camera_from_part: &camera_from_part,
            camera_from_parent: &camera_from_parent,
            surface: (0..121).map(grid).collect(),
        };
        held.grasp(&keyframes)
    }

    #[test]
    fn a_fist_that_moves_a_drawer_is_where_it_is_held() {
        let held = grasp(true).unwrap();
        assert!((held - Point3::new(0.1, 0.05, 1.45)).norm() < 0.015, "{held}");
    }

    /// A panel, 0.4 m wide, that rests 1.5 m away and then slides to the right, before a wall that ends on the left.
    fn panel(index: usize, slid: f64) -> RgbdFrame {
        seen(index as i64 + 1, |x, y| {
            let is_panel = (x * 1.5 - slid).abs() < 0.2 && (y * 1.5).abs() < 0.2;
            let is_wall = x * 1.56 > -0.3 && (y * 1.56).abs() < 0.25;
            if is_panel {
                1.5
            } else if is_wall {
                1.56
            } else {
                2.5
            }
        })
    }

    #[test]
    fn a_wall_that_looks_as_if_it_moved_with_a_panel_is_no_hand() {
        let mut keyframes = Keyframes::new(60);
        let slid = |f: usize| 0.01 * (f.max(20) - 20) as f64;
        (0..50).for_each(|f| keyframes.offer(f, &panel(f, slid(f))));
        let poses = |share: f64| -> Trajectory {
            (0..50)
                .map(|f| Some(Pose::from(Translation3::new(share * slid(f), 0.0, 0.0))))
                .collect()
        };
        let grid =
            |i: i32| Point3::new(0.04 * f64::from(i % 11 - 5), 0.04 * f64::from(i / 11 - 5), 1.5);
        let (camera_from_part, camera_from_parent) = (poses(1.0), poses(0.0));
        let held = GraspEstimator {
            camera_from_part: &camera_from_part,
            camera_from_parent: &camera_from_parent,
            surface: (0..121).map(grid).collect(),
        };
        assert_eq!(held.grasp(&keyframes), None);
    }

    #[test]
    fn what_moves_by_itself_is_held_nowhere() {
        assert_eq!(grasp(false), None);
    }
}
