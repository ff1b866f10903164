//! Tests whether a surface rests. A part of an object rests exactly until it is moved; a person who stands, or an arm
//! that hangs, sways by millimetres all the time.
//!
//! In: a surface at rest (base frame), and the keyframes next to that end of the recording.
//! Out: whether the surface sways.
//! From: measured on 27 of the rendered demonstrations on which the limits were chosen, in standard deviations of a
//! depth reading: the shifts of a part's surface had a spread of at most 0.65 while it rested, those of persons
//! within 1.7 m 0.8 to 4 within five keyframes.

use super::rest_surface::{End, RestSurface};
use super::view::View;
use nalgebra::{Matrix3, Point3, Vector3};

/// Largest spread of the shifts of a surface that rests, standard deviations of a depth reading.
const MAX_SPREAD_SIGMAS: f64 = 0.75;
/// Largest ratio of the spread of a surface that rests to that of the whole room, which is the error of the camera's
/// poses.
const MAX_SPREAD_OF_ROOM: f64 = 2.0;
/// Time from which a surface that is still counts as resting, seconds.
const STILL_S: f64 = 0.75;
/// Fewest further keyframes in which a surface that sways is near its rest. A surface that a hand moves is gone
/// sooner, if it moves 5 cm in a second.
const SWAYING_KEYFRAMES: usize = 3;
/// Largest distance of a surface's reading from a point, along the normal there, metres.
const MAX_OFF_M: f64 = 0.02;
/// Smallest share of the points that a keyframe must show.
const LEAST_SHOWN: f64 = 0.5;
/// Damping of a shift in directions that the surface's shape hardly determines, as a share of the number of points.
const DAMPING: f64 = 0.05;
/// Distance between two points of the room, pixels.
const ROOM_STRIDE_PX: usize = 16;
/// Number of keyframes that see through a place from which the place does not belong to the room.
const THROUGH_ROOM: usize = 2;

/// How far the whole room seems to shift against one end of the recording: the error of the camera's poses.
pub struct RoomShifts {
    /// The end.
    pub end: End,
    /// Shift in each keyframe against the one at that end, metres, base frame; `None` where little of the room is
    /// shown.
    pub of_keyframe: Vec<Option<Vector3<f64>>>,
}

impl RoomShifts {
    /// The shifts against the keyframe at an end of the recording.
    pub fn of(end: End, views: &[View]) -> Self {
        if views.is_empty() {
            return Self { end, of_keyframe: Vec::new() };
        }
        let rest = &views[end.at(0, views.len())];
        let (points, normals): (Vec<_>, Vec<_>) = static_points(rest, views).unzip();
        let of_keyframe = views.iter().map(|view| shift(&points, &normals, view)).collect();
        Self { end, of_keyframe }
    }
}

/// True if the surface, which rests at the end of `room`, shifts slowly in the keyframes next to that end.
pub fn sways(surface: &RestSurface, views: &[View], room: &RoomShifts) -> bool {
    let order: Vec<usize> = (0..views.len()).map(|k| room.end.at(k, views.len())).collect();
    let Some(rest) = order.first().map(|k| &views[*k]) else { return false };
    let z = (rest.camera_from_base * surface.centre()).z;
    let least = MAX_SPREAD_SIGMAS * rest.picture.camera.depth_sensor.reading_sigma(z);
    // The first keyframe is left out: it has the noise of the points themselves.
    let later = &order[1..];
    let of_surface = spreads(later, |k| shift(&surface.points, &surface.normals, &views[k]));
    let of_room = spreads(later, |k| room.of_keyframe[k]);
    let at = |k: usize| of_room.get(k).or(of_room.last()).copied().unwrap_or_default();
    let is_still = |(k, spread): &(usize, &f64)| **spread <= least.max(MAX_SPREAD_OF_ROOM * at(*k));
    let still = of_surface.iter().enumerate().take_while(is_still).count();
    let still_until = &views[order[still]].picture;
    let still_s = still_until.utime.abs_diff(rest.picture.utime) as f64 * 1e-6;
    still_s < STILL_S && of_surface.len() >= still + SWAYING_KEYFRAMES
}

/// Static points all over the image, with their normals; base frame. A person covers a small share of the image.
fn static_points<'v>(
    rest: &'v View,
    views: &'v [View],
) -> impl Iterator<Item = (Point3<f64>, Vector3<f64>)> + 'v {
    let depth = &rest.picture.depth;
    let pixels = |size: usize| (0..size).step_by(ROOM_STRIDE_PX);
    let all = pixels(depth.height()).flat_map(move |v| pixels(depth.width()).map(move |u| (u, v)));
    let stays = |place: &Point3<f64>| {
        let through = views.iter().filter(|view| view.shows_behind(place));
        through.take(THROUGH_ROOM).count() < THROUGH_ROOM
    };
    all.filter_map(|(u, v)| rest.patch_at(u, v)).filter(move |(place, _)| stays(place))
}

/// Spread of the shifts up to each keyframe, metres: the largest distance between two shifts so far. Ends with the
/// first keyframe without a shift.
fn spreads(keyframes: &[usize], shift: impl Fn(usize) -> Option<Vector3<f64>>) -> Vec<f64> {
    let (mut shifts, mut spread): (Vec<Vector3<f64>>, f64) = (Vec::new(), 0.0);
    let with = |shift: Vector3<f64>| {
        spread = shifts.iter().map(|other| (shift - other).norm()).fold(spread, f64::max);
        shifts.push(shift);
        spread
    };
    keyframes.iter().map_while(|k| shift(*k)).map(with).collect()
}

/// The shift that brings points to a keyframe's readings, metres: least squares, point to plane. `None` if few points
/// are shown.
pub fn shift(
    points: &[Point3<f64>],
    normals: &[Vector3<f64>],
    view: &View,
) -> Option<Vector3<f64>> {
    let n = points.len() as f64;
    let (mut left, mut right) = (Matrix3::from_diagonal_element(DAMPING * n), Vector3::zeros());
    let mut shown = 0;
    for (place, normal) in points.iter().zip(normals) {
        let Some(reading) = view.surface_near(place) else { continue };
        let off = normal.dot(&(reading - place));
        if off.abs() < MAX_OFF_M {
            left += normal * normal.transpose();
            right += normal * off;
            shown += 1;
        }
    }
    let is_told = shown > 0 && shown as f64 >= LEAST_SHOWN * n;
    is_told.then(|| left.cholesky().map(|left| left.solve(&right)))?
}

#[cfg(test)]
mod tests {
    use super::super::rest_surface::vacated_surfaces;
    use super::super::test_data::{FRAMES, PIVOT_M, lever, swaying, turn};
    use super::*;
    use crate::learn::recording::Recording;

    /// True if the surface that rests at an end of the recording sways.
    fn is_seen_to_sway(recording: &Recording, end: End) -> bool {
        let views = View::all(recording);
        let surface = &vacated_surfaces(&views, end, |_| Vec::new())[0];
        sways(surface, &views, &RoomShifts::of(end, &views))
    }

    #[test]
    fn what_rests_until_it_is_moved_does_not_sway_nor_what_rests_when_it_was() {
        for end in [End::First, End::Last] {
            assert!(!is_seen_to_sway(&lever(turn), end), "{end:?}");
        }
    }

    #[test]
    fn what_comes_nearer_by_a_millimetre_a_keyframe_sways() {
        let nearer = |per_frame: f64| swaying(turn, move |frame| per_frame * frame as f64);
        assert!(is_seen_to_sway(&nearer(0.0012), End::First));
        assert!(!is_seen_to_sway(&nearer(0.0002), End::First), "this is in the noise");
    }

    #[test]
    fn what_is_moved_at_once_does_not_sway_though_it_hardly_rested() {
        let soon = |frame: usize| turn(frame + 3);
        assert!(!is_seen_to_sway(&lever(soon), End::First));
    }

    #[test]
    fn what_seems_to_move_with_its_room_does_not_sway_but_what_moves_more_does() {
        // The camera's poses are wrong: bar and wall seem to come nearer.
        let seems = |bar: f64| {
            let mut recording = swaying(turn, move |frame| bar * frame as f64);
            let poses = &mut recording.ego_motion.camera_from_base;
            for (frame, pose) in poses.iter_mut().enumerate() {
                pose.translation.vector.z += 0.0012 * frame as f64;
            }
            is_seen_to_sway(&recording, End::First)
        };
        assert!(!seems(0.0));
        assert!(seems(0.0018), "2.5 times as much as the wall");
    }

    #[test]
    fn a_shift_is_along_the_normals_and_none_is_told_of_what_is_hidden() {
        let recording = swaying(turn, |frame| 0.004 * (frame % 2) as f64);
        let views = View::all(&recording);
        let bar: Vec<Point3<f64>> = (0..9)
            .map(|k| Point3::from(PIVOT_M) + Vector3::new(0.03 * f64::from(k), 0.0, 0.0))
            .collect();
        let normals = vec![-Vector3::z(); bar.len()];
        let shift = |k: usize| shift(&bar, &normals, &views[k]);
        assert!(shift(0).unwrap().norm() < 1e-6);
        let moved = shift(1).unwrap();
        assert!((moved.z + 0.004 / (1.0 + DAMPING)).abs() < 1e-5 && moved.xy().norm() < 1e-9);
        assert_eq!(shift(FRAMES - 1), None, "it was turned away");
    }
}
