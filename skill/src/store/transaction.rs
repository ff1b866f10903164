//! Changes of a file that several processes have open: one transaction at a time, and how long the
//! others wait for it.

use rusqlite::{Connection, ErrorCode, Transaction, TransactionBehavior};
use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

/// A change during which no other process makes one.
pub fn begin(connection: &Connection) -> rusqlite::Result<Transaction<'_>> {
    Transaction::new_unchecked(connection, TransactionBehavior::Immediate)
}

/// Tries again while another process that does the same has the file: SQLite itself does not wait
/// where a reader becomes a writer.
pub fn with_retries(mut change: impl FnMut() -> rusqlite::Result<()>) -> rusqlite::Result<()> {
    let mut tries = 0;
    loop {
        match change() {
            Err(error)
                if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy)
                    && wait_for_turn(tries) =>
            {
                tries += 1;
            }
            result => return result,
        }
    }
}

/// Tries of a process that waits for others: half a minute in all.
const MOST_TRIES: i32 = 1_000;
/// Longest wait between two tries is 2 to this power, milliseconds.
const LONGEST_WAIT: i32 = 6;

/// Waits for a random time while another process holds the file, so that of many waiting processes
/// none is always the last; `false` when it has waited long enough.
pub fn wait_for_turn(tries: i32) -> bool {
    if tries >= MOST_TRIES {
        return false;
    }
    let longest_us = 1000 << tries.clamp(0, LONGEST_WAIT);
    let wait_us = RandomState::new().hash_one(tries) % longest_us;
    std::thread::sleep(Duration::from_micros(wait_us));
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_waits_for_its_turn_gives_up_at_last() {
        assert!(wait_for_turn(0) && wait_for_turn(3));
        assert!(!wait_for_turn(MOST_TRIES));
    }
}
