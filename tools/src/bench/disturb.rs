//! What goes on beside a service in a soak: one thread sends invalid datagrams and commands that
//! must not be obeyed, and another checks that setpoints never jump.

use crate::outcome::Outcome;
use anyhow::Context;
use linkage_lcm::messages::linkage::{Command, Setpoint};
use linkage_lcm::udpm::Network;
use linkage_lcm::{Lcm, decode, encode};
use linkage_planner_bridge::client::addressed;
use linkage_planner_bridge::{MotionLimits, channel};
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
/// What the rounding of times to microseconds adds to the difference of two setpoints, as a share of
/// what the limits allow, and at least.
const ROUNDING: (f64, f64) = (0.01, 1e-5);
/// Longest wait for a setpoint before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(50);

/// Counts of what went on.
#[derive(Debug, Default)]
pub struct Disturbance {
    stop: AtomicBool,
    hostile: AtomicU64,
    setpoints: AtomicU64,
    jumps: AtomicU64,
    /// Motions that were braked, each with its reason.
    braked: AtomicU64,
    /// The last setpoint was not the last one of its motion.
    moves: AtomicBool,
}

/// The two threads; they end when this is dropped.
pub struct Disturbing {
    counts: Arc<Disturbance>,
    threads: Vec<JoinHandle<()>>,
}

impl Disturbing {
    /// Begins on a network; no joint that is streamed goes beyond `limits`.
    pub fn start(url: &str, limits: MotionLimits) -> Outcome<Self> {
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
        let watch = move || watch(&mut lcm, &limits, &seen);
        Ok(Self { counts, threads: vec![std::thread::spawn(send), std::thread::spawn(watch)] })
    }

    /// Hostile datagrams, setpoints, setpoints that jumped, and motions that were braked.
    pub fn counts(&self) -> [u64; 4] {
        let Disturbance { hostile, setpoints, jumps, braked, .. } = &*self.counts;
        [hostile, setpoints, jumps, braked].map(|count| count.load(Ordering::Relaxed))
    }

    /// Setpoints stream.
    pub fn is_moving(&self) -> bool {
        self.counts.moves.load(Ordering::Relaxed)
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
/// the service listens to with noise in it, or with a command that the service must not obey.
fn hostile(rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = Vec::new();
    match rng.random_range(0..8) {
        0..3 => {}
        3..5 => {
            bytes.extend(FRAGMENT.to_be_bytes());
            let numbers: [u32; 3] = rng.random();
            bytes.extend(numbers.iter().flat_map(|n| n.to_be_bytes()));
            bytes.extend(rng.random::<[u16; 2]>().iter().flat_map(|n| n.to_be_bytes()));
            bytes.extend(b"KINECT_FRAME\0");
        }
        5..7 => bytes.extend(on_command_channel(rng)),
        _ => {
            bytes.extend(on_command_channel(rng));
            bytes.extend(encode(&foreign_command(rng)).unwrap_or_default());
            return bytes;
        }
    }
    let length = rng.random_range(0..1200);
    bytes.extend((0..length).map(|_| rng.random::<u8>()));
    bytes
}

fn on_command_channel(rng: &mut ChaCha8Rng) -> Vec<u8> {
    let number = rng.random::<u32>().to_be_bytes();
    [&WHOLE.to_be_bytes(), &number[..], channel::COMMAND.as_bytes(), b"\0"].concat()
}

/// A command for another session, as of a log that is played back.
fn foreign_command(rng: &mut ChaCha8Rng) -> Command {
    let action = rng.random_range(Command::START_DEMONSTRATION..=Command::CANCEL);
    let command = Command {
        action,
        object: "thing".to_owned(),
        target: "open".to_owned(),
        ..Command::default()
    };
    addressed(&command, rng.random())
}

fn watch(lcm: &mut Lcm, limits: &MotionLimits, counts: &Disturbance) {
    let mut before: Option<Setpoint> = None;
    while !counts.stop.load(Ordering::Relaxed) {
        let Ok(Some(packet)) = lcm.receive(POLL) else { continue };
        let Ok(now) = decode::<Setpoint>(&packet.bytes) else { continue };
        counts.setpoints.fetch_add(1, Ordering::Relaxed);
        // The last one is sent several times.
        let has_moved = counts.moves.swap(!now.last, Ordering::Relaxed);
        if has_moved && now.last && !now.reason.is_empty() {
            counts.braked.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(before) = before.take()
            && is_jump(&before, &now, limits)
        {
            tracing::error!("a jump from {before:?} to {now:?}");
            counts.jumps.fetch_add(1, Ordering::Relaxed);
        }
        before = (!now.last).then_some(now);
    }
}

/// Between two setpoints of a motion a joint went farther, or its velocity or acceleration changed
/// more, than its limits allow in that time.
fn is_jump(before: &Setpoint, now: &Setpoint, limits: &MotionLimits) -> bool {
    let seconds = (now.utime - before.utime).max(0) as f64 * 1e-6;
    let [share, least] = [1.0 + ROUNDING.0, ROUNDING.1];
    [
        (&before.position, &now.position, limits.velocity),
        (&before.velocity, &now.velocity, limits.acceleration),
        (&before.acceleration, &now.acceleration, limits.jerk),
    ]
    .into_iter()
    .any(|(before, now, rate)| {
        let most = rate * seconds * share + least;
        before.iter().zip(now).any(|(a, b)| (b - a).abs() > most)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_that_goes_farther_than_it_may_or_changes_its_velocity_at_once_has_jumped() {
        let limits = MotionLimits { velocity: 0.25, acceleration: 0.5, jerk: 2.0 };
        let at = |utime, position, velocity, acceleration| Setpoint {
            utime,
            position: vec![position],
            velocity: vec![velocity],
            acceleration: vec![acceleration],
            ..Setpoint::default()
        };
        let start = at(0, 0.1, 0.25, 0.0);
        for (position, velocity, acceleration, jumps) in [
            (0.1012, 0.2476, 0.009, false),
            (0.102, 0.25, 0.0, true),
            (0.1012, 0.24, 0.0, true),
            (0.1012, 0.25, 0.02, true),
        ] {
            let now = at(5000, position, velocity, acceleration);
            assert_eq!(is_jump(&start, &now, &limits), jumps, "{now:?}");
        }
    }
}
