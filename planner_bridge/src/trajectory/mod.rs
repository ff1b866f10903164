//! Motions of joints from what they do now to rest at a target, under limits of velocity,
//! acceleration and jerk (Berscheid & Kröger 2021, through rsruckig): as fast as each may, or
//! together.
//!
//! Every motion can be braked at any instant without leaving the joint's range. From rest that is
//! so by itself; one that begins while its joint moves is looked at, and where it is not so the
//! joint first comes to rest and then goes to its target.
//!
//! In: what each joint does now and is to do, radians or metres. Out: motions over seconds.

mod braking;
mod error;
mod knots;
mod solver;
mod task;

pub use error::TrajectoryError;
pub use knots::{Knot, knots};
pub use task::Task;

use crate::limits::{MotionLimits, Synchronisation};
use braking::{brakes_inside, by_way_of_rest};
use knots::KNOT_PERIOD;
use linkage_realtime::{JointMotion, Sample};
use solver::{in_proportion, solve};

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
}
