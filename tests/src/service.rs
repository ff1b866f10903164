//! A running `linkage serve`, and what it publishes.

use crate::{build, linkage, program};
use linkage_lcm::messages::linkage::Status;
use linkage_lcm::{Lcm, Message, Packet, decode};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

/// Longest time that a service may take to end.
const LONGEST_END: Duration = Duration::from_secs(60);

/// A service in a process of its own; killed when a test fails.
pub struct Service {
    process: Child,
    url: String,
}

impl Service {
    /// Starts one on an LCM network and waits until it tells its status.
    pub fn start(url: &str, source: &str, store: &Path, options: &[&str]) -> Self {
        Self::start_logging(url, source, store, options, Stdio::null())
    }

    /// Starts one whose log is written there.
    pub fn start_logging(
        url: &str,
        source: &str,
        store: &Path,
        options: &[&str],
        log: impl Into<Stdio>,
    ) -> Self {
        build();
        let mut listener = Listener::new(url, "LINKAGE_STATUS");
        let process = Command::new(program())
            .args(["serve", "--quiet", "--source", source, "--publish", url, "--store"])
            .arg(store)
            .args(options)
            .stderr(log)
            .spawn()
            .expect("the built program starts");
        let service = Self { process, url: url.to_owned() };
        listener.wait::<Status>("LINKAGE_STATUS", Duration::from_secs(20), |_| true);
        service
    }

    /// Tells it to do something; its answer.
    pub fn command(&self, words: &[&str]) -> Output {
        linkage(&[&["command", "--publish", &self.url, "--wait", "30"], words].concat())
    }

    /// Its answer, which must be no refusal.
    pub fn done(&self, words: &[&str]) -> String {
        let output = self.command(words);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        said
    }

    /// Resident memory, MiB.
    pub fn resident_mib(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.process.id()))
            .expect("the service runs");
        let line = status.lines().find(|l| l.starts_with("VmRSS:")).expect("Linux tells VmRSS");
        let kib: f64 = line.split_whitespace().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0.0);
        kib / 1024.0
    }

    /// Kills it, whatever it is doing.
    pub fn kill(&self) {
        let pid = self.process.id().to_string();
        let killed = Command::new("kill").args(["-KILL", &pid]).status();
        assert!(killed.is_ok_and(|s| s.success()), "the service runs until it is killed");
    }

    /// Asks it to end; how it did, and how long that took.
    pub fn terminate(self) -> (ExitStatus, Duration) {
        self.end("-TERM")
    }

    /// Asks it to end by a signal; how it did, and how long that took.
    pub fn end(mut self, signal: &str) -> (ExitStatus, Duration) {
        let start = Instant::now();
        let pid = self.process.id().to_string();
        let killed = Command::new("kill").args([signal, &pid]).status();
        assert!(killed.is_ok_and(|s| s.success()), "the service runs until it is told to end");
        while start.elapsed() < LONGEST_END {
            if let Some(status) = self.process.try_wait().expect("it can be waited for") {
                return (status, start.elapsed());
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("it does not end within {LONGEST_END:?} of {signal}");
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// What is published on some channels.
pub struct Listener {
    lcm: Lcm,
}

impl Listener {
    /// Listens on channels that match a regular expression.
    pub fn new(url: &str, channels: &str) -> Self {
        let mut lcm = Lcm::new(url).expect("LCM works on this host");
        lcm.subscribe(channels).expect("a channel");
        Self { lcm }
    }

    /// The next message of a channel that is as wanted.
    ///
    /// # Panics
    /// When none comes in time.
    pub fn wait<M: Message>(
        &mut self,
        channel: &str,
        timeout: Duration,
        mut wanted: impl FnMut(&M) -> bool,
    ) -> M {
        let start = Instant::now();
        while start.elapsed() < timeout {
            let packet = self.lcm.receive(Duration::from_millis(200)).expect("LCM receives");
            let Some(packet) = packet.filter(|p| p.channel == channel) else { continue };
            let message: M = decode(&packet.bytes).expect("what is published can be decoded");
            if wanted(&message) {
                return message;
            }
        }
        panic!("nothing that was waited for came on {channel} within {timeout:?}");
    }

    /// All packets that come within a time.
    pub fn gather(&mut self, time: Duration) -> Vec<Packet> {
        let start = Instant::now();
        let mut packets = Vec::new();
        while start.elapsed() < time {
            packets.extend(self.lcm.receive(Duration::from_millis(50)).expect("LCM receives"));
        }
        packets
    }
}
