//! Setpoints of the motion that was ordered last, one a tick, and the dead man's switch.
//!
//! A motion that runs comes to rest in one of two ways: at its target, or braked, with the reason.
//! An order that would make a joint jump is refused, whatever planned it.

use crate::datagram::{Head, TooLong, write_setpoint};
use crate::motion::Motion;
use crate::reason::{Reason, Refusal};
use crate::shared::{Phase, Shared, Status, is_up_to};
use heapless::spsc::{Consumer, Queue};

/// A motion to run.
#[derive(Debug, Clone)]
pub struct Order {
    pub(crate) number: u32,
    pub(crate) motion: Motion,
    /// When it begins, microseconds of the monotonic clock; at once where nothing moves and none
    /// is given.
    pub(crate) start_us: Option<u64>,
}

/// Orders on their way to a stream.
pub type OrderQueue = Queue<Order, 3>;

/// When a stream brakes what runs. Microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Watch {
    /// Greatest age of the newest frame that tells where the joints are.
    pub frame_age_us: u64,
    /// Greatest age of the consumer's heartbeat, where one is required.
    pub heartbeat_age_us: Option<u64>,
    /// Longest pause between setpoints, or without the network taking any, that is caught up with.
    pub longest_gap_us: u64,
}

/// What a tick asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tick {
    /// Nothing moves.
    Idle,
    /// This many bytes of the buffer are to be sent.
    Send(usize),
}

/// Runs one motion at a time.
pub struct Stream<'q> {
    orders: Consumer<'q, Order>,
    shared: &'q Shared,
    channel: &'q str,
    watch: Watch,
    state: State,
    /// An order whose time has not come.
    waiting: Option<Order>,
    sequence: i64,
    /// When the last setpoint was due.
    last_us: u64,
    /// Since when the network takes none.
    unsent_since_us: Option<u64>,
    is_ending: bool,
    status: Status,
    /// The motion that ended last, and why, while nothing else moves.
    ended: Option<(Run, Option<Reason>)>,
}

enum State {
    Rest,
    Running(Run),
    Braking(Run, Reason),
}

struct Run {
    number: u32,
    motion: Motion,
    start_us: u64,
}

impl Run {
    /// Seconds from its start.
    fn time(&self, at_us: u64) -> f64 {
        seconds(at_us.saturating_sub(self.start_us))
    }

    fn is_over(&self, at_us: u64) -> bool {
        self.time(at_us) >= self.motion.duration()
    }
}

pub(crate) fn seconds(us: u64) -> f64 {
    us as f64 * 1e-6
}

impl<'q> Stream<'q> {
    /// A stream of setpoints for an LCM channel.
    pub fn new(
        orders: Consumer<'q, Order>,
        shared: &'q Shared,
        channel: &'q str,
        watch: Watch,
    ) -> Self {
        Self {
            orders,
            shared,
            channel,
            watch,
            state: State::Rest,
            waiting: None,
            sequence: 0,
            last_us: 0,
            unsent_since_us: None,
            is_ending: false,
            status: Status::default(),
            ended: None,
        }
    }

    /// Counts its setpoints from this number on. A consumer moves only on numbers above the last one's: a stream that
    /// is started again begins above all that were sent before.
    pub fn counting_from(self, sequence: i64) -> Self {
        Self { sequence, ..self }
    }

    /// Writes the datagram of a tick into the buffer.
    ///
    /// `due_us` is when the tick is due by the monotonic clock, which alone drives the motion;
    /// `utime` is that instant by the host's clock, microseconds since 1970, with which the
    /// setpoint is stamped.
    ///
    /// # Errors
    /// [`TooLong`] when the buffer is shorter than [`crate::DATAGRAM_CAPACITY`].
    pub fn tick(&mut self, due_us: u64, utime: i64, out: &mut [u8]) -> Result<Tick, TooLong> {
        self.keep_watch(due_us);
        self.handle_order(due_us);
        let result = self.write(due_us, utime, out);
        self.publish_status();
        result
    }

    /// Writes the last setpoint of the motion that ended last once more, with a number of its own, while nothing moves.
    ///
    /// # Errors
    /// As [`Self::tick`].
    pub fn repeat_last(
        &mut self,
        due_us: u64,
        utime: i64,
        out: &mut [u8],
    ) -> Result<Tick, TooLong> {
        let Some((run, reason)) = &self.ended else { return Ok(Tick::Idle) };
        let head = Head { utime, sequence: self.sequence, last: true, reason: *reason };
        let bytes = write_setpoint(out, self.channel, head, &run.motion, run.time(due_us))?;
        self.sequence = self.sequence.wrapping_add(1);
        Ok(Tick::Send(bytes))
    }

    /// Tells whether the network took the setpoint of a tick.
    pub fn sent(&mut self, due_us: u64, was_sent: bool) {
        self.unsent_since_us = match (was_sent, self.unsent_since_us) {
            (true, _) => None,
            (false, None) => Some(due_us),
            (false, since) => since,
        };
    }

    /// Brakes what runs and refuses all orders from now on.
    pub fn end(&mut self) {
        self.is_ending = true;
    }

    /// True while nothing moves.
    pub fn is_at_rest(&self) -> bool {
        matches!(self.state, State::Rest)
    }

    /// Brakes what runs where it must not run on.
    fn keep_watch(&mut self, due_us: u64) {
        // Both are looked at in each tick, so that what is too old is forgotten.
        let frames = self.shared.frames(due_us, self.watch.frame_age_us);
        let heartbeat = self.has_heartbeat(due_us);
        let (cancelled, why) = self.shared.cancelled();
        self.status.cancelled = cancelled;
        let gap = self.watch.longest_gap_us;
        let paused_us = due_us.saturating_sub(self.last_us);
        // What follows the setpoints stands where the last of them was.
        let is_stalled = paused_us > gap;
        let is_unsent = self.unsent_since_us.is_some_and(|s| due_us.saturating_sub(s) > gap);
        let number = match &mut self.state {
            State::Rest => return,
            State::Braking(run, _) => {
                if is_stalled {
                    run.start_us = run.start_us.saturating_add(paused_us);
                }
                return;
            }
            State::Running(run) => run.number,
        };
        if is_stalled {
            self.brake(self.last_us, due_us, Reason::Stalled);
        } else if self.is_ending {
            self.brake(due_us, due_us, Reason::ServiceEnds);
        } else if is_up_to(number, cancelled) {
            self.brake(due_us, due_us, why);
        } else if let Err(why) = frames {
            self.brake(due_us, due_us, why);
        } else if !heartbeat {
            self.brake(due_us, due_us, Reason::NoHeartbeat);
        } else if is_unsent {
            self.brake(due_us, due_us, Reason::NotSent);
        }
    }

    fn has_heartbeat(&self, due_us: u64) -> bool {
        let age = self.watch.heartbeat_age_us;
        age.is_none_or(|age| self.shared.has_heartbeat(due_us, age))
    }

    /// Brakes from what the motion is at one time, beginning at another.
    fn brake(&mut self, from_us: u64, start_us: u64, why: Reason) {
        if let State::Running(run) = &self.state
            && !run.is_over(from_us)
        {
            let motion = run.motion.brake(run.time(from_us));
            self.state = State::Braking(Run { number: run.number, motion, start_us }, why);
        }
    }

    /// Follows the next order when its time has come, or refuses it.
    fn handle_order(&mut self, due_us: u64) {
        // As in `Orders::run`: no division by 0.
        let has_places = self.orders.capacity().checked_add(1).is_some();
        if has_places && self.waiting.is_none() {
            self.waiting = self.orders.dequeue();
        }
        let Some(order) = &self.waiting else { return };
        let start_us = order.start_us.unwrap_or(due_us);
        let verdict = match &self.state {
            _ if self.is_ending || is_up_to(order.number, self.status.cancelled) => {
                Err(Refusal::Cancelled)
            }
            State::Braking(..) => Err(Refusal::Braking),
            _ if due_us < start_us => return,
            State::Rest => self.may_start(&order.motion, due_us).map(|()| due_us),
            // Its last setpoint is sent first.
            State::Running(run) if run.is_over(due_us) => return,
            State::Running(_) if start_us < self.last_us => Err(Refusal::Late),
            State::Running(run) if self.may_follow(&order.motion, run, start_us) => Ok(start_us),
            State::Running(_) => Err(Refusal::Jump),
        };
        self.decide(verdict);
    }

    /// Refuses to start without a fresh frame or heartbeat, or from motion.
    fn may_start(&self, motion: &Motion, due_us: u64) -> Result<(), Refusal> {
        if !motion.starts_at_rest() {
            return Err(Refusal::Jump);
        }
        if self.shared.frames(due_us, self.watch.frame_age_us).is_err() {
            return Err(Refusal::NoFrame);
        }
        if !self.has_heartbeat(due_us) {
            return Err(Refusal::NoHeartbeat);
        }
        Ok(())
    }

    /// A motion goes on from what runs without a jump, and leaves out only joints whose rest the last
    /// setpoint told.
    fn may_follow(&self, motion: &Motion, run: &Run, start_us: u64) -> bool {
        motion.follows(&run.motion, run.time(start_us))
            && motion.leaves_out_what_rests(&run.motion, run.time(self.last_us))
    }

    fn decide(&mut self, verdict: Result<u64, Refusal>) {
        let Some(Order { number, motion, .. }) = self.waiting.take() else { return };
        self.status.decided = number;
        self.status.refusal = verdict.err();
        if let Ok(start_us) = verdict {
            if self.is_at_rest() {
                self.unsent_since_us = None;
            }
            self.ended = None;
            self.state = State::Running(Run { number, motion, start_us });
        }
    }

    fn write(&mut self, due_us: u64, utime: i64, out: &mut [u8]) -> Result<Tick, TooLong> {
        let (run, reason) = match &self.state {
            State::Rest => return Ok(Tick::Idle),
            State::Running(run) => (run, None),
            State::Braking(run, reason) => (run, Some(*reason)),
        };
        let (time, last) = (run.time(due_us), run.is_over(due_us));
        let head = Head { utime, sequence: self.sequence, last, reason };
        let written = write_setpoint(out, self.channel, head, &run.motion, time);
        if last {
            let ended = core::mem::replace(&mut self.state, State::Rest);
            self.ended = match ended {
                State::Rest => None,
                State::Running(run) => Some((run, None)),
                State::Braking(run, reason) => Some((run, Some(reason))),
            };
            self.status.ends = self.status.ends.wrapping_add(1);
            self.status.reason = reason;
        }
        let bytes = written?;
        self.sequence = self.sequence.wrapping_add(1);
        self.last_us = due_us;
        Ok(Tick::Send(bytes))
    }

    /// Tells what it is doing.
    fn publish_status(&mut self) {
        let (phase, run) = match &self.state {
            State::Rest => (Phase::Rest, None),
            State::Running(run) => (Phase::Running, Some(run)),
            State::Braking(run, _) => (Phase::Braking, Some(run)),
        };
        self.status.phase = phase;
        if let Some(run) = run {
            (self.status.order, self.status.start_us) = (run.number, run.start_us);
        }
        self.shared.set_status(&self.status);
    }
}
