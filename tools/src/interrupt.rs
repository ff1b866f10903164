//! Ctrl-C, SIGTERM, SIGHUP of a terminal that closes, SIGQUIT (whose first one dumps no core), SIGUSR1 and
//! SIGUSR2: a service that streams setpoints brakes before it ends.
//!
//! While frames are taken, the first signal ends them, and the program decides what that means: see
//! [`stopped`]. A second signal ends the program at once, and so does any that comes when no frames
//! are taken. The exit status is then 128 plus the signal's number: 130 for Ctrl-C, 143
//! for SIGTERM, 129 for SIGHUP. Where one of them but Ctrl-C and SIGTERM is ignored, as nohup has it with
//! SIGHUP, it stays so.

use crate::outcome::{Failure, Outcome};
use anyhow::anyhow;
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGUSR1, SIGUSR2};
use signal_hook::flag;
use std::fmt::Display;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

/// What the handlers of signals set and read.
struct Flags {
    /// Set by a signal: sources end.
    stop: Arc<AtomicBool>,
    /// Where it is set, a signal ends the program.
    is_fatal: Arc<AtomicBool>,
    /// The last signal.
    signal: Arc<AtomicUsize>,
}

fn flags() -> &'static Flags {
    static FLAGS: OnceLock<Flags> = OnceLock::new();
    FLAGS.get_or_init(|| {
        let flags =
            Flags { stop: Arc::default(), is_fatal: Arc::default(), signal: Arc::default() };
        if let Err(e) = install(&flags) {
            tracing::warn!("Ctrl-C will end the program at once: {e}");
        }
        flags
    })
}

/// Handlers are called in the order in which they are registered.
fn install(flags: &Flags) -> std::io::Result<()> {
    let others = [SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2].into_iter().filter(|&s| !is_ignored(s));
    for signal in [SIGINT, SIGTERM].into_iter().chain(others) {
        let status = status_of(signal).into();
        flag::register_conditional_shutdown(signal, status, Arc::clone(&flags.is_fatal))?;
        flag::register_conditional_shutdown(signal, status, Arc::clone(&flags.stop))?;
        flag::register_usize(signal, Arc::clone(&flags.signal), signal as usize)?;
        flag::register(signal, Arc::clone(&flags.stop))?;
    }
    Ok(())
}

/// Whoever started the program had a signal ignored.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// A signal that came while frames were taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Signal(i32);

impl Signal {
    /// The failure of a command that it ended.
    pub fn failure(self, what: impl Display) -> Failure {
        let name = match self.0 {
            SIGINT => "Ctrl-C",
            SIGHUP => "SIGHUP",
            SIGQUIT => "SIGQUIT",
            SIGUSR1 => "SIGUSR1",
            SIGUSR2 => "SIGUSR2",
            _ => "SIGTERM",
        };
        Failure { status: status_of(self.0), cause: anyhow!("stopped by {name}: {what}") }
    }
}

/// Exit status of a program that a signal ended.
fn status_of(signal: i32) -> u8 {
    128_u8.saturating_add(u8::try_from(signal).unwrap_or(0))
}

/// From now on a signal sets the flag that is returned, and does no more.
pub fn watch() -> Arc<AtomicBool> {
    let Flags { stop, is_fatal, .. } = flags();
    stop.store(false, Ordering::SeqCst);
    is_fatal.store(false, Ordering::SeqCst);
    Arc::clone(stop)
}

/// Frames are over: from now on a signal ends the program. Gives the one that came meanwhile.
pub fn unwatch() -> Option<Signal> {
    let Flags { stop, is_fatal, signal } = flags();
    is_fatal.store(true, Ordering::SeqCst);
    let came = stop.swap(false, Ordering::SeqCst);
    came.then(|| Signal(signal.load(Ordering::SeqCst) as i32))
}

/// Frames are over. Ctrl-C is how one says that a live camera has shown enough; a recording that a signal cut
/// short, and a camera whose program another signal told to end, have not shown what was asked for.
///
/// # Errors
/// With the status of the signal, where what was seen must not be used.
pub fn stopped(source: &str, is_live: bool) -> Outcome {
    match unwatch() {
        None => Ok(()),
        Some(Signal(SIGINT)) if is_live => Ok(()),
        Some(signal) => Err(signal.failure(format!("nothing is kept of {source}"))),
    }
}

/// Does what must be done whole, such as to store something, or not begun: a signal before it ends
/// the program, one that comes meanwhile does nothing.
pub fn uninterrupted<T>(work: impl FnOnce() -> T) -> T {
    watch();
    let done = work();
    unwatch();
    done
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_has_the_status_that_shells_give_it() {
        assert_eq!([SIGHUP, SIGINT, SIGTERM].map(status_of), [129, 130, 143]);
    }

    #[test]
    fn ctrl_c_ends_a_camera_and_spoils_a_recording_while_other_signals_spoil_both() {
        let after = |signal: i32, is_live: bool| {
            watch();
            signal_hook::low_level::raise(signal).unwrap();
            stopped("source", is_live).err().map(|failure| failure.status)
        };
        assert_eq!(after(SIGINT, true), None);
        assert_eq!(after(SIGINT, false), Some(130));
        assert_eq!(after(SIGTERM, true), Some(143));
        assert_eq!(after(SIGTERM, false), Some(143));
        for (signal, status) in [(SIGHUP, 129), (SIGQUIT, 131), (SIGUSR1, 138), (SIGUSR2, 140)] {
            if !is_ignored(signal) {
                assert_eq!(after(signal, true), Some(status));
            }
        }
        watch();
        assert!(stopped("source", false).is_ok());
        // What comes while something is stored is no matter.
        uninterrupted(|| signal_hook::low_level::raise(SIGTERM).unwrap());
        watch();
    }
}
