//! A stream under orders: both ends of the queue, with a clock and a network of their own.

use crate::datagram::DATAGRAM_CAPACITY;
use crate::motion::tests::{named, there};
use crate::motion::{JointMotion, Motion};
use crate::orders::{Notice, Orders};
use crate::reason::{Reason, Refusal};
use crate::shared::Shared;
use crate::stream::*;

const CHANNEL: &str = "LINKAGE_SETPOINT";
const WATCH: Watch =
    Watch { frame_age_us: 500_000, heartbeat_age_us: None, longest_gap_us: 50_000 };
const PERIOD_US: u64 = 5000;

fn door(quarter: f64) -> Motion {
    let mut motion = Motion::new("door").unwrap();
    motion.push(there(1.0, quarter)).unwrap();
    motion
}

/// Both ends of a stream, under a clock of its own.
struct Both<'q> {
    orders: Orders<'q>,
    stream: Stream<'q>,
    shared: &'q Shared,
    now_us: u64,
    frames_come: bool,
    network_takes: bool,
    out: [u8; DATAGRAM_CAPACITY],
}

/// What a setpoint says of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Said {
    last: bool,
    reason: Option<Reason>,
}

const GOES_ON: Said = Said { last: false, reason: None };
const ARRIVED: Said = Said { last: true, reason: None };

impl Both<'_> {
    fn tick(&mut self) -> Option<Said> {
        self.after(PERIOD_US)
    }

    fn after(&mut self, gap_us: u64) -> Option<Said> {
        self.now_us += gap_us;
        if self.frames_come {
            self.shared.frame_seen(self.now_us);
        }
        let tick = self.stream.tick(self.now_us, 0, &mut self.out).unwrap();
        let Tick::Send(length) = tick else { return None };
        self.stream.sent(self.now_us, self.network_takes);
        let said = &self.out[..length];
        let last = said[8 + CHANNEL.len() + 1 + 8 + 8 + 4 + 8] == 1;
        let reasons = (1..20).map_while(Reason::of);
        let reason =
            reasons.into_iter().find(|r| said[..length - 1].ends_with(r.text().as_bytes()));
        Some(Said { last, reason })
    }

    /// Ticks until the last setpoint, and that.
    fn run_to_end(&mut self) -> (usize, Said) {
        for n in 1..10_000 {
            match self.tick() {
                Some(said) if said.last => return (n, said),
                _ => {}
            }
        }
        panic!("it never ends")
    }
}

/// Works with both ends of a stream.
fn with(watch: Watch, work: impl FnOnce(&mut Both)) {
    let (mut queue, shared) = (OrderQueue::new(), Shared::default());
    let (given, taken) = queue.split();
    let mut both = Both {
        orders: Orders::new(given, &shared),
        stream: Stream::new(taken, &shared, CHANNEL, watch),
        shared: &shared,
        now_us: 7_000_000,
        frames_come: true,
        network_takes: true,
        out: [0; DATAGRAM_CAPACITY],
    };
    both.tick();
    work(&mut both);
}

#[test]
fn a_motion_is_streamed_to_its_end_and_no_further() {
    with(WATCH, |it| {
        assert_eq!(it.tick(), None);
        it.orders.run(&door(0.005), None).unwrap();
        assert_eq!(it.run_to_end(), (5, ARRIVED), "at 0, 5, 10, 15 and 20 ms");
        assert_eq!(it.orders.poll(), Some(Notice::Ended(None)));
        assert_eq!((it.tick(), it.stream.is_at_rest()), (None, true));
    });
}

#[test]
fn a_motion_is_braked_when_frames_stop_coming_and_says_why() {
    for (reported, reason) in
        [(None, Reason::NoFrame), (Some(Reason::JointLost), Reason::JointLost)]
    {
        with(WATCH, |it| {
            it.orders.run(&door(0.5), None).unwrap();
            (0..40).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
            it.frames_come = false;
            reported.into_iter().for_each(|d| it.shared.frame_rejected(d));
            (0..100).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
            let (ticks, said) = it.run_to_end();
            assert_eq!(said, Said { last: true, reason: Some(reason) });
            assert!(ticks < 100, "{ticks} setpoints");
            assert_eq!(it.orders.poll(), Some(Notice::Ended(Some(reason))));
        });
    }
}

#[test]
fn a_motion_is_braked_when_a_required_heartbeat_is_missing() {
    let watch = Watch { heartbeat_age_us: Some(100_000), ..WATCH };
    with(watch, |it| {
        it.orders.run(&door(0.5), None).unwrap();
        assert_eq!(it.tick(), None);
        assert_eq!(it.orders.poll(), Some(Notice::Refused(Refusal::NoHeartbeat)));
        it.shared.heartbeat(it.now_us);
        it.orders.run(&door(0.5), None).unwrap();
        (0..20).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
        let (_, said) = it.run_to_end();
        assert_eq!(said.reason, Some(Reason::NoHeartbeat));
    });
}

#[test]
fn a_motion_is_braked_when_it_is_cancelled_and_what_waits_never_begins() {
    with(WATCH, |it| {
        it.orders.run(&door(0.5), None).unwrap();
        (0..60).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
        let at_us = it.now_us + 30_000;
        let Ok(Some(moving)) = it.orders.commanded_at(at_us) else { panic!() };
        let mut next = Motion::new("door").unwrap();
        moving.unsettled().for_each(|(j, _)| next.push(j.brake(0.33)).unwrap());
        it.orders.run(&next, Some(at_us)).unwrap();
        it.orders.brake(Reason::Replaced);
        let (ticks, said) = it.run_to_end();
        assert_eq!(said, Said { last: true, reason: Some(Reason::Replaced) });
        assert!(ticks > 10, "it does not stop dead");
        assert_eq!(it.orders.poll(), Some(Notice::Ended(Some(Reason::Replaced))));
        assert_eq!(it.orders.poll(), Some(Notice::Refused(Refusal::Cancelled)));
        assert_eq!(it.tick(), None);
    });
}

#[test]
fn what_moves_is_halted_at_the_next_tick_from_any_thread() {
    with(WATCH, |it| {
        it.orders.run(&door(0.5), None).unwrap();
        (0..60).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
        it.shared.halt(Reason::Cancelled);
        it.frames_come = false;
        assert_eq!(it.tick(), Some(Said { last: false, reason: Some(Reason::Cancelled) }));
        let (ticks, said) = it.run_to_end();
        assert_eq!(said, Said { last: true, reason: Some(Reason::Cancelled) });
        assert!(ticks > 5, "it stops dead, after {ticks}");
        it.orders.run(&door(0.5), None).unwrap();
        assert_eq!(it.tick(), None, "nothing starts before a frame is seen");
    });
}

#[test]
fn a_long_pause_is_not_caught_up_with() {
    with(WATCH, |it| {
        it.orders.run(&door(0.5), None).unwrap();
        (0..60).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
        let before = it.out;
        let said = it.after(1_000_000);
        assert_eq!(said, Some(Said { last: false, reason: Some(Reason::Stalled) }));
        // Joints stand where the last setpoint left them.
        let joints = 8 + CHANNEL.len() + 1 + 8 + 8 + 4 + 8 + 1;
        let length = 4 + 5 + 4 + 4 + 7 + 3 * 8;
        assert_eq!(before[joints..joints + length], it.out[joints..joints + length]);
        // A pause in the brake is none of the brake's time.
        it.tick();
        let before = it.out;
        it.after(1_000_000);
        assert_eq!(before[joints..joints + length], it.out[joints..joints + length]);
        assert!(it.run_to_end().1.last);
    });
}

#[test]
fn a_motion_is_braked_when_the_network_takes_no_setpoints() {
    with(WATCH, |it| {
        it.orders.run(&door(0.5), None).unwrap();
        // A setpoint that is taken in between starts the count anew.
        for lost in [8, 9] {
            it.network_takes = true;
            assert_eq!(it.tick(), Some(GOES_ON));
            it.network_takes = false;
            (0..lost).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
        }
        let (_, said) = it.run_to_end();
        assert_eq!(said, Said { last: true, reason: Some(Reason::NotSent) });
    });
}

#[test]
fn an_order_that_would_make_a_joint_jump_is_refused_and_what_runs_goes_on() {
    with(WATCH, |it| {
        it.orders.run(&door(0.5), None).unwrap();
        (0..60).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
        let at_us = it.now_us + PERIOD_US;
        it.orders.run(&door(0.5), Some(at_us)).unwrap();
        assert_eq!(it.tick(), Some(GOES_ON));
        assert_eq!(it.orders.poll(), Some(Notice::Refused(Refusal::Jump)));
        // The right one, but too late.
        let Ok(Some(moving)) = it.orders.commanded_at(it.now_us) else { panic!() };
        let mut next = Motion::new("door").unwrap();
        moving.unsettled().for_each(|(j, _)| next.push(j.brake(0.3)).unwrap());
        it.orders.run(&next, Some(it.now_us - PERIOD_US)).unwrap();
        assert_eq!(it.tick(), Some(GOES_ON));
        assert_eq!(it.orders.poll(), Some(Notice::Refused(Refusal::Late)));
        assert_eq!(it.run_to_end().1, ARRIVED);
    });
}

#[test]
fn a_joint_is_not_left_out_before_a_setpoint_told_that_it_rests() {
    let accepted = |ticks_before_its_rest: u64, pause_us: u64| {
        let mut result = None;
        with(WATCH, |it| {
            let mut both = door(0.5);
            // Rests after 100 ms.
            both.push(named("joint2", there(1.0, 0.025))).unwrap();
            it.orders.run(&both, None).unwrap();
            (0..=20 - ticks_before_its_rest).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
            let start_us = it.now_us + ticks_before_its_rest * PERIOD_US;
            let Ok(Some(moving)) = it.orders.commanded_at(start_us) else { panic!() };
            assert_eq!(moving.unsettled().count(), 2);
            let mut alone = Motion::new("door").unwrap();
            alone.push(both.joints()[0].brake(0.1)).unwrap();
            it.orders.run(&alone, Some(start_us)).unwrap();
            assert_eq!(it.after(pause_us), Some(GOES_ON));
            result = Some(it.orders.poll());
        });
        result.unwrap()
    };
    assert_eq!(accepted(0, PERIOD_US), None);
    assert_eq!(accepted(2, 3 * PERIOD_US), Some(Notice::Refused(Refusal::Jump)));
}

#[test]
fn nothing_starts_blindly_or_in_motion() {
    with(WATCH, |it| {
        let mut moving = Motion::new("door").unwrap();
        let brake: JointMotion = there(1.0, 0.5).brake(0.7);
        moving.push(brake).unwrap();
        it.orders.run(&moving, None).unwrap();
        assert_eq!(it.tick(), None);
        assert_eq!(it.orders.poll(), Some(Notice::Refused(Refusal::Jump)));
        it.frames_come = false;
        it.now_us += 600_000;
        it.orders.run(&door(0.5), None).unwrap();
        assert_eq!(it.tick(), None);
        assert_eq!(it.orders.poll(), Some(Notice::Refused(Refusal::NoFrame)));
    });
}

#[test]
fn a_motion_ends_even_where_no_setpoint_finds_room() {
    with(WATCH, |it| {
        it.orders.run(&door(0.005), None).unwrap();
        for _ in 0..10 {
            it.now_us += PERIOD_US;
            it.shared.frame_seen(it.now_us);
            let _ = it.stream.tick(it.now_us, 0, &mut []);
        }
        assert!(it.stream.is_at_rest());
    });
}

#[test]
fn what_moves_is_braked_when_the_service_ends() {
    with(WATCH, |it| {
        it.orders.run(&door(0.5), None).unwrap();
        (0..60).for_each(|_| assert_eq!(it.tick(), Some(GOES_ON)));
        it.stream.end();
        let (_, said) = it.run_to_end();
        assert_eq!(said, Said { last: true, reason: Some(Reason::ServiceEnds) });
        it.orders.run(&door(0.5), None).unwrap();
        assert_eq!(it.tick(), None);
    });
}
