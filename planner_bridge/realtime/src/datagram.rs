//! `linkage.setpoint_t` as a whole LCM datagram in a fixed buffer.

use crate::motion::Motion;
use crate::reason::Reason;

/// Bytes that are always enough for a setpoint with its datagram's head.
pub const DATAGRAM_CAPACITY: usize = 1400;

/// Fingerprint of `linkage.setpoint_t`; a test holds it against the type's own.
pub const SETPOINT_FINGERPRINT: u64 = 0x22e370f297d73615;

/// Version of `linkage.setpoint_t`: 2 has the reason.
pub const SETPOINT_SCHEMA: i32 = 2;
/// How a datagram of LCM that is not split begins.
const MAGIC: u32 = 0x4c43_3032;

/// The buffer is too small.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooLong;

/// What a setpoint says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Head {
    /// When it is due, microseconds since 1970.
    pub utime: i64,
    /// Number in its stream.
    pub sequence: i64,
    /// The motion is over.
    pub last: bool,
    /// Why it is being braked, if it is.
    pub reason: Option<Reason>,
}

/// Writes the setpoint of a motion at a time, in seconds from its start; how many bytes it took.
pub(crate) fn write_setpoint(
    out: &mut [u8],
    channel: &str,
    head: Head,
    motion: &Motion,
    time: f64,
) -> Result<usize, TooLong> {
    let mut out = Writer { left: out, written: 0 };
    out.bytes(&MAGIC.to_be_bytes())?;
    // Receivers of datagrams count modulo 2^32.
    out.bytes(&(head.sequence as u32).to_be_bytes())?;
    out.bytes(channel.as_bytes())?;
    out.bytes(&[0])?;
    out.bytes(&SETPOINT_FINGERPRINT.to_be_bytes())?;
    out.bytes(&head.utime.to_be_bytes())?;
    out.bytes(&SETPOINT_SCHEMA.to_be_bytes())?;
    out.bytes(&head.sequence.to_be_bytes())?;
    out.bytes(&[u8::from(head.last)])?;
    out.text(motion.object())?;
    let joints = motion.joints();
    out.bytes(&(joints.len() as i32).to_be_bytes())?;
    for joint in joints {
        out.text(joint.name())?;
    }
    for joint in joints {
        out.bytes(&joint.at(time).position.to_be_bytes())?;
    }
    for joint in joints {
        out.bytes(&joint.at(time).velocity.to_be_bytes())?;
    }
    for joint in joints {
        out.bytes(&joint.at(time).acceleration.to_be_bytes())?;
    }
    out.text(head.reason.map_or("", Reason::text))?;
    Ok(out.written)
}

/// Fills a buffer from its beginning.
struct Writer<'b> {
    left: &'b mut [u8],
    written: usize,
}

impl Writer<'_> {
    fn bytes(&mut self, bytes: &[u8]) -> Result<(), TooLong> {
        let left = core::mem::take(&mut self.left);
        let (room, rest) = left.split_at_mut_checked(bytes.len()).ok_or(TooLong)?;
        // Unlike a copy of slices, this knows no case in which it would panic.
        room.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        self.left = rest;
        self.written += bytes.len();
        Ok(())
    }

    fn text(&mut self, text: &str) -> Result<(), TooLong> {
        self.bytes(&(text.len() as i32 + 1).to_be_bytes())?;
        self.bytes(text.as_bytes())?;
        self.bytes(&[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::there;
    use crate::motion::{JointMotion, MAX_JOINTS};

    const HEAD: Head = Head { utime: 7, sequence: 3, last: false, reason: Some(Reason::NotSent) };

    fn longest() -> Motion {
        let mut name = [b'n'; 63];
        let mut motion = Motion::new(core::str::from_utf8(&name).unwrap()).unwrap();
        for i in 0..MAX_JOINTS {
            name[0] = b'0' + i as u8;
            let (name, there) = (core::str::from_utf8(&name).unwrap(), there(1.0, 0.5));
            let stop = there.brake(0.7);
            let pieces = crate::stop(there.at(0.7), &there.bounds().limits).segments;
            let (end, target) = (stop.duration(), stop.target());
            let joint = JointMotion::new(name, &pieces, end, target, *there.bounds());
            motion.push(joint.unwrap()).unwrap();
        }
        motion
    }

    #[test]
    fn the_longest_setpoint_finds_room() {
        let mut out = [0; DATAGRAM_CAPACITY];
        let channel = "c".repeat(63);
        assert!(write_setpoint(&mut out, &channel, HEAD, &longest(), 0.5).unwrap() > 700);
    }

    #[test]
    fn a_buffer_that_is_too_small_is_said_wherever_it_ends() {
        let mut out = [0; DATAGRAM_CAPACITY];
        let length = write_setpoint(&mut out, "CHANNEL", HEAD, &longest(), 0.5).unwrap();
        for short in 0..length {
            let result = write_setpoint(&mut out[..short], "CHANNEL", HEAD, &longest(), 0.5);
            assert_eq!(result, Err(TooLong));
        }
    }
}
