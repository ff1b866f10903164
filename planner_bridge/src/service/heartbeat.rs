//! The thread that hears the consumer's heartbeat, `linkage.heartbeat_t`: without it nothing moves
//! where the rig requires it.

use super::publisher::{Note, Outbox};
use super::stream::Pulse;
use crate::channel;
use linkage_driver::live::host_utime;
use linkage_lcm::messages::linkage::Heartbeat;
use linkage_lcm::{Lcm, LcmError, decode};
use std::time::{Duration, Instant};

/// Version of the message.
const SCHEMA: i32 = 1;
/// A heartbeat whose stamp is farther than this from the host's clock is none, microseconds: it may
/// come from a log that is played back.
const GREATEST_OFFSET_US: u64 = 1_000_000;
/// Longest wait for a packet before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(50);
/// Bytes of a packet on the channel of heartbeats at most; a heartbeat has some 60, and the name of its sender.
const MAX_PACKET: usize = 4096;
/// Time between two reports of packets that are no heartbeat.
const TELL_EVERY: Duration = Duration::from_millis(500);

pub struct HeartbeatListener<'q> {
    lcm: Lcm,
    pulse: Pulse<'q>,
    out: Outbox,
    newest: Newest,
    told: Option<Instant>,
    /// Packets that were longer than any heartbeat.
    too_long: u64,
}

impl<'q> HeartbeatListener<'q> {
    pub fn new(url: &str, pulse: Pulse<'q>, out: Outbox) -> Result<Self, LcmError> {
        let mut lcm = Lcm::new(url)?;
        lcm.subscribe_up_to(channel::HEARTBEAT, MAX_PACKET)?;
        Ok(Self { lcm, pulse, out, newest: Newest::default(), told: None, too_long: 0 })
    }

    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) {
        while !is_stopped() {
            match self.lcm.receive(POLL) {
                Ok(Some(packet)) => match self.newest.take(&packet.bytes, host_utime()) {
                    Ok(()) => self.pulse.beat(),
                    Err(reason) => self.report(reason),
                },
                Ok(None) => {
                    let all = self.lcm.reception().oversized;
                    if all > self.too_long {
                        self.too_long = all;
                        self.report(format!(
                            "a heartbeat has more than {MAX_PACKET} bytes: it is none"
                        ));
                    }
                }
                Err(e) => {
                    self.out.note(Note::Error(e.to_string()));
                    std::thread::sleep(POLL);
                }
            }
        }
    }
}

impl HeartbeatListener<'_> {
    /// Reports what is wrong with a packet; of a flood of packets only some are reported.
    fn report(&mut self, reason: String) {
        if self.told.is_none_or(|t| t.elapsed() >= TELL_EVERY) {
            self.out.note(Note::Error(reason));
            self.told = Some(Instant::now());
        }
    }
}

/// The heartbeat that counted last.
#[derive(Debug, Default)]
struct Newest {
    utime: i64,
}

impl Newest {
    /// Takes a packet for a sign of life, or says why it is none: only a new one is.
    fn take(&mut self, packet: &[u8], now: i64) -> Result<(), String> {
        let none =
            |why: String| Err(format!("a packet on {} is ignored: {why}", channel::HEARTBEAT));
        let heartbeat: Heartbeat = match decode(packet) {
            Ok(heartbeat) => heartbeat,
            Err(e) => return none(e.to_string()),
        };
        if heartbeat.schema != SCHEMA {
            return none(format!("it has schema {}, not {SCHEMA}", heartbeat.schema));
        }
        let offset = heartbeat.utime.abs_diff(now);
        if offset > GREATEST_OFFSET_US {
            let seconds = offset as f64 * 1e-6;
            return none(format!(
                "its stamp is {seconds:.1} s off this host's clock; is it played back, or are the clocks not synchronised?"
            ));
        }
        if heartbeat.utime <= self.newest_before(now) {
            return none("its stamp is not above the last one's".to_owned());
        }
        self.utime = heartbeat.utime;
        Ok(())
    }

    /// The stamp that the next must be above: none where the host's clock was set back meanwhile.
    fn newest_before(&self, now: i64) -> i64 {
        if self.utime.abs_diff(now) > GREATEST_OFFSET_US { i64::MIN } else { self.utime }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_lcm::encode;

    const NOW: i64 = 1_700_000_000_000_000;

    fn packet(utime: i64) -> Vec<u8> {
        encode(&Heartbeat { utime, schema: SCHEMA, source: "arm".into() }).unwrap()
    }

    #[test]
    fn only_a_new_heartbeat_is_a_sign_of_life() {
        let mut newest = Newest::default();
        assert_eq!(newest.take(&packet(NOW), NOW), Ok(()));
        let again = newest.take(&packet(NOW), NOW + 1000);
        assert!(again.unwrap_err().contains("not above the last"), "it is sent twice");
        assert_eq!(newest.take(&packet(NOW + 1), NOW + 1000), Ok(()));
        let old = newest.take(&packet(NOW - 3_600_000_000), NOW + 2000);
        assert!(old.unwrap_err().contains("3600.0 s off"), "a log is played back");
        let broken = newest.take(&packet(NOW + 2)[..20], NOW + 2000);
        assert!(broken.unwrap_err().contains("LINKAGE_HEARTBEAT"));
        let other = encode(&Heartbeat { utime: NOW + 3, schema: 9, source: String::new() });
        assert!(newest.take(&other.unwrap(), NOW + 3000).unwrap_err().contains("schema 9"));
    }

    #[test]
    fn a_clock_that_is_set_back_does_not_silence_the_heartbeat() {
        let mut newest = Newest::default();
        assert_eq!(newest.take(&packet(NOW), NOW), Ok(()));
        let earlier = NOW - 60_000_000;
        assert_eq!(newest.take(&packet(earlier), earlier), Ok(()));
        assert_eq!(newest.take(&packet(earlier + 1), earlier), Ok(()));
    }
}
