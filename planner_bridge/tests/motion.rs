//! The motion never jumps: 10 000 random sequences of starts, other targets, cancellations, losses
//! and stalls, streamed at a kilohertz. Each setpoint is decoded from the datagram that is sent and
//! held against the one before.

use linkage_lcm::decode;
use linkage_lcm::messages::linkage::Setpoint;
use linkage_planner_bridge::{MotionLimits, Synchronisation, Task, together};
use linkage_realtime::{
    DATAGRAM_CAPACITY, Motion, Moving, OrderQueue, Orders, Reason, Sample, Shared, Stream, Tick,
    Watch,
};
use proptest::prelude::*;

const CHANNEL: &str = "S";
const TICK_US: u64 = 1000;
const WATCH: Watch =
    Watch { frame_age_us: 60_000, heartbeat_age_us: Some(40_000), longest_gap_us: 30_000 };
/// From the making of a plan to its beginning.
const LEAD_US: u64 = 10_000;
const NAMES: [&str; 3] = ["door", "drawer", "shelf"];
/// Solvers meet their targets to about 1e-8; the range may be left by 1e-6.
const ROUNDING: f64 = 2e-6;

/// What a joint can do.
#[derive(Debug, Clone)]
struct Joint {
    limits: MotionLimits,
    range: [f64; 2],
    /// Where it is at first, as a share of its range.
    at: f64,
}

#[derive(Debug, Clone)]
enum Event {
    /// Some of the joints to shares of their ranges; the order is given this many ticks after it
    /// was planned.
    Target {
        joints: [bool; 3],
        to: [f64; 3],
        slow_by: u64,
    },
    Cancel,
    /// No frames, or none that tells, for this many ticks.
    Loss {
        ticks: u64,
        doubt: Option<bool>,
    },
    /// No heartbeat for this many ticks.
    Silence {
        ticks: u64,
    },
    /// No tick for this long.
    Stall {
        us: u64,
    },
    /// The network takes nothing for this many ticks.
    Deaf {
        ticks: u64,
    },
    /// The host's clock is corrected.
    Correction {
        us: i64,
    },
}

fn any_joint() -> impl Strategy<Value = Joint> {
    let limits = (0.2..2.0_f64, 1.0..8.0_f64, 5.0..80.0_f64);
    (limits, -1.0..1.0_f64, 0.05..1.0_f64, 0.0..1.0_f64).prop_map(
        |((velocity, acceleration, jerk), low, length, at)| Joint {
            limits: MotionLimits { velocity, acceleration, jerk },
            range: [low, low + length],
            at,
        },
    )
}

fn any_event() -> impl Strategy<Value = Event> {
    let target = (any::<[bool; 3]>(), proptest::array::uniform3(0.0..=1.0_f64), 0..14_u64)
        .prop_map(|(joints, to, slow_by)| Event::Target { joints, to, slow_by });
    prop_oneof![
        6 => target,
        1 => Just(Event::Cancel),
        1 => (20..100_u64, any::<Option<bool>>())
            .prop_map(|(ticks, doubt)| Event::Loss { ticks, doubt }),
        1 => (20..80_u64).prop_map(|ticks| Event::Silence { ticks }),
        1 => (1000..100_000_u64).prop_map(|us| Event::Stall { us }),
        1 => (1..50_u64).prop_map(|ticks| Event::Deaf { ticks }),
        1 => (-5_000_000_000..5_000_000_000_i64).prop_map(|us| Event::Correction { us }),
    ]
}

fn any_synchronisation() -> impl Strategy<Value = Synchronisation> {
    prop_oneof![
        Just(Synchronisation::Independent),
        Just(Synchronisation::Time),
        Just(Synchronisation::Phase),
    ]
}

/// A stream with what plans for it, what keeps it alive, and what receives from it.
struct Robot<'q> {
    joints: &'q [Joint],
    synchronisation: Synchronisation,
    orders: Orders<'q>,
    stream: Stream<'q>,
    shared: &'q Shared,
    now_us: u64,
    clock_us: i64,
    /// Where each joint is.
    at: Vec<f64>,
    lost_until_us: u64,
    silent_until_us: u64,
    deaf_until_us: u64,
    received: Option<(u64, Setpoint)>,
    setpoints: u64,
    reasons: Vec<String>,
}

impl Robot<'_> {
    /// Plans as `predict` does: joints that are asked for go on from what is commanded, others that
    /// move or have just come to rest come to rest.
    fn plan(&self, joints: &[bool; 3], to: &[f64; 3]) -> Option<(Motion, Option<u64>)> {
        let commanded = self.orders.commanded_at(self.now_us + LEAD_US).ok()?;
        let moving = commanded.as_ref();
        let mut tasks = Vec::new();
        for (i, joint) in self.joints.iter().enumerate().filter(|(i, _)| joints[*i]) {
            let now = moving.and_then(|m| m.joint(NAMES[i])).unwrap_or(Sample::rest(self.at[i]));
            let [low, high] = joint.range;
            let to = low + to[i] * (high - low);
            tasks.push(Task::within(NAMES[i], now, to, joint.limits, joint.range));
        }
        let mut motions = together(&tasks, self.synchronisation).unwrap();
        for (i, joint) in self.joints.iter().enumerate().filter(|(i, _)| !joints[*i]) {
            let mut unsettled = moving.into_iter().flat_map(Moving::unsettled);
            if let Some((_, now)) = unsettled.find(|(motion, _)| motion.name() == NAMES[i]) {
                let task = Task::within(NAMES[i], now, now.position, joint.limits, joint.range);
                motions.push(task.stopping().unwrap());
            }
        }
        let mut motion = Motion::new("cabinet").unwrap();
        motions.into_iter().for_each(|m| motion.push(m).unwrap());
        (!motion.joints().is_empty()).then(|| (motion, moving.map(|m| m.at_us())))
    }

    fn meet(&mut self, event: &Event) -> Result<(), TestCaseError> {
        match event {
            Event::Target { joints, to, slow_by } => {
                let planned = self.plan(joints, to);
                self.run(*slow_by)?;
                if let Some((motion, start_us)) = planned {
                    self.orders.run(&motion, start_us).unwrap();
                }
            }
            Event::Cancel => self.orders.brake(Reason::Cancelled),
            Event::Loss { ticks, doubt } => {
                self.lost_until_us = self.now_us + ticks * TICK_US;
                let why = |lost: bool| if lost { Reason::ObjectLost } else { Reason::JointLost };
                doubt.map(why).into_iter().for_each(|why| self.shared.frame_rejected(why));
            }
            Event::Silence { ticks } => self.silent_until_us = self.now_us + ticks * TICK_US,
            Event::Stall { us } => self.now_us += us,
            Event::Deaf { ticks } => self.deaf_until_us = self.now_us + ticks * TICK_US,
            Event::Correction { us } => self.clock_us += us,
        }
        Ok(())
    }

    fn run(&mut self, ticks: u64) -> Result<(), TestCaseError> {
        (0..ticks).try_for_each(|_| self.tick())
    }

    fn tick(&mut self) -> Result<(), TestCaseError> {
        self.now_us += TICK_US;
        if self.now_us >= self.lost_until_us {
            self.shared.frame_seen(self.now_us);
        }
        if self.now_us >= self.silent_until_us {
            self.shared.heartbeat(self.now_us);
        }
        let mut out = [0; DATAGRAM_CAPACITY];
        let utime = self.now_us as i64 + self.clock_us;
        let Tick::Send(length) = self.stream.tick(self.now_us, utime, &mut out).unwrap() else {
            return Ok(());
        };
        self.stream.sent(self.now_us, self.now_us >= self.deaf_until_us);
        let setpoint: Setpoint = decode(&out[8 + CHANNEL.len() + 1..length]).unwrap();
        prop_assert_eq!(setpoint.utime, utime);
        self.hold_against_limits(&setpoint)?;
        if let Some((before_us, before)) = self.received.take() {
            prop_assert_eq!(setpoint.sequence, before.sequence + 1);
            self.hold_against_the_one_before(&setpoint, &before, self.now_us - before_us)?;
        }
        self.setpoints += 1;
        self.arrive(setpoint)
    }

    fn number(&self, name: &str) -> usize {
        NAMES.iter().position(|n| *n == name).unwrap()
    }

    fn hold_against_limits(&self, s: &Setpoint) -> Result<(), TestCaseError> {
        for (k, name) in s.joint_name.iter().enumerate() {
            let Joint { limits, range, .. } = &self.joints[self.number(name)];
            prop_assert!(s.velocity[k].abs() <= limits.velocity * (1.0 + 1e-6), "{s:?}");
            prop_assert!(s.acceleration[k].abs() <= limits.acceleration * (1.0 + 1e-6), "{s:?}");
            let inside = range[0] - ROUNDING..=range[1] + ROUNDING;
            prop_assert!(inside.contains(&s.position[k]), "{s:?} leaves {range:?}");
        }
        Ok(())
    }

    /// Position, velocity and acceleration go on, with no more jerk than is allowed.
    fn hold_against_the_one_before(
        &self,
        s: &Setpoint,
        before: &Setpoint,
        gap_us: u64,
    ) -> Result<(), TestCaseError> {
        if before.last {
            return Ok(());
        }
        // After a long pause joints go on from where the last setpoint left them.
        let t = if gap_us > WATCH.longest_gap_us { 0.0 } else { gap_us as f64 * 1e-6 };
        for (k, name) in s.joint_name.iter().enumerate() {
            let Some(b) = before.joint_name.iter().position(|n| n == name) else {
                // It joins, from rest.
                let limits = &self.joints[self.number(name)].limits;
                prop_assert!(s.velocity[k].abs() <= limits.jerk * t * t / 2.0 + ROUNDING);
                continue;
            };
            let (p, v, a) = (before.position[b], before.velocity[b], before.acceleration[b]);
            let jerk = self.joints[self.number(name)].limits.jerk * (1.0 + 1e-6);
            let off = [
                (s.position[k] - (p + t * (v + t * a / 2.0))).abs() - jerk * t.powi(3) / 6.0,
                (s.velocity[k] - (v + t * a)).abs() - jerk * t.powi(2) / 2.0,
                (s.acceleration[k] - a).abs() - jerk * t,
            ];
            prop_assert!(off.iter().all(|o| *o <= ROUNDING), "{name}: {off:?}\n{before:?}\n{s:?}");
        }
        for (k, name) in before.joint_name.iter().enumerate() {
            let is_left_out = !s.joint_name.contains(name);
            let rests = before.velocity[k] == 0.0 && before.acceleration[k] == 0.0;
            prop_assert!(rests || !is_left_out, "{name} is forgotten:\n{before:?}\n{s:?}");
        }
        Ok(())
    }

    fn arrive(&mut self, s: Setpoint) -> Result<(), TestCaseError> {
        for (k, name) in s.joint_name.iter().enumerate() {
            let number = self.number(name);
            self.at[number] = s.position[k];
        }
        if s.last {
            let at_rest = s.velocity.iter().chain(&s.acceleration).all(|x| *x == 0.0);
            prop_assert!(at_rest, "{s:?}");
            self.reasons.push(s.reason.clone());
        }
        self.received = Some((self.now_us, s));
        Ok(())
    }
}

/// Runs a sequence until all is at rest; setpoints, and why each motion ended.
fn sequence(
    joints: &[Joint],
    synchronisation: Synchronisation,
    events: &[(Event, u64)],
) -> Result<(u64, Vec<String>), TestCaseError> {
    let (mut queue, shared) = (OrderQueue::new(), Shared::default());
    let (given, taken) = queue.split();
    let mut robot = Robot {
        joints,
        synchronisation,
        orders: Orders::new(given, &shared),
        stream: Stream::new(taken, &shared, CHANNEL, WATCH),
        shared: &shared,
        now_us: 1_000_000,
        clock_us: 0,
        at: joints.iter().map(|j| j.range[0] + j.at * (j.range[1] - j.range[0])).collect(),
        lost_until_us: 0,
        silent_until_us: 0,
        deaf_until_us: 0,
        received: None,
        setpoints: 0,
        reasons: Vec::new(),
    };
    robot.run(2)?;
    for (event, ticks) in events {
        robot.meet(event)?;
        robot.run(*ticks)?;
    }
    for _ in 0..60_000 {
        if robot.stream.is_at_rest() && robot.received.as_ref().is_none_or(|r| r.1.last) {
            return Ok((robot.setpoints, robot.reasons));
        }
        robot.tick()?;
    }
    Err(TestCaseError::fail("it never comes to rest"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn the_motion_never_jumps_and_always_comes_to_rest_within_its_limits(
        joints in proptest::array::uniform3(any_joint()),
        synchronisation in any_synchronisation(),
        first in (any::<[bool; 3]>(), proptest::array::uniform3(0.0..=1.0_f64)),
        events in proptest::collection::vec((any_event(), 0..200_u64), 1..8),
    ) {
        let start = Event::Target { joints: first.0, to: first.1, slow_by: 0 };
        let all = [&[(start, 50)], events.as_slice()].concat();
        sequence(&joints, synchronisation, &all)?;
    }
}

/// Joints, all three of them commanded to the far ends of their ranges.
fn far_away() -> (Vec<Joint>, Event) {
    let limits = MotionLimits { velocity: 0.5, acceleration: 1.0, jerk: 4.0 };
    let joints = vec![Joint { limits, range: [0.0, 1.0], at: 0.0 }; 3];
    (joints, Event::Target { joints: [true; 3], to: [1.0; 3], slow_by: 0 })
}

#[test]
fn each_way_in_which_a_motion_can_end_is_told() {
    let ends = |event: Event| {
        let (joints, start) = far_away();
        let events = [(start, 800), (event, 300)];
        sequence(&joints, Synchronisation::Independent, &events).unwrap().1
    };
    assert_eq!(ends(Event::Correction { us: 7_000_000 }), [""], "it arrives");
    assert_eq!(ends(Event::Stall { us: 20_000 }), [""], "it is caught up with");
    assert_eq!(ends(Event::Cancel), ["cancelled"]);
    assert_eq!(ends(Event::Loss { ticks: 100, doubt: None }), ["no new frame"]);
    assert_eq!(ends(Event::Loss { ticks: 100, doubt: Some(true) }), ["object lost"]);
    assert_eq!(ends(Event::Loss { ticks: 100, doubt: Some(false) }), ["joint lost"]);
    assert_eq!(ends(Event::Silence { ticks: 100 }), ["no heartbeat"]);
    assert_eq!(ends(Event::Stall { us: 100_000 }), ["setpoints came too late"]);
    assert_eq!(ends(Event::Deaf { ticks: 100 }), ["the network takes no setpoints"]);
}

#[test]
fn another_target_while_it_moves_is_reached_in_one_motion() {
    let (joints, start) = far_away();
    for how in [Synchronisation::Independent, Synchronisation::Time, Synchronisation::Phase] {
        let back = Event::Target { joints: [true; 3], to: [0.2, 0.3, 0.4], slow_by: 0 };
        let (setpoints, reasons) =
            sequence(&joints, how, &[(start.clone(), 800), (back, 300)]).unwrap();
        assert_eq!(reasons, [""], "it turns around without coming to an end");
        assert!(setpoints > 1500);
    }
}
