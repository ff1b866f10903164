//! Setpoints of the motion that was ordered last, one a tick.

use crate::datagram::{Head, TooLong, write_setpoint};
use crate::motion::Motion;
use heapless::spsc::{Consumer, Queue};

/// Orders that wait between two ticks at most, less one.
const WAITING: usize = 4;

/// What a stream is told: a motion to run from now on, or to stop where it is.
pub type OrderQueue = Queue<Option<Motion>, WAITING>;
/// The stream's end of the queue.
pub type Orders<'q> = Consumer<'q, Option<Motion>>;

/// What a tick asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tick {
    /// Nothing moves.
    Idle,
    /// So many bytes of the buffer are to be sent.
    Send(usize),
}

/// Runs one motion at a time.
pub struct Stream<'q> {
    orders: Orders<'q>,
    channel: &'q str,
    running: Option<Running>,
    sequence: u32,
}

struct Running {
    motion: Motion,
    start_us: i64,
}

impl<'q> Stream<'q> {
    /// A stream of setpoints for an LCM channel.
    pub fn new(orders: Orders<'q>, channel: &'q str) -> Self {
        Self { orders, channel, running: None, sequence: 0 }
    }

    /// Writes the datagram of this instant, microseconds since 1970, into the buffer. A motion
    /// begins with the tick that finds its order; the last of its setpoints says so.
    ///
    /// # Errors
    /// [`TooLong`] when the buffer is shorter than [`crate::DATAGRAM_CAPACITY`].
    pub fn tick(&mut self, now_us: i64, out: &mut [u8]) -> Result<Tick, TooLong> {
        for _ in 0..WAITING {
            let Some(order) = self.orders.dequeue() else { break };
            self.running = order.map(|motion| Running { motion, start_us: now_us });
        }
        let Some(Running { motion, start_us }) = &self.running else { return Ok(Tick::Idle) };
        let time = now_us.saturating_sub(*start_us) as f64 * 1e-6;
        let last = time >= motion.duration();
        let head = Head { utime: now_us, sequence: self.sequence, last };
        let bytes = write_setpoint(out, self.channel, head, motion, time)?;
        self.sequence = self.sequence.wrapping_add(1);
        if last {
            self.running = None;
        }
        Ok(Tick::Send(bytes))
    }

    /// True while a motion runs.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DATAGRAM_CAPACITY;
    use crate::motion::{JointMotion, Segment};

    fn motion(duration: f64) -> Motion {
        let mut motion = Motion::new("door").unwrap();
        let segment = Segment { velocity: 1.0, ..Segment::default() };
        motion.push(JointMotion::new("joint1", &[segment], duration, duration).unwrap()).unwrap();
        motion
    }

    #[test]
    fn a_motion_is_streamed_to_its_end_and_no_further() {
        let mut queue = OrderQueue::new();
        let (mut orders, taken) = queue.split();
        let mut stream = Stream::new(taken, "LINKAGE_SETPOINT");
        let mut out = [0; DATAGRAM_CAPACITY];
        assert_eq!(stream.tick(0, &mut out), Ok(Tick::Idle));
        orders.enqueue(Some(motion(0.02))).unwrap();
        let sent = (1..100).filter(|i| stream.tick(i * 5000, &mut out) != Ok(Tick::Idle)).count();
        assert_eq!(sent, 5, "at 0, 5, 10, 15 and 20 ms");
        assert!(!stream.is_running());
    }

    #[test]
    fn the_newest_order_counts() {
        let mut queue = OrderQueue::new();
        let (mut orders, taken) = queue.split();
        let mut stream = Stream::new(taken, "LINKAGE_SETPOINT");
        let mut out = [0; DATAGRAM_CAPACITY];
        orders.enqueue(Some(motion(10.0))).unwrap();
        orders.enqueue(None).unwrap();
        assert_eq!(stream.tick(0, &mut out), Ok(Tick::Idle));
        orders.enqueue(None).unwrap();
        orders.enqueue(Some(motion(10.0))).unwrap();
        assert!(matches!(stream.tick(5000, &mut out), Ok(Tick::Send(_))));
    }
}
