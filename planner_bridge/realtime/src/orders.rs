//! The planner's end of a stream: what is commanded, what is to follow, and the result of it.

use crate::motion::{JointMotion, Motion};
use crate::reason::{Reason, Refusal};
use crate::segment::Sample;
use crate::shared::{Phase, Shared, Status};
use crate::stream::{Order, seconds};
use heapless::spsc::Producer;

/// Why nothing can be ordered at this moment; soon it can.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotNow {
    /// What moves is being braked.
    Braking,
    /// The order before is not followed yet.
    Deciding,
    /// What moves is about to come to rest at its target.
    Arriving,
    /// The stream cannot be heard.
    Silent,
}

impl core::fmt::Display for NotNow {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Braking => "what moves is being braked",
            Self::Deciding => "the order before is not followed yet",
            Self::Arriving => "what moves is about to arrive",
            Self::Silent => "the stream of setpoints cannot be heard",
        })
    }
}

impl core::error::Error for NotNow {}

/// Longest time, seconds, between the rest of a joint and the setpoint that tells it. The slowest stream
/// sends one setpoint a second and may miss one.
const UNTOLD_S: f64 = 2.5;

/// A motion at an instant, from which another may go on.
#[derive(Debug, Clone, PartialEq)]
pub struct Moving {
    motion: Motion,
    time: f64,
    at_us: u64,
}

impl Moving {
    /// What a motion is this many seconds after its start, at an instant of the monotonic clock.
    pub fn new(motion: Motion, time: f64, at_us: u64) -> Self {
        Self { motion, time, at_us }
    }

    /// The instant, microseconds of the monotonic clock.
    pub fn at_us(&self) -> u64 {
        self.at_us
    }

    /// The object that moves.
    pub fn object(&self) -> &str {
        self.motion.object()
    }

    /// Joints that a motion which goes on from here has to contain, and what each is commanded to do
    /// at the instant: those that move, and those that came to rest so recently that the consumer
    /// may not know it yet.
    pub fn unsettled(&self) -> impl Iterator<Item = (&JointMotion, Sample)> {
        let lately = self.motion.joints().iter().filter(|j| j.duration() + UNTOLD_S > self.time);
        lately.map(|j| (j, j.at(self.time)))
    }

    /// What a joint is commanded to do at the instant, if it is part of the motion.
    pub fn joint(&self, name: &str) -> Option<Sample> {
        self.motion.joint(name).map(|j| j.at(self.time))
    }
}

/// Something that became of an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Notice {
    /// A motion came to rest: at its target, or braked and why.
    Ended(Option<Reason>),
    /// An order was not followed.
    Refused(Refusal),
}

/// Gives orders to a stream, one after the other.
pub struct Orders<'q> {
    queue: Producer<'q, Order>,
    shared: &'q Shared,
    /// The newest order and the one before, of which the stream follows either.
    given: [Option<(u32, Motion)>; 2],
    newest: u32,
    cancelled: u32,
    ends_told: u32,
    decided_told: u32,
}

impl<'q> Orders<'q> {
    /// The other end of the queue that a stream has.
    pub fn new(queue: Producer<'q, Order>, shared: &'q Shared) -> Self {
        let given = [None, None];
        let (newest, cancelled, ends_told, decided_told) = (0, 0, 0, 0);
        Self { queue, shared, given, newest, cancelled, ends_told, decided_told }
    }

    /// The stream has followed the newest order, or refused it.
    pub fn is_decided(&self) -> bool {
        self.shared.status().is_some_and(|status| status.decided == self.newest)
    }

    /// What will be commanded at an instant, microseconds of the monotonic clock; none where
    /// nothing moves.
    ///
    /// # Errors
    /// [`NotNow`] where that cannot be said.
    pub fn commanded_at(&self, at_us: u64) -> Result<Option<Moving>, NotNow> {
        let status = self.shared.status().ok_or(NotNow::Silent)?;
        if status.cancelled != self.cancelled || status.phase == Phase::Braking {
            return Err(NotNow::Braking);
        }
        if status.decided != self.newest {
            return Err(NotNow::Deciding);
        }
        if status.phase == Phase::Rest {
            return Ok(None);
        }
        let motion = self.motion(status.order).ok_or(NotNow::Silent)?;
        let time = seconds(at_us.saturating_sub(status.start_us));
        if time >= motion.duration() {
            return Err(NotNow::Arriving);
        }
        Ok(Some(Moving::new(motion.clone(), time, at_us)))
    }

    /// Runs a motion: from an instant on that [`Self::commanded_at`] was asked for, or at once
    /// where nothing moves.
    ///
    /// # Errors
    /// [`NotNow::Deciding`] where orders come faster than they are followed.
    pub fn run(&mut self, motion: &Motion, start_us: Option<u64>) -> Result<(), NotNow> {
        let status = self.shared.status().ok_or(NotNow::Silent)?;
        // Numbers wrap; 0 is that of no order.
        let number = self.newest.wrapping_add(1).max(1);
        let order = Order { number, motion: motion.clone(), start_us };
        // A queue divides by its places. That it has some is told to the compiler here, for a
        // division by 0 would be a panic.
        self.queue.capacity().checked_add(1).ok_or(NotNow::Silent)?;
        self.queue.enqueue(order).map_err(|_| NotNow::Deciding)?;
        let running = self.given.iter_mut().find_map(|g| g.take_if(|(n, _)| *n == status.order));
        self.given = [running, Some((number, motion.clone()))];
        self.newest = number;
        Ok(())
    }

    /// Brakes what runs and drops what was ordered.
    pub fn brake(&mut self, why: Reason) {
        self.cancelled = self.newest;
        self.shared.cancel(self.newest, why);
    }

    /// The result of an order since this was asked last.
    pub fn poll(&mut self) -> Option<Notice> {
        let status = self.shared.status()?;
        if status.ends != self.ends_told {
            self.ends_told = status.ends;
            return Some(Notice::Ended(status.reason));
        }
        if status.decided != self.decided_told {
            self.decided_told = status.decided;
            return status.refusal.map(Notice::Refused);
        }
        None
    }

    /// What the stream is doing; none where it cannot be heard.
    pub fn status(&self) -> Option<Status> {
        self.shared.status()
    }

    /// The motion that runs, is braked or waits to run; none where nothing moves.
    pub fn running(&self) -> Option<&Motion> {
        let status = self.shared.status()?;
        if status.decided != self.newest {
            return self.motion(self.newest);
        }
        (status.phase != Phase::Rest).then(|| self.motion(status.order))?
    }

    fn motion(&self, number: u32) -> Option<&Motion> {
        self.given.iter().flatten().find(|(n, _)| *n == number).map(|(_, motion)| motion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datagram::DATAGRAM_CAPACITY;
    use crate::motion::tests::there;
    use crate::stream::{OrderQueue, Stream, Watch};

    const WATCH: Watch =
        Watch { frame_age_us: 500_000, heartbeat_age_us: None, longest_gap_us: 50_000 };

    fn door() -> Motion {
        let mut motion = Motion::new("door").unwrap();
        motion.push(there(2.0, 0.5)).unwrap();
        motion
    }

    #[test]
    fn what_will_be_commanded_is_what_the_stream_will_send() {
        let (mut queue, shared) = (OrderQueue::new(), Shared::default());
        let (given, taken) = queue.split();
        let mut orders = Orders::new(given, &shared);
        let mut stream = Stream::new(taken, &shared, "S", WATCH);
        let mut tick = |at_us| stream.tick(at_us, 0, &mut [0; DATAGRAM_CAPACITY]).unwrap();
        shared.frame_seen(1_000_000);
        tick(1_000_000);
        assert_eq!(orders.commanded_at(1_000_000), Ok(None));
        orders.run(&door(), None).unwrap();
        assert_eq!(orders.commanded_at(1_000_000), Err(NotNow::Deciding));
        tick(1_010_000);
        let Ok(Some(moving)) = orders.commanded_at(1_310_000) else { panic!() };
        assert_eq!((moving.object(), moving.at_us()), ("door", 1_310_000));
        assert_eq!(moving.joint("joint1"), Some(there(2.0, 0.5).at(0.3)));
        assert_eq!(moving.unsettled().count(), 1);
        assert_eq!(orders.commanded_at(9_310_000), Err(NotNow::Arriving));
        orders.brake(Reason::Cancelled);
        assert_eq!(orders.commanded_at(1_310_000), Err(NotNow::Braking), "not heard of yet");
        tick(1_020_000);
        assert_eq!(orders.commanded_at(1_310_000), Err(NotNow::Braking));
        assert_eq!(orders.status().map(|s| s.phase), Some(Phase::Braking));
        assert!(orders.running().is_some());
        (103..190).for_each(|n| _ = tick(n * 10_000));
        assert_eq!(orders.poll(), Some(Notice::Ended(Some(Reason::Cancelled))));
        assert_eq!((orders.poll(), orders.running()), (None, None));
    }

    #[test]
    fn a_joint_is_settled_when_its_rest_was_told_for_sure() {
        let unsettled_at = |time| Moving::new(door(), time, 0).unsettled().count();
        let duration = door().duration();
        assert_eq!([0.0, duration, duration + 1.0].map(unsettled_at), [1; 3]);
        assert_eq!(unsettled_at(duration + UNTOLD_S), 0);
    }

    #[test]
    fn orders_that_come_too_fast_are_given_back() {
        let (mut queue, shared) = (OrderQueue::new(), Shared::default());
        let (given, _taken) = queue.split();
        let mut orders = Orders::new(given, &shared);
        assert_eq!(orders.run(&door(), None), Ok(()));
        assert_eq!(orders.run(&door(), None), Ok(()));
        assert_eq!(orders.run(&door(), None), Err(NotNow::Deciding));
    }
}
