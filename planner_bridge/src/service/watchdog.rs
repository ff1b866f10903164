//! Tells systemd that the service is ready, still alive, or stopping. Without systemd (no
//! `NOTIFY_SOCKET` in the environment) every call does nothing.

use sd_notify::NotifyState;
use std::time::{Duration, Instant};

/// Notifications of the service to systemd. A unit with `Type=notify` waits for [`Self::ready`];
/// one with `WatchdogSec` starts the service again when [`Self::alive`] is not called for that
/// long.
#[derive(Debug)]
pub struct Watchdog {
    /// Half of what the unit allows; `None` where it sets no watchdog.
    every: Option<Duration>,
    told: Option<Instant>,
}

impl Watchdog {
    /// A watchdog as the environment describes it (`NOTIFY_SOCKET`, `WATCHDOG_USEC`,
    /// `WATCHDOG_PID`).
    pub fn from_environment() -> Self {
        Self { every: sd_notify::watchdog_enabled().map(|longest| longest / 2), told: None }
    }

    /// The service takes frames and commands.
    pub fn ready(&self) {
        notify(&[NotifyState::Ready]);
    }

    /// The thread that calls this does its work. It may be called at any rate: systemd is told
    /// twice in the time that its watchdog allows.
    pub fn alive(&mut self) {
        let Some(every) = self.every else { return };
        if self.told.is_none_or(|told| told.elapsed() >= every) {
            self.told = Some(Instant::now());
            notify(&[NotifyState::Watchdog]);
        }
    }

    /// The service ends because it was asked to.
    pub fn stopping(&self) {
        notify(&[NotifyState::Stopping]);
    }
}

fn notify(state: &[NotifyState]) {
    if let Err(e) = sd_notify::notify(state) {
        tracing::warn!("systemd cannot be told: {e}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixDatagram;
    use std::process::{Command, Stdio};

    /// Runs in a process of its own, whose environment the other tests set.
    #[test]
    #[ignore = "a part of the tests beside it, which start it"]
    fn a_service() {
        let mut watchdog = Watchdog::from_environment();
        watchdog.ready();
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_millis(500) {
            watchdog.alive();
            std::thread::sleep(Duration::from_millis(1));
        }
        watchdog.stopping();
    }

    /// What a service says under an environment.
    fn said(environment: &[(&str, &str)]) -> Vec<String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_nonblocking(true).unwrap();
        let program = std::env::current_exe().unwrap();
        let test = "service::watchdog::tests::a_service";
        let mut child = Command::new(program)
            .args(["--exact", test, "--include-ignored"])
            .env_remove("WATCHDOG_PID")
            .env("NOTIFY_SOCKET", &path)
            .envs(environment.iter().copied())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // A socket holds few datagrams: they are read while the service speaks.
        let (mut buffer, mut messages) = ([0; 256], Vec::new());
        loop {
            let status = child.try_wait().unwrap();
            while let Ok(length) = socket.recv(&mut buffer) {
                messages.push(String::from_utf8_lossy(&buffer[..length]).trim().to_owned());
            }
            match status {
                Some(status) => assert!(status.success(), "{status}"),
                None => {
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                }
            }
            return messages;
        }
    }

    #[test]
    fn systemd_hears_of_the_start_of_life_and_of_the_end() {
        let messages = said(&[("WATCHDOG_USEC", "100000")]);
        let (first, last) = (messages.first().unwrap(), messages.last().unwrap());
        assert_eq!((first.as_str(), last.as_str()), ("READY=1", "STOPPING=1"));
        let between = &messages[1..messages.len() - 1];
        assert!(between.iter().all(|m| m == "WATCHDOG=1"), "{messages:?}");
        // Every 50 ms of half a second, or less often on a busy machine.
        assert!((2..=10).contains(&between.len()), "{messages:?}");
    }

    #[test]
    fn without_a_watchdog_in_the_unit_systemd_hears_of_start_and_end_alone() {
        assert_eq!(said(&[]), ["READY=1", "STOPPING=1"]);
    }

    #[test]
    fn without_systemd_nothing_is_said_and_nothing_fails() {
        assert_eq!(said(&[("NOTIFY_SOCKET", "")]), Vec::<String>::new());
        assert_eq!(said(&[("NOTIFY_SOCKET", "/nowhere/notify")]), Vec::<String>::new());
    }
}
