//! Whether the threads of a library are idle, by what the system tells of them. On a busy machine a
//! thread may stand in the middle of its work for longer than any pause that one could choose.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

/// The threads of this process, a folder each.
const THREADS: &str = "/proc/self/task";
/// Time between two looks.
const POLL: Duration = Duration::from_millis(2);

/// Threads of this process that began while something was done.
#[derive(Debug, Default)]
pub struct Threads(BTreeSet<OsString>);

impl Threads {
    /// Does some work, and tells which threads began meanwhile: those that it started, and those
    /// that others happened to start beside it.
    pub fn begun_by<T>(work: impl FnOnce() -> T) -> (T, Self) {
        let before = all();
        let result = work();
        (result, Self(all().difference(&before).cloned().collect()))
    }

    /// Waits until each of them was seen asleep, or has ended; no longer than `limit`.
    pub fn wait_until_idle(&self, limit: Duration) {
        let end = Instant::now() + limit;
        for thread in &self.0 {
            while is_at_work(thread) && Instant::now() < end {
                std::thread::sleep(POLL);
            }
        }
    }
}

/// All threads of this process; none where the system does not tell.
fn all() -> BTreeSet<OsString> {
    let entries = fs::read_dir(THREADS).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name()).collect()
}

/// A thread runs, or waits for a processor or a disk. The state is the letter after the name in brackets.
fn is_at_work(thread: &OsStr) -> bool {
    let stat = fs::read_to_string(Path::new(THREADS).join(thread).join("stat"));
    let stat = stat.unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with(['R', 'D']))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn a_thread_is_waited_for_until_it_sleeps_and_no_longer_than_allowed() {
        let (works, ends) = (AtomicBool::new(true), AtomicBool::new(false));
        std::thread::scope(|scope| {
            let busy_then_idle = || {
                while works.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
                while !ends.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(20));
                }
            };
            let (_, threads) = Threads::begun_by(|| scope.spawn(busy_then_idle));
            let waited = |limit| {
                let start = Instant::now();
                threads.wait_until_idle(limit);
                start.elapsed()
            };
            let limit = Duration::from_millis(100);
            assert!(waited(limit) >= limit, "it works all the time");
            works.store(false, Ordering::Relaxed);
            assert!(waited(Duration::from_secs(20)) < Duration::from_secs(10), "it sleeps");
            ends.store(true, Ordering::Relaxed);
        });
    }

    #[test]
    fn what_has_ended_is_not_waited_for() {
        let (_, threads) = Threads::begun_by(|| ());
        threads.wait_until_idle(Duration::from_secs(60));
        let ended = Threads(BTreeSet::from(["0".into()]));
        ended.wait_until_idle(Duration::from_secs(60));
    }
}
