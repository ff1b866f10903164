//! Motions of joints by the solver (rsruckig): each as fast as it may, all arriving at once, or in
//! proportion to each other.
//!
//! In: tasks, radians or metres. Out: their motions in pieces of constant jerk, or the solver's reason.

use super::knots::KNOT_PERIOD;
use super::task::Task;
use crate::limits::{MotionLimits, Synchronisation};
use linkage_realtime::{JointMotion, Sample, Segment};
use rsruckig::prelude::*;

/// The solver's motions.
pub fn solve(tasks: &[Task], synchronisation: Synchronisation) -> Result<Vec<JointMotion>, String> {
    if tasks.is_empty() {
        return Ok(Vec::new());
    }
    let joints = Some(tasks.len());
    let mut solver = Ruckig::<0, ThrowErrorHandler>::new(joints, KNOT_PERIOD);
    let mut input = InputParameter::new(joints);
    input.synchronization = match synchronisation {
        Synchronisation::Independent => Synchronization::None,
        Synchronisation::Time => Synchronization::Time,
        Synchronisation::Phase => Synchronization::Phase,
    };
    for (i, task) in tasks.iter().enumerate() {
        let limits = task.limits_with_room_for_rounding();
        input.current_position[i] = task.from.position;
        input.current_velocity[i] = task.from.velocity;
        input.current_acceleration[i] = task.from.acceleration;
        input.target_position[i] = task.to;
        input.max_velocity[i] = limits.velocity;
        input.max_acceleration[i] = limits.acceleration;
        input.max_jerk[i] = limits.jerk;
    }
    let mut trajectory = Trajectory::new(joints);
    solver.calculate(&input, &mut trajectory).map_err(|e| e.to_string())?;
    let profiles = trajectory.get_profiles().first().ok_or("it has no section")?;
    let course = |(task, profile): (&Task, &Profile)| {
        let (segments, duration) = pieces(profile);
        task.course(&segments, duration, task.to).map_err(|e| e.to_string())
    };
    tasks.iter().zip(profiles.iter()).map(course).collect()
}

/// The pieces of a profile, and its seconds: what brings it within the limits, then the motion.
fn pieces(profile: &Profile) -> (Vec<Segment>, f64) {
    let mut segments = Vec::with_capacity(9);
    let mut start = 0.0;
    let brake = &profile.brake;
    if brake.duration > 0.0 {
        for i in 0..2 {
            let now =
                Sample { position: brake.p[i], velocity: brake.v[i], acceleration: brake.a[i] };
            if brake.t[i] > 0.0 {
                segments.push(Segment::from(start, now, brake.j[i]));
                start += brake.t[i];
            }
        }
    }
    for i in 0..7 {
        let (position, velocity) = (profile.p[i], profile.v[i]);
        let now = Sample { position, velocity, acceleration: profile.a[i] };
        segments.push(Segment::from(start, now, profile.j[i]));
        start += profile.t[i];
    }
    (segments, start)
}

/// Motions from rest that run in proportion to each other, so that all arrive at once: one motion
/// from 0 to 1, as slow as the joint that limits it most.
pub fn in_proportion(tasks: &[Task]) -> Result<Vec<JointMotion>, String> {
    if tasks.is_empty() {
        return Ok(Vec::new());
    }
    let way = |task: &Task| task.to - task.from.position;
    let least = |limit: fn(&MotionLimits) -> f64| {
        let share = |t: &Task| limit(&t.limits_with_room_for_rounding()) / way(t).abs();
        tasks.iter().map(share).fold(f64::INFINITY, f64::min)
    };
    let limits = MotionLimits {
        velocity: least(|l| l.velocity),
        acceleration: least(|l| l.acceleration),
        jerk: least(|l| l.jerk),
    };
    let mut input = InputParameter::new(None);
    input.target_position[0] = 1.0;
    input.max_velocity[0] = limits.velocity;
    input.max_acceleration[0] = limits.acceleration;
    input.max_jerk[0] = limits.jerk;
    let mut trajectory = Trajectory::new(None);
    let mut solver = Ruckig::<1, ThrowErrorHandler>::new(None, KNOT_PERIOD);
    solver.calculate(&input, &mut trajectory).map_err(|e| e.to_string())?;
    let profile = trajectory.get_profiles().first().ok_or("it has no section")?;
    let (segments, duration) = pieces(&profile[0]);
    let scaled = |task: &Task| {
        let way = way(task);
        let of = |s: &Segment| Segment {
            start: s.start,
            position: task.from.position + way * s.position,
            velocity: way * s.velocity,
            acceleration: way * s.acceleration,
            jerk: way * s.jerk,
        };
        let segments: Vec<Segment> = segments.iter().map(of).collect();
        task.course(&segments, duration, task.to).map_err(|e| e.to_string())
    };
    tasks.iter().map(scaled).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_realtime::stop;

    #[test]
    fn the_solver_stops_no_sooner_than_the_brake() {
        let limits = MotionLimits { velocity: 0.5, acceleration: 1.0, jerk: 4.0 };
        let from = Sample { position: 0.3, velocity: 0.4, acceleration: 0.6 };
        let mut input = InputParameter::<1>::new(None);
        input.control_interface = ControlInterface::Velocity;
        input.current_position[0] = from.position;
        input.current_velocity[0] = from.velocity;
        input.current_acceleration[0] = from.acceleration;
        input.max_velocity[0] = limits.velocity;
        input.max_acceleration[0] = limits.acceleration;
        input.max_jerk[0] = limits.jerk;
        let mut trajectory = Trajectory::new(None);
        let mut solver = Ruckig::<1, ThrowErrorHandler>::new(None, 0.001);
        solver.calculate(&input, &mut trajectory).unwrap();
        let (ours, theirs) = (stop(from, &limits.into()), &trajectory.get_profiles()[0][0]);
        assert!((ours.duration - trajectory.get_duration()).abs() < 1e-9);
        assert!((ours.position - theirs.p[7]).abs() < 1e-9);
    }
}
