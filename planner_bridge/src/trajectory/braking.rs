//! Whether a motion can be braked at any instant within its joint's range, and the motion that always
//! can: to rest first, then to the target.
//!
//! In: motions or tasks, radians or metres. Out: the answer, or motions.

use super::solver::in_proportion;
use super::task::Task;
use linkage_realtime::{JointMotion, Sample, Segment, stop};

/// Seconds between the instants at which it is looked where a brake would end, and how many there
/// are at most.
const BRAKE_PERIOD: f64 = 0.001;
const MAX_BRAKES: usize = 20_000;
/// Largest distance by which a brake may leave the range, rad or m.
const BRAKE_SLACK: f64 = 1e-6;

/// True where the motion can be braked at any instant without leaving its range.
pub fn brakes_inside(motion: &JointMotion) -> bool {
    let bounds = motion.bounds();
    let [low, high] = bounds.range;
    let steps = ((motion.duration() / BRAKE_PERIOD) as usize).clamp(1, MAX_BRAKES);
    (0..=steps).all(|i| {
        let time = motion.duration() * i as f64 / steps as f64;
        let end = stop(motion.at(time), &bounds.limits).position;
        (low - BRAKE_SLACK..=high + BRAKE_SLACK).contains(&end)
    })
}

/// Motions that come to rest as soon as they can, and go on from there, all from one instant.
pub fn by_way_of_rest(tasks: &[Task]) -> Result<Vec<JointMotion>, String> {
    let stops: Vec<_> = tasks.iter().map(|t| stop(t.from, &t.limits.into())).collect();
    let resting = stops.iter().map(|s| s.duration).fold(0.0, f64::max);
    let rested: Vec<Task> = tasks
        .iter()
        .zip(&stops)
        .map(|(task, stop)| Task { from: Sample::rest(stop.position), ..*task })
        .collect();
    let (still, moving): (Vec<Task>, Vec<Task>) = rested.iter().partition(|t| t.is_still());
    let onward = in_proportion(&moving)?;
    let arrive = resting + onward.iter().map(JointMotion::duration).fold(0.0, f64::max);
    let joined = |(task, stop): (&Task, &linkage_realtime::Stop)| {
        let mut segments = stop.segments.to_vec();
        let here = Sample::rest(stop.position);
        segments.push(Segment::from(stop.duration, here, 0.0));
        if still.iter().all(|t| t.joint != task.joint) {
            let motion = onward.iter().find(|m| m.name() == task.joint);
            let later = |s: &Segment| Segment { start: s.start + resting, ..*s };
            segments.extend(motion.into_iter().flat_map(JointMotion::segments).map(later));
        }
        task.course(&segments, arrive, task.to).map_err(|e| e.to_string())
    };
    tasks.iter().zip(&stops).map(joined).collect()
}
