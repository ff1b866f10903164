//! The test whether the camera is still where it was in the first frame: most cameras stand on a table or a tripod.
//!
//! In: the features of each frame that have depth, projected to pixels.
//! Out: true where the camera has not moved since the first frame. Its pose is then known exactly, where registration
//! wanders with the noise of depth.
//! From: ours. If the camera moves, everything moves in the picture; only if it stands can many features be where they
//! were.

use linkage_frames::RgbdFrame;
use nalgebra::{Point2, Point3};

/// Number of frames since a feature was first seen from which it counts: in fewer, a camera held by hand moves little.
const OLD_FRAMES: usize = 12;
/// Farthest that a feature of the static scene is tracked beside its first pixel, pixels.
const NEAR_PX: f64 = 1.5;
/// Largest median shift of the near features along a picture axis, pixels; at 1.5 m it is 1 mm.
const SHIFT_PX: f64 = 0.3;
/// Largest median distance of the near features from their first pixels, pixels. A turn about the line of sight
/// shifts them all ways.
const SPREAD_PX: f64 = 0.8;
/// Fewest near features, and their smallest share of the old ones. A person or a door may have most features.
const LEAST_NEAR: (usize, f64) = (20, 0.15);

/// First pixels of features, for as long as the camera has not moved.
#[derive(Default)]
pub struct FixedCamera {
    /// First frame and first pixel of each track, by the number of the track.
    first: Vec<Option<(usize, Point2<f64>)>>,
    /// Number of frames so far.
    frames: usize,
}

impl FixedCamera {
    /// Takes the next frame; true if the camera is where it was in the first frame. Of a frame in which it is not, no
    /// feature is kept.
    pub fn push(&mut self, lifted: &[(usize, Point3<f64>)], frame: &RgbdFrame) -> bool {
        let number = self.frames;
        self.frames += 1;
        let pixels: Vec<(usize, Point2<f64>)> = lifted
            .iter()
            .filter_map(|(track, in_camera)| Some((*track, frame.camera.project(in_camera)?)))
            .collect();
        let is_fixed = number == 0 || self.is_fixed(&pixels, number);
        if is_fixed {
            for (track, pixel) in pixels {
                if self.first.len() <= track {
                    self.first.resize(track + 1, None);
                }
                self.first[track].get_or_insert((number, pixel));
            }
        }
        is_fixed
    }

    fn is_fixed(&self, pixels: &[(usize, Point2<f64>)], number: usize) -> bool {
        let since = |first: usize| number - first >= OLD_FRAMES.min(number);
        let shifts: Vec<[f64; 2]> = pixels
            .iter()
            .filter_map(|(track, pixel)| {
                let (first, at) = (*self.first.get(*track)?)?;
                since(first).then(|| (pixel - at).into())
            })
            .collect();
        let near: Vec<[f64; 2]> =
            shifts.iter().copied().filter(|[x, y]| x.hypot(*y) < NEAR_PX).collect();
        let (least, share) = LEAST_NEAR;
        let middle = |value: fn(&[f64; 2]) -> f64| {
            crate::math::robust::median(&mut near.iter().map(value).collect::<Vec<f64>>())
                .unwrap_or(f64::INFINITY)
        };
        near.len() >= least
            && near.len() as f64 >= share * shifts.len() as f64
            && middle(|s| s[0]).abs() < SHIFT_PX
            && middle(|s| s[1]).abs() < SHIFT_PX
            && middle(|s| s[0].hypot(s[1])) < SPREAD_PX
    }

    /// Forgets the tracks without a new number, and gives the others theirs.
    pub fn keep_tracks(&mut self, numbers: &[Option<usize>]) {
        let mut number = numbers.iter();
        self.first.retain(|_| number.next().is_some_and(Option::is_some));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::seen;

    /// Number of features of the room, and of those on a door.
    const ROOM: usize = 40;
    const DOOR: usize = 100;

    /// For each of so many frames, whether the camera is found to be fixed. `shift` is that of the room in the picture,
    /// pixels, by feature and frame; the door's features go on by two pixels a frame.
    fn found(frames: usize, shift: impl Fn(usize, usize) -> [f64; 2]) -> Vec<bool> {
        let picture = seen(0, |_, _| 1.5);
        let place = |u: f64, v: f64| picture.camera.back_project(u, v, 1.5);
        let mut camera = FixedCamera::default();
        (0..frames)
            .map(|f| {
                let room = (0..ROOM).map(|i| {
                    let [x, y] = shift(i, f);
                    (i, place(10.0 + 3.0 * i as f64 + x, 20.0 + 2.0 * i as f64 + y))
                });
                let door = (0..DOOR)
                    .map(|i| (ROOM + i, place(50.0 + 0.3 * i as f64 + 2.0 * f as f64, 60.0)));
                let lifted: Vec<(usize, Point3<f64>)> = room.chain(door).collect();
                camera.push(&lifted, &picture)
            })
            .collect()
    }

    /// Noise of a tracked feature, pixels.
    fn noise(i: usize, f: usize) -> f64 {
        0.3 * ((7 * i + 13 * f) as f64).sin()
    }

    #[test]
    fn a_camera_on_a_tripod_is_fixed_though_most_features_are_on_a_door() {
        assert!(found(40, |i, f| [noise(i, f), noise(f, i)]).iter().all(|fixed| *fixed));
    }

    #[test]
    fn a_camera_held_by_hand_is_not_fixed_however_slowly_it_goes_or_turns() {
        let goes = found(60, |i, f| [noise(i, f) + 0.1 * f as f64, 0.0]);
        assert!(goes[20..].iter().all(|fixed| !fixed), "{goes:?}");
        let turned = |i: usize, f: usize| {
            let (x, y) = (3.0 * i as f64 - 60.0, 2.0 * i as f64 - 40.0);
            let angle = 0.002 * f as f64;
            [-angle * y, angle * x]
        };
        assert!(found(60, turned)[30..].iter().all(|fixed| !fixed));
    }

    #[test]
    fn a_camera_that_is_put_back_to_its_place_is_fixed_again() {
        let pushed = |_, f: usize| [if (20..30).contains(&f) { 6.0 } else { 0.0 }, 0.0];
        let found = found(40, pushed);
        assert!(found[..20].iter().all(|fixed| *fixed) && !found[25] && found[39]);
    }

    #[test]
    fn few_features_tell_nothing_and_dropped_tracks_are_forgotten() {
        let picture = seen(0, |_, _| 1.5);
        let some = |count: usize| -> Vec<(usize, Point3<f64>)> {
            let place = |i: usize| picture.camera.back_project(20.0 + i as f64, 30.0, 1.5);
            (0..count).map(|i| (i, place(i))).collect()
        };
        let mut camera = FixedCamera::default();
        assert!(camera.push(&some(10), &picture), "the first frame is where it is");
        assert!(!camera.push(&some(10), &picture));
        let mut camera = FixedCamera::default();
        camera.push(&some(30), &picture);
        assert!(camera.push(&some(30), &picture));
        let numbers: Vec<Option<usize>> = (0..30).map(|i: usize| i.checked_sub(15)).collect();
        camera.keep_tracks(&numbers);
        assert!(!camera.push(&some(30), &picture), "15 of them are left, which had other numbers");
    }
}
