//! The streaming loop, a minute of it, without the clock: nothing is allocated on its thread.

use linkage_lcm::udpm::{DatagramSender, Network};
use linkage_planner_bridge::{MotionLimits, Synchronisation, Task, together};
use linkage_realtime::{
    Cycle, Motion, OrderQueue, Orders, Port, Reason, Shared, Stream, StreamReport, Watch,
};
use std::num::NonZeroU64;

const PERIOD_US: u64 = 5000;
const MINUTE_US: u64 = 60_000_000;
const WATCH: Watch =
    Watch { frame_age_us: 500_000, heartbeat_age_us: Some(200_000), longest_gap_us: 50_000 };
const LIMITS: MotionLimits = MotionLimits { velocity: 0.02, acceleration: 0.5, jerk: 2.0 };

/// A clock that each sleep advances, a real socket, and a camera that dies near the end.
struct Minute<'q> {
    now_us: u64,
    socket: DatagramSender,
    shared: &'q Shared,
    /// Tells another target half-way; what that allocates is not the loop's.
    retarget: &'q mut dyn FnMut(u64),
}

impl Port for Minute<'_> {
    fn monotonic_us(&mut self) -> u64 {
        self.now_us
    }

    fn utime(&mut self) -> i64 {
        1_700_000_000_000_000 + self.now_us as i64
    }

    fn sleep(&mut self, us: u64) {
        self.now_us += us;
        if self.now_us < MINUTE_US - 2_000_000 {
            self.shared.frame_seen(self.now_us);
        }
        self.shared.heartbeat(self.now_us);
        (self.retarget)(self.now_us);
    }

    fn send(&mut self, datagram: &[u8]) -> bool {
        self.socket.send(datagram).is_ok()
    }

    fn is_stopped(&mut self) -> bool {
        self.now_us >= MINUTE_US
    }
}

fn motion_to(tasks: &[Task]) -> Motion {
    let mut motion = Motion::new("drawer").unwrap();
    let motions = together(tasks, Synchronisation::Independent).unwrap();
    motions.into_iter().for_each(|m| motion.push(m).unwrap());
    motion
}

/// Streams for a minute, with another target half-way where one is given; how it went.
fn stream_a_minute(retargets: bool) -> (StreamReport, Option<Reason>) {
    let (mut queue, shared) = (OrderQueue::new(), Shared::default());
    let (given, taken) = queue.split();
    let mut orders = Orders::new(given, &shared);
    orders.run(&motion_to(&[Task::between("joint1", 0.0, 1.3, LIMITS)]), None).unwrap();
    let cycle = Cycle::new(
        Stream::new(taken, &shared, "LINKAGE_SETPOINT", WATCH),
        NonZeroU64::new(PERIOD_US * 1000).unwrap(),
    );
    let network = Network::parse("udpm://239.255.76.67:7717?ttl=0").unwrap();
    let mut is_told = !retargets;
    let mut retarget = |now_us: u64| {
        if is_told || now_us < MINUTE_US / 2 {
            return;
        }
        let Ok(Some(moving)) = orders.commanded_at(now_us + 30_000) else { return };
        let now = moving.joint("joint1").unwrap();
        let back = Task::within("joint1", now, 0.0, LIMITS, [0.0, 1.3]);
        orders.run(&motion_to(&[back]), Some(moving.at_us())).unwrap();
        is_told = true;
    };
    let mut port = Minute {
        now_us: 0,
        socket: network.sender().unwrap(),
        shared: &shared,
        retarget: &mut retarget,
    };
    shared.frame_seen(0);
    shared.heartbeat(0);
    let mut report = None;
    let counted = allocation_counter::measure(|| report = Some(cycle.run(&mut port)));
    if !retargets {
        assert_eq!(counted.count_total, 0, "the loop allocates");
    }
    (report.unwrap(), shared.status().unwrap().reason)
}

#[test]
fn a_minute_of_setpoints_and_a_brake_allocate_nothing() {
    let (report, reason) = stream_a_minute(false);
    assert!(report.sent + report.failed > 11_600, "{} were sent", report.sent);
    assert_eq!(reason, Some(Reason::NoFrame));
}

#[test]
fn another_target_half_way_is_followed_without_an_end_in_between() {
    let (report, reason) = stream_a_minute(true);
    assert!(report.sent + report.failed > 11_600, "{} were sent", report.sent);
    assert_eq!(reason, Some(Reason::NoFrame));
}
