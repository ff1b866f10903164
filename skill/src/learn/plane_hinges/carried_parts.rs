//! Finds plain parts that another part carries: the door of a cabinet on a tray that was pulled out before. In the
//! base frame such a door comes with the tray. While the tray rests, the door moves like any other one.
//!
//! Hinges are searched for in the keyframes of the parent's longest rest; the keyframes outside that rest decide
//! whether the parent carries them.
//!
//! A part that was found in the base frame may be carried too: the back of a chair whose seat turned before. It was
//! found while the seat rested.
//!
//! In: the joints of the base, and the recording.
//! Out: hinges whose parent is a moving part; line and points are those at the first frame, metres and radians.

use super::depth_following::MAX_POINTS;
use super::extend_range::extend_to;
use super::plain_search::search;
use super::same_joint::is_known;
use crate::learn::free_space::{FreeSpaceCounts, count_free_space, thinned};
use crate::learn::learned_joint::LearnedJoint;
use crate::learn::recording::Recording;
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointKind;
use std::ops::RangeInclusive;

/// Fewest keyframes of the parent's rest.
const MIN_REST_KEYFRAMES: usize = 12;
/// Largest shift of a slide during its rest, metres, and largest turn of a hinge, radians.
const REST_M: f64 = 0.006;
const REST_RAD: f64 = 0.02;
/// The parent counts as moved away when it is more than this many times `REST_M` or `REST_RAD` from its rest.
const ELSEWHERE: f64 = 6.0;
/// Smallest share of a part's range that it must show while its carrier rests.
const WITHIN_REST: f64 = 0.8;
/// Fewest keyframes in which the parent is moved away.
const MIN_ELSEWHERE_KEYFRAMES: usize = 3;
/// Smallest share of a carried part's points that the keyframes outside the rest must find where the parent carries
/// them.
const LEAST_SHOWN: f64 = 0.4;
/// Largest share of a carried part's visible points that may be seen through where the parent carries them.
const MAX_THROUGH: f64 = 0.1;
/// Smallest ratio of (points found - points seen through) with the parent's motion to the same without it.
const LEAST_MARGIN: f64 = 2.0;

/// The plain parts that a slide of the base carries and that are not known yet.
pub fn carried_parts(joints: &[LearnedJoint], recording: &Recording) -> Vec<LearnedJoint> {
    let mut found: Vec<LearnedJoint> = Vec::new();
    let is_slide = |j: &&LearnedJoint| j.joint.kind == JointKind::Prismatic && j.joint.parent == 0;
    for carrier in joints.iter().filter(is_slide) {
        let Some(rest) = Rest::of(carrier, recording) else { continue };
        for part in search(&rest.recording).parts {
            let mut learned = part.to_learned(&rest.recording);
            if joints.iter().chain(&found).any(|j| is_known(j, &learned)) {
                continue;
            }
            extend_to(part.reach(), &mut learned, &rest.recording);
            if rest.carries(&learned, carrier, recording) {
                found.push(rest.carried(learned, carrier));
            }
        }
    }
    found
}

/// Hangs a part that was found in the base frame on the joint that carries it, if one does.
pub fn hang_on_carrier(part: &mut LearnedJoint, joints: &[LearnedJoint], recording: &Recording) {
    let of_base = joints.iter().filter(|carrier| carrier.joint.parent == 0);
    let mut hung = of_base.filter_map(|carrier| {
        let rest = Rest::of(carrier, recording)?;
        let seen = rest.part_within(part, recording)?;
        rest.carries(&seen, carrier, recording).then(|| rest.carried(seen, carrier))
    });
    if let Some(hung) = hung.next() {
        tracing::debug!(
            parent = hung.joint.parent,
            joint = hung.joint.name,
            "hangs on a moving part"
        );
        *part = hung;
    }
}

/// The longest rest of a joint.
struct Rest {
    /// The recording, with the keyframes of the rest only.
    recording: Recording,
    /// First and last frame of the rest.
    frames: RangeInclusive<usize>,
    /// Pose of the parent during the rest: maps its points at the first frame into the base frame.
    base_from_carrier: Pose,
}

impl Rest {
    /// The longest rest; `None` if the joint rests for too few keyframes, or is moved away in too few.
    fn of(carrier: &LearnedJoint, recording: &Recording) -> Option<Self> {
        let q = configurations(carrier, recording);
        let is_slide = carrier.joint.kind == JointKind::Prismatic;
        let still = if is_slide { REST_M } else { REST_RAD };
        let from = |start: usize| {
            let near = |then: &&(usize, f64)| (then.1 - q[start].1).abs() < still;
            (start, q[start..].iter().take_while(near).count())
        };
        let (start, count) =
            (0..q.len()).map(from).max_by_key(|(start, n)| (*n, usize::MAX - start))?;
        let elsewhere =
            q.iter().filter(|(_, other)| (other - q[start].1).abs() > ELSEWHERE * still);
        if count < MIN_REST_KEYFRAMES || elsewhere.count() < MIN_ELSEWHERE_KEYFRAMES {
            return None;
        }
        let frames = q[start].0..=q[start + count - 1].0;
        let base_from_carrier = carrier.base_from_part[q[start + count / 2].0]?;
        let keyframes = recording.keyframes.within(&frames);
        let recording = Recording { keyframes, ..recording.clone() };
        Some(Self { recording, frames, base_from_carrier })
    }

    /// What is known of a part during the rest; `None` if that is little of its range.
    fn part_within(&self, part: &LearnedJoint, recording: &Recording) -> Option<LearnedJoint> {
        let mut within = part.clone();
        for (frame, pose) in within.base_from_part.iter_mut().enumerate() {
            if !self.frames.contains(&frame) {
                *pose = None;
            }
        }
        // Frames that stay known keep their configurations; those of the others are dropped.
        within.place(&[], &recording.tracks);
        let length = |part: &LearnedJoint| part.joint.range[1] - part.joint.range[0];
        (length(&within) >= WITHIN_REST * length(part)).then_some(within)
    }

    /// True if the keyframes outside the rest show the part where the parent carries it, and not where the base would
    /// hold it.
    fn carries(
        &self,
        learned: &LearnedJoint,
        carrier: &LearnedJoint,
        recording: &Recording,
    ) -> bool {
        let known: Vec<(usize, Pose)> = poses(learned).collect();
        let (Some(first), Some(last)) = (known.first(), known.last()) else { return false };
        let points = thinned(&learned.plain_surface, MAX_POINTS);
        let (mut carried, mut held) = (FreeSpaceCounts::default(), FreeSpaceCounts::default());
        let mut asked = 0;
        for (frame, picture) in recording.keyframes.iter().filter(|(f, _)| !self.frames.contains(f))
        {
            let Some(base_from_carrier) = carrier.base_from_part[frame] else { continue };
            // Outside the rest, the part is assumed to keep the configuration of that end of the rest.
            let (_, base_from_part) = if frame < *self.frames.start() { first } else { last };
            let camera_from_base = recording.ego_motion.camera_from_base[frame];
            let moved = base_from_carrier * self.base_from_carrier.inverse();
            let count = |pose: Pose| count_free_space(picture, &points, &(camera_from_base * pose));
            carried.add(count(moved * base_from_part));
            held.add(count(*base_from_part));
            asked += points.len();
        }
        asked > 0
            && carried.agrees as f64 >= LEAST_SHOWN * asked as f64
            && carried.share_through() <= MAX_THROUGH
            && carried.margin() as f64 >= LEAST_MARGIN * held.margin() as f64
    }

    /// The part as the parent's child. The line and the points refer to the first frame.
    fn carried(&self, mut learned: LearnedJoint, carrier: &LearnedJoint) -> LearnedJoint {
        let back = self.base_from_carrier.inverse();
        let line = learned.joint.geometry().transformed(&back);
        learned.joint.axis = line.axis.into_inner().into();
        learned.joint.origin = line.origin.coords.into();
        learned.joint.parent = carrier.joint.child;
        learned.plain_surface.iter_mut().for_each(|p| *p = back * *p);
        for pose in learned.base_from_part.iter_mut().flatten() {
            *pose *= self.base_from_carrier;
        }
        learned
    }
}

/// Keyframes in which a joint's configuration is known, with the configuration.
fn configurations(learned: &LearnedJoint, recording: &Recording) -> Vec<(usize, f64)> {
    let joint = &learned.joint;
    let at = |frame: usize| {
        let time = recording.tracks.frame_utimes[frame] as f64 * 1e-6;
        let i = joint.configuration.partition_point(|[t, _]| *t < time - 1e-4);
        joint.configuration.get(i).filter(|[t, _]| (t - time).abs() < 1e-4).map(|[_, q]| *q)
    };
    recording.keyframes.iter().filter_map(|(frame, _)| Some((frame, at(frame)?))).collect()
}

/// Frames in which the part's pose is known, with the pose.
fn poses(learned: &LearnedJoint) -> impl Iterator<Item = (usize, Pose)> + '_ {
    learned.base_from_part.iter().enumerate().filter_map(|(f, pose)| Some((f, (*pose)?)))
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{HINGE_M, pulled_door_recording};
    use super::*;
    use crate::math::rigid::distance_to_line;
    use crate::object::joint_geometry::JointGeometry;
    use crate::object::model::Joint;
    use nalgebra::{Point3, Vector3};

    const FRAMES: usize = 44;

    /// Shift of a cupboard that is pulled forwards by 0.3 m, metres.
    fn pulled(frame: usize) -> f64 {
        0.05 * frame.saturating_sub(6).min(6) as f64
    }

    /// Turn of the cupboard's door, which is opened later, radians.
    fn opened(frame: usize) -> f64 {
        0.13 * frame.saturating_sub(20).min(10) as f64
    }

    /// The slide as tracks show it, with configuration `q` in each frame.
    fn slide(q: impl Fn(usize) -> f64) -> LearnedJoint {
        let line = JointGeometry::slide(-Vector3::z_axis(), Point3::new(0.0, 0.0, 2.0));
        let configuration = (0..FRAMES).map(|f| [0.1 * f as f64, q(f)]).collect();
        let joint = Joint { configuration, parent: 0, child: 1, ..Joint::of(&line) };
        let base_from_part = (0..FRAMES).map(|f| Some(line.motion(q(f)))).collect();
        LearnedJoint { joint, base_from_part, tracks: vec![0; 50], plain_surface: Vec::new() }
    }

    #[test]
    fn the_door_of_a_cupboard_that_was_pulled_out_hangs_on_the_slide() {
        let recording = pulled_door_recording(FRAMES, opened, pulled);
        let found = carried_parts(&[slide(pulled)], &recording);
        assert_eq!(found.len(), 1);
        let joint = &found[0].joint;
        assert_eq!(joint.parent, 1);
        // The line refers to the first frame.
        let hinge = Point3::new(HINGE_M[0], 0.0, HINGE_M[1]);
        let off = distance_to_line(&joint.origin.into(), &joint.axis.into(), &hinge);
        assert!(off < 0.02, "{off} m off");
        assert!((joint.range[1] - joint.range[0] - 1.3).abs() < 0.05, "{:?}", joint.range);
    }

    #[test]
    fn a_door_that_was_found_on_the_base_is_hung_on_what_carries_it_and_on_nothing_else() {
        let found = |recording: &Recording| {
            let rest = Rest::of(&slide(pulled), recording).unwrap();
            search(&rest.recording).parts[0].to_learned(&rest.recording)
        };
        let hung_on = |shift: fn(usize) -> f64| {
            let recording = pulled_door_recording(FRAMES, opened, shift);
            let mut door = found(&recording);
            assert_eq!(door.joint.parent, 0);
            hang_on_carrier(&mut door, &[slide(pulled)], &recording);
            door.joint.parent
        };
        assert_eq!(hung_on(pulled), 1);
        assert_eq!(hung_on(|_| 0.0), 0, "the base holds it");
    }

    #[test]
    fn a_door_of_the_base_is_not_taken_for_the_part_of_a_slide_that_rests() {
        let recording = pulled_door_recording(FRAMES, opened, |_| 0.0);
        assert!(carried_parts(&[slide(pulled)], &recording).is_empty(), "the base holds it");
        assert!(carried_parts(&[slide(|_| 0.0)], &recording).is_empty(), "it is nowhere else");
    }
}
