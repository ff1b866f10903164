//! Motions of joints from what they do now to rest at a target, under limits of velocity,
//! acceleration and jerk (Berscheid & Kröger 2021, through rsruckig): as fast as each may, or
//! together.
//!
//! Every motion can be braked at any instant without leaving the joint's range. From rest that is
//! so by itself; one that begins while its joint moves is looked at, and where it is not so the
//! joint first comes to rest and then goes to its target.

use crate::limits::{MotionLimits, Synchronisation};
use linkage_realtime::{Bounds, JointMotion, Limits, MotionError, Sample, Segment, stop};
use rsruckig::prelude::*;

/// One instant of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knot {
    /// Seconds from the start.
    pub t: f64,
    /// Configuration; rad or m.
    pub q: f64,
    /// Velocity.
    pub qd: f64,
    /// Acceleration.
    pub qdd: f64,
}

/// What a joint is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Task<'t> {
    /// Its name.
    pub joint: &'t str,
    /// What it does now.
    pub from: Sample,
    /// Where it comes to rest; rad or m.
    pub to: f64,
    /// How fast it may be.
    pub limits: MotionLimits,
    /// Least and greatest configuration that it may have; rad or m.
    pub range: [f64; 2],
}

/// A trajectory that cannot be computed.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum TrajectoryError {
    /// A value is not finite.
    #[error("{joint} from {from} to {to}: both must be finite")]
    NotFinite {
        /// The joint.
        joint: String,
        /// Start.
        from: f64,
        /// End.
        to: f64,
    },
    /// No motion under the limits was found.
    #[error("{joint} from {from} to {to}: no trajectory under the rig's limits ({reason})")]
    Unsolved {
        /// The joint.
        joint: String,
        /// Start.
        from: f64,
        /// End.
        to: f64,
        /// Why.
        reason: String,
    },
}

impl<'t> Task<'t> {
    /// A motion from rest to rest, which stays between its ends.
    pub fn between(joint: &'t str, from: f64, to: f64, limits: MotionLimits) -> Self {
        let range = [from.min(to), from.max(to)];
        Self { joint, from: Sample::rest(from), to, limits, range }
    }

    /// A motion from what a joint does now, within a range, which is widened by where the joint is,
    /// where it can stop, and where it is to go.
    pub fn within(
        joint: &'t str,
        from: Sample,
        to: f64,
        limits: MotionLimits,
        range: [f64; 2],
    ) -> Self {
        let must_hold = [from.position, stop(from, &limits.into()).position, to];
        let low = must_hold.into_iter().fold(range[0].min(range[1]), f64::min);
        let high = must_hold.into_iter().fold(range[0].max(range[1]), f64::max);
        Self { joint, from, to, limits, range: [low, high] }
    }

    /// The soonest stop.
    pub fn stopping(&self) -> Result<JointMotion, TrajectoryError> {
        let stop = stop(self.from, &self.limits.into());
        self.course(&stop.segments, stop.duration, stop.position)
            .map_err(|e| self.unsolved(e.to_string()))
    }

    fn is_still(&self) -> bool {
        self.from.velocity == 0.0
            && self.from.acceleration == 0.0
            && (self.to - self.from.position).abs() < 1e-9
    }

    /// Limits below the given ones by what rounding positions to single floats makes of their
    /// differences from knot to knot, so that a planner which receives them finds the given ones
    /// held.
    fn limits_with_room_for_rounding(&self) -> MotionLimits {
        let all = [self.range[0], self.range[1], self.from.position, self.to];
        let nearest = all.into_iter().map(f64::abs).fold(0.0, f64::max) as f32;
        let step = f64::from(nearest.next_up()) - f64::from(nearest);
        let less = |limit: f64, noise: f64| (0.9995 * limit - noise).max(LEAST_USED * limit);
        MotionLimits {
            velocity: less(self.limits.velocity, step / KNOT_PERIOD),
            acceleration: less(self.limits.acceleration, 2.0 * step / KNOT_PERIOD.powi(2)),
            jerk: less(self.limits.jerk, 4.0 * step / KNOT_PERIOD.powi(3)),
        }
    }

    /// A motion in pieces, some of which may take no time.
    fn course(
        &self,
        segments: &[Segment],
        duration: f64,
        target: f64,
    ) -> Result<JointMotion, MotionError> {
        let bounds = Bounds { limits: self.limits.into(), range: self.range };
        let ends = segments.iter().skip(1).map(|s| s.start).chain([duration]);
        let mut kept: Vec<Segment> =
            segments.iter().zip(ends).filter(|(s, end)| *end > s.start).map(|(s, _)| *s).collect();
        if kept.is_empty() {
            kept.push(Segment::from(0.0, self.from, 0.0));
        }
        JointMotion::new(self.joint, &kept, duration, target, bounds)
    }

    /// Stays where it is for this many seconds.
    fn rest(&self, duration: f64) -> Result<JointMotion, MotionError> {
        self.course(&[Segment::from(0.0, self.from, 0.0)], duration, self.from.position)
    }

    fn unsolved(&self, reason: String) -> TrajectoryError {
        let (joint, from) = (self.joint.to_owned(), self.from.position);
        TrajectoryError::Unsolved { joint, from, to: self.to, reason }
    }
}

impl From<MotionLimits> for Limits {
    fn from(limits: MotionLimits) -> Self {
        let MotionLimits { velocity, acceleration, jerk } = limits;
        Self { velocity, acceleration, jerk }
    }
}

/// Seconds between knots at least, and hardly more where that does not make too many.
const KNOT_PERIOD: f64 = 0.02;
/// Knots at most: a slow motion has them farther apart.
const MAX_KNOTS: usize = 400;
/// Share of the limits that is used at least.
const LEAST_USED: f64 = 0.5;
/// Seconds between the instants at which it is looked where a brake would end, and how many there
/// are at most.
const BRAKE_PERIOD: f64 = 0.001;
const MAX_BRAKES: usize = 20_000;
/// Largest distance by which a brake may leave the range, rad or m.
const BRAKE_SLACK: f64 = 1e-6;

/// The motion of a joint from rest to rest as fast as the limits allow.
///
/// # Errors
/// [`TrajectoryError`].
pub fn time_optimal(
    joint: &str,
    from: f64,
    to: f64,
    limits: &MotionLimits,
) -> Result<JointMotion, TrajectoryError> {
    let task = Task::between(joint, from, to, *limits);
    let motions = together(&[task], Synchronisation::Independent)?;
    motions.into_iter().next().ok_or_else(|| task.unsolved("nothing came of it".to_owned()))
}

/// Motions of joints that begin at one instant: each as fast as it may, or all arriving at once.
///
/// # Errors
/// [`TrajectoryError`].
pub fn together(
    tasks: &[Task],
    synchronisation: Synchronisation,
) -> Result<Vec<JointMotion>, TrajectoryError> {
    for task in tasks {
        let Sample { position: from, velocity, acceleration } = task.from;
        if ![from, velocity, acceleration, task.to].iter().all(|x| x.is_finite()) {
            let joint = task.joint.to_owned();
            return Err(TrajectoryError::NotFinite { joint, from, to: task.to });
        }
    }
    let (still, moving): (Vec<Task>, Vec<Task>) = tasks.iter().partition(|t| t.is_still());
    let mut motions = match synchronisation {
        Synchronisation::Independent => {
            let alone = moving.iter().map(|t| group(std::slice::from_ref(t), synchronisation));
            alone.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect()
        }
        _ => group(&moving, synchronisation)?,
    };
    let duration = motions.iter().map(JointMotion::duration).fold(KNOT_PERIOD, f64::max);
    for task in still {
        motions.push(task.rest(duration).map_err(|e| task.unsolved(e.to_string()))?);
    }
    let place = |motion: &JointMotion| tasks.iter().position(|t| t.joint == motion.name());
    motions.sort_by_key(place);
    Ok(motions)
}

/// The best of the motions that can be braked at any instant: as the solver has it, or by way of
/// rest.
fn group(
    tasks: &[Task],
    synchronisation: Synchronisation,
) -> Result<Vec<JointMotion>, TrajectoryError> {
    let from_rest = tasks.iter().all(|t| t.from.velocity == 0.0 && t.from.acceleration == 0.0);
    let straight = from_rest && synchronisation == Synchronisation::Phase;
    let solved = if straight { in_proportion(tasks) } else { solve(tasks, synchronisation) };
    let why = match solved {
        Ok(motions) if motions.iter().all(brakes_inside) => return Ok(motions),
        Ok(_) => "a brake would leave the range".to_owned(),
        Err(why) => why,
    };
    let otherwise = if from_rest { in_proportion(tasks) } else { by_way_of_rest(tasks) };
    match (otherwise, tasks.first()) {
        (Ok(motions), _) if motions.iter().all(brakes_inside) => Ok(motions),
        (Err(why), Some(first)) => Err(first.unsolved(why)),
        (_, Some(first)) => Err(first.unsolved(why)),
        (_, None) => Ok(Vec::new()),
    }
}

/// True where the motion can be braked at any instant without leaving its range.
fn brakes_inside(motion: &JointMotion) -> bool {
    let bounds = motion.bounds();
    let [low, high] = bounds.range;
    let steps = ((motion.duration() / BRAKE_PERIOD) as usize).clamp(1, MAX_BRAKES);
    (0..=steps).all(|i| {
        let time = motion.duration() * i as f64 / steps as f64;
        let end = stop(motion.at(time), &bounds.limits).position;
        (low - BRAKE_SLACK..=high + BRAKE_SLACK).contains(&end)
    })
}

/// The solver's motions.
fn solve(tasks: &[Task], synchronisation: Synchronisation) -> Result<Vec<JointMotion>, String> {
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
fn in_proportion(tasks: &[Task]) -> Result<Vec<JointMotion>, String> {
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

/// Motions that come to rest as soon as they can, and go on from there, all from one instant.
fn by_way_of_rest(tasks: &[Task]) -> Result<Vec<JointMotion>, String> {
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

/// Knots of a motion, evenly spread, at least two: each at a whole microsecond, the first at 0,
/// the last at rest at the target.
pub fn knots(motion: &JointMotion) -> Vec<Knot> {
    let steps = ((motion.duration() / KNOT_PERIOD) as usize).clamp(1, MAX_KNOTS - 1);
    (0..=steps)
        .map(|i| {
            let t = (motion.duration() * i as f64 / steps as f64 * 1e6).ceil() * 1e-6;
            let sample = motion.at(t);
            Knot { t, q: sample.position, qd: sample.velocity, qdd: sample.acceleration }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_limits() -> impl Strategy<Value = MotionLimits> {
        (0.1..2.0_f64, 0.2..4.0_f64, 0.5..20.0_f64).prop_map(|(velocity, acceleration, jerk)| {
            MotionLimits { velocity, acceleration, jerk }
        })
    }

    fn any_synchronisation() -> impl Strategy<Value = Synchronisation> {
        prop_oneof![
            Just(Synchronisation::Independent),
            Just(Synchronisation::Time),
            Just(Synchronisation::Phase),
        ]
    }

    const NAMES: [&str; 4] = ["a", "b", "c", "d"];

    /// Joints at rest, and where they are to go.
    fn any_tasks() -> impl Strategy<Value = Vec<Task<'static>>> {
        let one = (-2.0..2.0_f64, prop_oneof![Just(0.0), -2.0..2.0_f64], any_limits());
        proptest::collection::vec(one, 1..=NAMES.len()).prop_map(|all| {
            let task = |(i, (from, way, limits)): (usize, (f64, f64, MotionLimits))| {
                Task::between(NAMES[i], from, from + way, limits)
            };
            all.into_iter().enumerate().map(task).collect()
        })
    }

    proptest! {
        #[test]
        fn limits_hold_and_the_target_is_reached(
            from in -2.0..2.0_f64, to in -2.0..2.0_f64, limits in any_limits(),
        ) {
            let MotionLimits { velocity, acceleration, jerk } = limits;
            let knots = knots(&time_optimal("joint1", from, to, &limits).unwrap());
            prop_assert!(knots.len() >= 2);
            prop_assert_eq!(knots[0].t, 0.0);
            prop_assert!((knots[0].q - from).abs() < 1e-9);
            prop_assert_eq!(knots.last().unwrap().q, to);
            for pair in knots.windows(2) {
                prop_assert!(pair[1].t > pair[0].t);
                prop_assert!(pair[1].qd.abs() <= velocity * (1.0 + 1e-9));
                prop_assert!(pair[1].qdd.abs() <= acceleration * (1.0 + 1e-9));
                let jerk_seen = (pair[1].qdd - pair[0].qdd) / (pair[1].t - pair[0].t);
                prop_assert!(jerk_seen.abs() <= jerk * (1.0 + 1e-6));
                // Nothing overshoots.
                prop_assert!(pair[1].q >= from.min(to) - 1e-9 && pair[1].q <= from.max(to) + 1e-9);
            }
        }

        #[test]
        fn joints_that_are_synchronised_arrive_at_once_and_in_proportion_where_asked(
            tasks in any_tasks(), at in 0.0..1.0_f64,
        ) {
            let alone = together(&tasks, Synchronisation::Independent).unwrap();
            for how in [Synchronisation::Time, Synchronisation::Phase] {
                let motions = together(&tasks, how).unwrap();
                let duration = motions[0].duration();
                for ((motion, task), alone) in motions.iter().zip(&tasks).zip(&alone) {
                    prop_assert_eq!((motion.name(), motion.target()), (task.joint, task.to));
                    prop_assert!((motion.duration() - duration).abs() < 1e-6);
                    prop_assert!(motion.duration() >= alone.duration() - 1e-6);
                }
                if how == Synchronisation::Phase {
                    let share = |m: &JointMotion, t: &Task| {
                        (m.at(at * duration).position - t.from.position) / (t.to - t.from.position)
                    };
                    let moving = motions.iter().zip(&tasks).filter(|(_, t)| t.to != t.from.position);
                    let shares: Vec<f64> = moving.map(|(m, t)| share(m, t)).collect();
                    prop_assert!(shares.iter().all(|s| (s - shares[0]).abs() < 1e-9), "{shares:?}");
                }
            }
        }

        #[test]
        fn a_motion_goes_on_from_what_the_joints_do_and_can_be_braked_within_the_range(
            tasks in any_tasks(), how in any_synchronisation(), again in any_synchronisation(),
            at in 0.0..1.0_f64, target in 0.0..1.0_f64,
        ) {
            let motions = together(&tasks, how).unwrap();
            let time = at * motions.iter().map(JointMotion::duration).fold(0.0, f64::max);
            let onward: Vec<Task> = motions.iter().zip(&tasks).map(|(motion, task)| {
                let [low, high] = task.range;
                let to = low + target * (high - low);
                Task::within(task.joint, motion.at(time), to, task.limits, task.range)
            }).collect();
            for (motion, task) in together(&onward, again).unwrap().iter().zip(&onward) {
                prop_assert_eq!(motion.at(0.0), task.from);
                prop_assert_eq!(motion.target(), task.to);
                prop_assert!(brakes_inside(motion));
            }
        }

        #[test]
        fn a_motion_by_way_of_rest_is_a_motion(
            tasks in any_tasks(), at in 0.0..1.0_f64, target in 0.0..1.0_f64,
        ) {
            let motions = together(&tasks, Synchronisation::Independent).unwrap();
            let onward: Vec<Task> = motions.iter().zip(&tasks).map(|(motion, task)| {
                let [low, high] = task.range;
                let (from, to) = (motion.at(at * motion.duration()), low + target * (high - low));
                Task::within(task.joint, from, to, task.limits, task.range)
            }).collect();
            for (motion, task) in by_way_of_rest(&onward).unwrap().iter().zip(&onward) {
                prop_assert_eq!((motion.at(0.0), motion.target()), (task.from, task.to));
                prop_assert!(brakes_inside(motion));
            }
        }
    }

    #[test]
    fn nan_is_refused() {
        let limits = MotionLimits { velocity: 1.0, acceleration: 1.0, jerk: 1.0 };
        assert!(time_optimal("joint1", f64::NAN, 1.0, &limits).is_err());
    }

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
