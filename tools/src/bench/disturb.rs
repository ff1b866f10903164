//! What goes on beside a service in a soak: one thread sends invalid datagrams, and another checks
//! that setpoints never jump.

use crate::outcome::Outcome;
use anyhow::Context;
use linkage_lcm::messages::linkage::Setpoint;
use linkage_lcm::udpm::Network;
use linkage_lcm::{Lcm, decode};
use linkage_planner_bridge::channel;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Time between two hostile datagrams.
const HOSTILE_EVERY: Duration = Duration::from_millis(5);
/// How LCM's datagrams begin: whole messages, and fragments of one.
const WHOLE: u32 = 0x4c43_3032;
const FRAGMENT: u32 = 0x4c43_3033;
/// What rounding adds to the way between two setpoints, metres.
const ROUNDING_M: f64 = 1e-5;
/// Longest wait for a setpoint before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(50);

/// Counts of what went on.
#[derive(Debug, Default)]
pub struct Disturbance {
    stop: AtomicBool,
    hostile: AtomicU64,
    setpoints: AtomicU64,
    jumps: AtomicU64,
}

/// The two threads; they end when this is dropped.
pub struct Disturbing {
    counts: Arc<Disturbance>,
    threads: Vec<JoinHandle<()>>,
}

impl Disturbing {
    /// Begins on a network; `fastest` is the greatest velocity of the joint that is streamed, m/s.
    pub fn start(url: &str, fastest: f64) -> Outcome<Self> {
        let counts = Arc::new(Disturbance::default());
        let socket = Network::parse(url)?.sender().context("a socket for hostile datagrams")?;
        let mut lcm = Lcm::new(url)?;
        lcm.subscribe(channel::SETPOINT)?;
        let (sent, seen) = (Arc::clone(&counts), Arc::clone(&counts));
        let send = move || {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            while !sent.stop.load(Ordering::Relaxed) {
                // A datagram that the system does not send is not counted.
                if socket.send(&hostile(&mut rng)).is_ok() {
                    sent.hostile.fetch_add(1, Ordering::Relaxed);
                }
                std::thread::sleep(HOSTILE_EVERY);
            }
        };
        let watch = move || watch(&mut lcm, fastest, &seen);
        Ok(Self { counts, threads: vec![std::thread::spawn(send), std::thread::spawn(watch)] })
    }

    /// Hostile datagrams, setpoints, and setpoints that jumped.
    pub fn counts(&self) -> [u64; 3] {
        let Disturbance { hostile, setpoints, jumps, .. } = &*self.counts;
        [hostile, setpoints, jumps].map(|count| count.load(Ordering::Relaxed))
    }
}

impl Drop for Disturbing {
    fn drop(&mut self) {
        self.counts.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                tracing::error!("a disturbing thread failed");
            }
        }
    }
}

/// An invalid datagram: noise, a fragment that claims what it likes, or a message on a channel that
/// the service listens to with noise in it.
fn hostile(rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = Vec::new();
    match rng.random_range(0..3) {
        0 => {}
        1 => {
            bytes.extend(FRAGMENT.to_be_bytes());
            let numbers: [u32; 3] = rng.random();
            bytes.extend(numbers.iter().flat_map(|n| n.to_be_bytes()));
            bytes.extend(rng.random::<[u16; 2]>().iter().flat_map(|n| n.to_be_bytes()));
            bytes.extend(b"KINECT_FRAME\0");
        }
        _ => {
            bytes.extend(WHOLE.to_be_bytes());
            bytes.extend(rng.random::<u32>().to_be_bytes());
            bytes.extend(channel::COMMAND.as_bytes());
            bytes.push(0);
        }
    }
    let length = rng.random_range(0..1200);
    bytes.extend((0..length).map(|_| rng.random::<u8>()));
    bytes
}

fn watch(lcm: &mut Lcm, fastest: f64, counts: &Disturbance) {
    let mut before: Option<Setpoint> = None;
    while !counts.stop.load(Ordering::Relaxed) {
        let Ok(Some(packet)) = lcm.receive(POLL) else { continue };
        let Ok(now) = decode::<Setpoint>(&packet.bytes) else { continue };
        counts.setpoints.fetch_add(1, Ordering::Relaxed);
        if before.take().is_some_and(|before| is_jump(&before, &now, fastest)) {
            counts.jumps.fetch_add(1, Ordering::Relaxed);
        }
        before = (!now.last).then_some(now);
    }
}

/// A joint went farther between two setpoints of a motion than it may.
fn is_jump(before: &Setpoint, now: &Setpoint, fastest: f64) -> bool {
    let seconds = (now.utime - before.utime).max(0) as f64 * 1e-6;
    let farthest = fastest * seconds + ROUNDING_M;
    before.position.iter().zip(&now.position).any(|(a, b)| (b - a).abs() > farthest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_that_goes_farther_than_it_may_has_jumped() {
        let at =
            |utime, position| Setpoint { utime, position: vec![position], ..Setpoint::default() };
        assert!(!is_jump(&at(0, 0.1), &at(5000, 0.1012), 0.25));
        assert!(is_jump(&at(0, 0.1), &at(5000, 0.102), 0.25));
    }
}
