//! Estimates the configuration of a hinged part in keyframes that see it nearly from its edge.
//!
//! A door that is opened wide turns its edge to the camera, and then its other face. Its tracks are lost and no plane
//! of it is seen, so that the end of its range stayed unknown. But the depth image sees through all places at which
//! the part is not. What is left is a short interval of configurations, if nothing hides the part.
//!
//! In: hinges of the base, with the keyframes in which their configuration is known; the recording.
//! Out: the hinges with more configurations, radians, and the range that these cover.
//! From: free space; dynamic programming (Viterbi) for the path between known configurations.

use super::best_path::best_path;
use super::free_space::{FreeSpaceCounts, count_free_space, thinned};
use super::learned_joint::{LearnedJoints, span_of};
use super::recording::Recording;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use linkage_frames::RgbdFrame;
use nalgebra::Point3;
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Interval between the configurations that are tried, radians.
const STEP_RAD: f64 = 0.02;
/// How far beyond the known range configurations are tried, radians.
const BEYOND_RAD: f64 = 1.0;
/// Smallest span of the known configurations, radians: the line of a hinge that turned less is not known well enough.
const MIN_SPAN_RAD: f64 = 0.3;
/// Largest speed at which a hinge is followed, radians a second: people open things at up to 2.6.
pub const MAX_SPEED_RAD_S: f64 = 3.0;
/// Cost of a radian of a path, as a share of the agreement of all points in one keyframe.
const COST_PER_RAD: f64 = 0.5;
/// Most points of a part that are tested.
const MAX_POINTS: usize = 150;
/// Fewest points of a part that tell where it is.
const MIN_POINTS: usize = 20;
/// Largest share of the part's points that may be seen through at a configuration that is possible.
const POSSIBLE: f64 = 0.15;
/// Share of the part's points that must be seen through beside the possible configurations, on either side.
const EXCLUDED: f64 = 0.3;
/// Distance from the possible configurations within which that must hold, radians.
const BESIDE_RAD: f64 = 0.2;
/// Largest width of the interval of possible configurations, radians. Its middle is taken, so that the error is at
/// most half of it.
const MAX_WIDTH_RAD: f64 = 0.36;
/// Smallest share of the keyframes that must see a part from its edge, so that these keyframes do not count. Of a small
/// surface that was followed about a wrong line it was 5 of 39; of four doors that were left wide open, at least 68 %.
const LEAST_EDGE_ON: f64 = 0.3;

/// Adds the configurations of hinges of the base in keyframes that see their parts nearly from the edge. The poses of
/// the parts stay unknown there: the configurations are not exact enough to tell which pixels show the part. (With
/// such poses one of 89 encounters was not recognised any more.)
pub fn complete(mut found: LearnedJoints, recording: &Recording) -> LearnedJoints {
    for learned in &mut found.joints {
        let joint = &learned.joint;
        if joint.kind != JointKind::Revolute || joint.parent != 0 {
            continue;
        }
        let all = learned.configurations();
        let known: Vec<Option<f64>> = recording.keyframes.iter().map(|(f, _)| all[f]).collect();
        let points = learned.points(&recording.ego_motion);
        let (frames, told): (Vec<usize>, Vec<f64>) =
            configurations_by_exclusion(&joint.geometry(), &points, &known, recording)
                .into_iter()
                .unzip();
        if told.is_empty() {
            continue;
        }
        let joint = &mut learned.joint;
        let before = joint.range;
        joint.observations += frames.len();
        joint.configuration.extend(recording.tracks.timed(&frames, &told));
        joint.configuration.sort_by(|a, b| a[0].total_cmp(&b[0]));
        for q in told {
            joint.range = [joint.range[0].min(q), joint.range[1].max(q)];
        }
        let (name, after) = (&joint.name, joint.range);
        tracing::debug!(
            name,
            keyframes = frames.len(),
            ?before,
            ?after,
            "range of a part seen from its edge"
        );
    }
    found
}

/// Frames and configurations, radians, of the keyframes that leave a short interval for the configuration of a hinge.
/// `known`: configuration in each keyframe in which it is known. `points`: the part's surface at configuration 0, base
/// frame, metres.
fn configurations_by_exclusion(
    line: &JointGeometry,
    points: &[Point3<f64>],
    known: &[Option<f64>],
    recording: &Recording,
) -> Vec<(usize, f64)> {
    let told: Vec<f64> = known.iter().copied().flatten().collect();
    let points = thinned(points, MAX_POINTS);
    if told.len() == known.len() || span_of(&told) < MIN_SPAN_RAD || points.len() < MIN_POINTS {
        return Vec::new();
    }
    let pictures: Vec<(usize, &RgbdFrame)> = recording.keyframes.iter().collect();
    let grid = Grid::around(&told);
    let counts = grid.counts(line, &points, &pictures, known, recording);
    let path = grid.path(&counts, known, points.len(), recording);
    let of = |i: usize| {
        let counts = counts[i].as_deref()?;
        let possible = possible_interval(counts, path[i], points.len())?;
        Some((pictures[i].0, 0.5 * (grid.at(*possible.start()) + grid.at(*possible.end()))))
    };
    (0..pictures.len()).filter_map(of).collect()
}

/// [`configurations_by_exclusion`], if it tells at least [`LEAST_EDGE_ON`] of the keyframes; empty otherwise. These are
/// mostly the last ones, of a door that is left wide open.
pub fn long_edge_on(
    line: &JointGeometry,
    points: &[Point3<f64>],
    known: &[Option<f64>],
    recording: &Recording,
) -> Vec<(usize, f64)> {
    let mut told = configurations_by_exclusion(line, points, known, recording);
    if (told.len() as f64) < LEAST_EDGE_ON * known.len() as f64 {
        told.clear();
    }
    told
}

/// Configurations that are tried, radians.
struct Grid {
    first: f64,
    count: usize,
}

impl Grid {
    fn around(known: &[f64]) -> Self {
        let low = known.iter().copied().fold(f64::INFINITY, f64::min) - BEYOND_RAD;
        let count = ((span_of(known) + 2.0 * BEYOND_RAD) / STEP_RAD) as usize + 1;
        Self { first: low, count }
    }

    fn at(&self, index: usize) -> f64 {
        self.first + STEP_RAD * index as f64
    }

    fn nearest(&self, q: f64) -> usize {
        (((q - self.first) / STEP_RAD).round().max(0.0) as usize).min(self.count - 1)
    }

    /// For each keyframe in which the configuration is not known: what its depth image shows of the part at each
    /// configuration.
    fn counts(
        &self,
        line: &JointGeometry,
        points: &[Point3<f64>],
        pictures: &[(usize, &RgbdFrame)],
        known: &[Option<f64>],
        recording: &Recording,
    ) -> Vec<Option<Vec<FreeSpaceCounts>>> {
        let of = |(&(frame, picture), known): (&(usize, &RgbdFrame), &Option<f64>)| {
            let camera_from_base = recording.ego_motion.camera_from_base[frame];
            let at = |i| {
                count_free_space(picture, points, &(camera_from_base * line.motion(self.at(i))))
            };
            known.is_none().then(|| (0..self.count).map(at).collect())
        };
        pictures.par_iter().zip(known).map(of).collect()
    }

    /// Index of the configuration in each keyframe, along the path on which least is seen through and which passes
    /// through the known configurations where its speed allows.
    fn path(
        &self,
        counts: &[Option<Vec<FreeSpaceCounts>>],
        known: &[Option<f64>],
        points: usize,
        recording: &Recording,
    ) -> Vec<usize> {
        let elsewhere = -(points as f64) * known.len() as f64;
        let row = |(counts, known): (&Option<Vec<FreeSpaceCounts>>, &Option<f64>)| match (
            counts, known,
        ) {
            (Some(counts), _) => counts.iter().map(|c| c.margin() as f64).collect(),
            (None, known) => {
                let mut row = vec![elsewhere; self.count];
                known.iter().for_each(|q| row[self.nearest(*q)] = 0.0);
                row
            }
        };
        let table: Vec<Vec<f64>> = counts.iter().zip(known).map(row).collect();
        let steps = recording.keyframes.largest_steps(MAX_SPEED_RAD_S);
        let columns: Vec<usize> =
            steps.iter().map(|max| (max / STEP_RAD).ceil() as usize).collect();
        best_path(&table, COST_PER_RAD * points as f64 * STEP_RAD, &columns)
    }
}

/// Indices of the possible configurations around index `at`; `None` if there are many, or if nothing excludes those
/// beside them.
fn possible_interval(
    counts: &[FreeSpaceCounts],
    at: usize,
    points: usize,
) -> Option<RangeInclusive<usize>> {
    let share = |i: usize| counts[i].through as f64 / points as f64;
    if share(at) > POSSIBLE {
        return None;
    }
    let most = (MAX_WIDTH_RAD / STEP_RAD) as usize;
    let start = (0..=at).rev().take_while(|&i| share(i) <= POSSIBLE).last()?;
    let end = (at..counts.len()).take_while(|&i| share(i) <= POSSIBLE).last()?;
    let beside = (BESIDE_RAD / STEP_RAD) as usize;
    let below = (start.saturating_sub(beside)..start).any(|i| share(i) >= EXCLUDED);
    let above = (end + 1..counts.len().min(end + 1 + beside)).any(|i| share(i) >= EXCLUDED);
    (end - start <= most && below && above).then_some(start..=end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::learned_joint::LearnedJoint;
    use crate::learn::plane_hinges::test_data::{
        HINGE_M, door_recording, edge_on_rad, left_edge_on_recording, turn as opened,
    };
    use crate::object::model::Joint;
    use linkage_frames::DepthImage;
    use nalgebra::Vector3;

    /// Turn at which the camera sees the door nearly from its edge, radians. Exactly from its edge the door, which has
    /// no thickness, would not be seen at all.
    fn nearly_edge_on_rad() -> f64 {
        edge_on_rad() - 0.06
    }

    /// A door that is opened until the camera sees its edge, and then half closed.
    fn turn(frame: usize) -> f64 {
        match frame {
            0..6 => 0.0,
            6..10 => 0.3 * (frame - 5) as f64,
            10..16 => nearly_edge_on_rad(),
            _ => 1.0,
        }
    }

    /// The door with its configuration in the frames in which it has turned by less than `known` radians.
    fn door(known: f64) -> LearnedJoint {
        let [x, z] = HINGE_M;
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(x, 0.0, z));
        let place = |i: i32, k: i32| Point3::new(x + 0.05 * f64::from(i), 0.1 * f64::from(k), z);
        let turns: Vec<Option<f64>> =
            (0..24).map(|f| Some(turn(f)).filter(|q| *q < known)).collect();
        let told = turns.iter().copied().flatten().fold(0.0, f64::max);
        let timed = turns.iter().enumerate().filter_map(|(f, q)| Some([0.1 * f as f64, (*q)?]));
        LearnedJoint {
            joint: Joint { range: [0.0, told], configuration: timed.collect(), ..Joint::of(&line) },
            base_from_part: turns.iter().map(|q| Some(line.motion((*q)?))).collect(),
            tracks: Vec::new(),
            plain_surface: (1..12).flat_map(|i| (-4..5).map(move |k| place(i, k))).collect(),
        }
    }

    fn completed(door: LearnedJoint, recording: &Recording) -> Joint {
        let found = LearnedJoints { joints: vec![door], ..LearnedJoints::default() };
        complete(found, recording).joints.remove(0).joint
    }

    #[test]
    fn the_range_reaches_to_where_a_door_shows_its_edge() {
        let door = door(1.25);
        let known = door.joint.configuration.len();
        let joint = completed(door, &door_recording(24, turn));
        assert!((joint.range[1] - nearly_edge_on_rad()).abs() < 0.1, "{:?}", joint.range);
        assert_eq!((joint.range[0], joint.configuration.len()), (0.0, known + 6));
        assert!(joint.configuration.is_sorted_by(|a, b| a[0] < b[0]), "in time order");
    }

    #[test]
    fn a_door_behind_somebody_may_be_anywhere() {
        let mut recording = door_recording(24, turn);
        let mut hidden = Keyframes::new(24);
        for (frame, picture) in recording.keyframes.iter() {
            let mut picture = picture.clone();
            let depth = &picture.depth;
            let near = depth.as_metres().iter().map(|z| z.min(1.0)).collect();
            picture.depth = DepthImage::from_metres(depth.width(), depth.height(), near).unwrap();
            hidden.offer(frame, &picture);
        }
        recording.keyframes = hidden;
        let door = door(1.25);
        assert_eq!(completed(door.clone(), &recording), door.joint);
    }

    #[test]
    fn a_door_whose_line_is_hardly_known_and_one_that_is_known_throughout_stay_as_they_are() {
        let recording = door_recording(24, turn);
        for known in [0.25, 4.0] {
            let door = door(known);
            assert_eq!(completed(door.clone(), &recording), door.joint);
        }
    }

    #[test]
    fn a_door_that_is_left_open_is_told_from_a_door_that_is_seen_from_its_edge_for_a_moment() {
        let left = |recording: &Recording, known: &dyn Fn(usize) -> Option<f64>| {
            let door = door(1.25);
            let known: Vec<Option<f64>> =
                recording.keyframes.iter().map(|(f, _)| known(f)).collect();
            long_edge_on(&door.joint.geometry(), &door.plain_surface, &known, recording)
        };
        let way = |f: usize| edge_on_rad() / opened(16) * opened(f);
        let open = left(&left_edge_on_recording(40), &|f| (f < 16).then(|| way(f)));
        assert_eq!(open.len(), 24);
        assert!(open.iter().all(|(_, q)| (q - edge_on_rad()).abs() < 0.1), "{open:?}");
        let moment = |f: usize| (turn(f) < 1.25).then(|| turn(f));
        assert!(left(&door_recording(24, turn), &moment).is_empty());
    }

    #[test]
    fn a_slide_has_no_edge_to_turn() {
        let mut drawer = door(1.25);
        drawer.joint.kind = JointKind::Prismatic;
        assert_eq!(completed(drawer.clone(), &door_recording(24, turn)), drawer.joint);
    }

    #[test]
    fn an_interval_is_possible_if_it_is_short_and_both_sides_are_seen_through() {
        let counts = |through: &[usize]| -> Vec<FreeSpaceCounts> {
            through.iter().map(|&through| FreeSpaceCounts { through, agrees: 0 }).collect()
        };
        let seen = counts(&[90, 80, 10, 0, 0, 10, 60, 90]);
        assert_eq!(possible_interval(&seen, 4, 100), Some(2..=5));
        assert_eq!(possible_interval(&seen, 6, 100), None, "seen through there");
        assert_eq!(possible_interval(&counts(&[90, 0, 0, 20, 20]), 1, 100), None, "hidden beside");
        let mut wide = vec![0; 40];
        (wide[0], wide[39]) = (90, 90);
        assert_eq!(possible_interval(&counts(&wide), 20, 100), None, "too wide");
    }
}
