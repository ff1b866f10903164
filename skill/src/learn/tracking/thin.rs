//! Chooses the frames of a long demonstration that are kept: memory is bounded, and a frame in
//! which nothing moves shows nothing that the frame before it did not.
//!
//! In: all tracks, pixels, and the times of the frames. Out: a mark for each frame that is kept.

use super::track::{Track, TrackSet};

/// A frame counts as changed if at least this many features moved; fewer are tracking errors.
const MIN_MOVED: usize = 6;
/// A frame counts as changed if at least this share of the features moved.
const MOVED_SHARE: f64 = 0.005;
/// Motions between two kept frames that are tried, pixels; the smallest that drops enough frames is
/// taken.
const STEPS_PX: [f32; 10] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, f32::INFINITY];
/// Longest time between two kept frames if there is room for it, microseconds.
const LONGEST_GAP_US: i64 = 1_000_000;

/// Marks at most `most` frames (at least 2): the first, the last, and between them those that
/// differ enough from the kept frame before.
pub fn informative_frames(set: &TrackSet, most: usize) -> Vec<bool> {
    let n = set.frames();
    let most = most.max(2);
    if n <= most {
        return vec![true; n];
    }
    let alive = Alive::of(set);
    // A sixteenth of the room is for frames in which nothing moves, however long that lasts.
    let whole = set.frame_utimes[n - 1] - set.frame_utimes[0];
    let gap = LONGEST_GAP_US.max(16 * whole / most as i64);
    let marked = STEPS_PX.iter().map(|step| alive.apart(*step, gap));
    let few = |marks: &Vec<bool>| marks.iter().filter(|m| **m).count() <= most;
    marked.into_iter().find(few).unwrap_or_else(|| evenly(n, most))
}

/// Marks `most` evenly spaced frames, the first and the last among them.
fn evenly(n: usize, most: usize) -> Vec<bool> {
    let mut marks = vec![false; n];
    (0..most).for_each(|i| marks[i * (n - 1) / (most - 1)] = true);
    marks
}

/// The tracks that are alive in each frame.
struct Alive<'s> {
    set: &'s TrackSet,
    by_frame: Vec<Vec<u32>>,
}

impl<'s> Alive<'s> {
    fn of(set: &'s TrackSet) -> Self {
        let mut by_frame = vec![Vec::new(); set.frames()];
        for (number, track) in (0..).zip(&set.tracks) {
            by_frame[track.first_frame..track.end_frame()].iter_mut().for_each(|f| f.push(number));
        }
        Self { set, by_frame }
    }

    /// Marks the first and the last frame, and each frame with more than `step` pixels of motion,
    /// or at least `gap` microseconds, since the marked frame before.
    fn apart(&self, step: f32, gap: i64) -> Vec<bool> {
        let n = self.set.frames();
        let mut marks = vec![false; n];
        let mut before = 0;
        for (frame, mark) in marks.iter_mut().enumerate() {
            let waited = self.set.frame_utimes[frame] - self.set.frame_utimes[before];
            *mark = frame == 0 || waited >= gap || self.motion(before, frame) > step;
            if *mark {
                before = frame;
            }
        }
        marks[n - 1] = true;
        marks
    }

    /// Motion of the features from one frame to another, pixels: the largest distance that as many
    /// features have moved as a changed frame needs. Infinite if too few features are seen in both.
    fn motion(&self, from: usize, to: usize) -> f32 {
        let moved = |number: &u32| {
            let track = &self.set.tracks[*number as usize];
            Some((track.at(to)?.pixel - track.at(from)?.pixel).norm())
        };
        let mut moved: Vec<f32> = self.by_frame[to].iter().filter_map(moved).collect();
        let needed = MIN_MOVED.max((MOVED_SHARE * moved.len() as f64) as usize);
        if moved.len() < needed {
            return f32::INFINITY;
        }
        let rank = moved.len() - needed;
        *moved.select_nth_unstable_by(rank, f32::total_cmp).1
    }
}

impl TrackSet {
    /// Removes the frames that are not marked, and the tracks that were seen in these alone.
    /// Returns the new number of each track that stays.
    pub fn keep_frames(&mut self, marks: &[bool]) -> Vec<Option<usize>> {
        let mut marked = marks.iter();
        self.frame_utimes.retain(|_| *marked.next().unwrap_or(&true));
        // Number of kept frames before each frame.
        let mut before = Vec::with_capacity(marks.len());
        let mut count = 0;
        for mark in marks {
            before.push(count);
            count += usize::from(*mark);
        }
        for track in &mut self.tracks {
            let first = track.first_frame;
            let mut number = first..;
            track.observations.retain(|_| {
                let frame = number.next().unwrap_or_default();
                marks.get(frame).copied().unwrap_or(true)
            });
            track.observations.shrink_to_fit();
            track.first_frame = before.get(first).copied().unwrap_or(count);
        }
        let mut stay = 0;
        let mut renumber = |track: &Track| {
            let stays = !track.observations.is_empty();
            stay += usize::from(stays);
            stays.then(|| stay - 1)
        };
        let numbers = self.tracks.iter().map(&mut renumber).collect();
        self.tracks.retain(|track| !track.observations.is_empty());
        numbers
    }
}

#[cfg(test)]
mod tests {
    use super::super::track::{Observation, TrackId};
    use super::*;
    use nalgebra::Point2;
    use proptest::prelude::*;

    const FRAME_US: i64 = 33_333;

    /// Ten features of a part that is at `x` pixels in each frame, among forty that stay.
    fn recording(x: &[f32]) -> TrackSet {
        let seen = |x: f32, y: f32| Observation {
            pixel: Point2::new(x, y),
            point_in_camera: None,
            normal_in_camera: None,
        };
        let track = |id: usize| {
            let part = f32::from(u8::from(id < 10));
            let observations = x.iter().map(|x| seen(part * x, id as f32)).collect();
            Track { id: TrackId(id), first_frame: 0, observations }
        };
        TrackSet {
            frame_utimes: (0..x.len() as i64).map(|i| i * FRAME_US).collect(),
            tracks: (0..50).map(track).collect(),
        }
    }

    fn kept(marks: &[bool]) -> Vec<usize> {
        (0..marks.len()).filter(|&i| marks[i]).collect()
    }

    #[test]
    fn frames_without_motion_go_first() {
        // Still for 20 s, 3 s of motion, still for 20 s.
        let x = |i: usize| (i.clamp(600, 690) - 600) as f32 * 3.0;
        let set = recording(&(0..1290).map(x).collect::<Vec<_>>());
        let kept = kept(&informative_frames(&set, 200));
        let moving = kept.iter().filter(|i| (600..=690).contains(*i)).count();
        assert!(moving >= 90, "every frame of the motion stays: {moving}");
        assert!(kept.len() <= 200);
        assert_eq!((kept[0], *kept.last().unwrap()), (0, 1289));
        let gaps = kept.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert!(gaps <= Some(105), "{gaps:?}");
    }

    #[test]
    fn a_slow_motion_is_kept_though_no_frame_differs_from_the_one_before() {
        let x = |i: usize| i as f32 * 0.05;
        let set = recording(&(0..2000).map(x).collect::<Vec<_>>());
        let kept = kept(&informative_frames(&set, 500));
        assert!(kept.len() > 100, "{}", kept.len());
    }

    #[test]
    fn what_was_seen_in_kept_frames_stays_as_it_was() {
        let mut set = recording(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        set.tracks[3].first_frame = 2;
        set.tracks[3].observations.drain(..2);
        // Seen in frame 1 alone.
        set.tracks[4].first_frame = 1;
        set.tracks[4].observations.truncate(1);
        let before = set.clone();
        let numbers = set.keep_frames(&[true, false, true, false, true, true]);
        assert_eq!(numbers[4], None);
        assert_eq!((numbers[3], numbers[5]), (Some(3), Some(4)));
        assert_eq!(set.frame_utimes, [0, 2, 4, 5].map(|i| i * FRAME_US));
        for (now, then) in [(0, 0), (1, 2), (2, 4), (3, 5)] {
            for (old, number) in numbers.iter().enumerate() {
                let Some(number) = number else { continue };
                assert_eq!(set.tracks[*number].at(now), before.tracks[old].at(then));
            }
        }
    }

    proptest! {
        #[test]
        fn no_motion_makes_more_frames_stay_than_there_is_room_for(
            x in prop::collection::vec(-300.0..300.0_f32, 2..400),
            most in 2..100_usize,
        ) {
            let mut set = recording(&x);
            let marks = informative_frames(&set, most);
            prop_assert!(marks.iter().filter(|m| **m).count() <= most);
            prop_assert!(marks[0] && marks[x.len() - 1]);
            set.keep_frames(&marks);
            prop_assert!(set.tracks.iter().all(|t| t.end_frame() == set.frames()));
        }
    }
}
