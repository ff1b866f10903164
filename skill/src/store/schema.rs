//! The store's tables and their versions.

use super::StoreError;
use rusqlite::{Connection, ErrorCode, Transaction, TransactionBehavior};
use std::path::Path;
use std::time::{Duration, Instant};

/// The newest schema that this version knows.
pub const SCHEMA_VERSION: i64 = 6;

/// Marks an SQLite file as ours: "LNKG".
const APPLICATION_ID: i64 = 0x4c4e_4b47;

const CREATE: &str = "
CREATE TABLE object (
    name TEXT PRIMARY KEY,
    model TEXT NOT NULL,
    appearance BLOB NOT NULL,
    edges BLOB NOT NULL
);
CREATE TABLE demonstration (
    id INTEGER PRIMARY KEY,
    object TEXT NOT NULL REFERENCES object (name) ON DELETE CASCADE,
    source TEXT NOT NULL,
    learned_utime INTEGER NOT NULL
);
CREATE INDEX demonstration_of_object ON demonstration (object);
CREATE TABLE words (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    object TEXT NOT NULL UNIQUE REFERENCES object (name) ON DELETE CASCADE,
    words BLOB
);
CREATE INDEX unlisted ON words (number) WHERE words IS NOT NULL;
CREATE TABLE postings (
    list INTEGER PRIMARY KEY,
    postings BLOB NOT NULL
);
PRAGMA application_id = 1280199495;
PRAGMA user_version = 6;
";

/// What each version up to the newest lacks. The first trained a vocabulary of its own for every
/// store; objects of the second know no edges: an empty list is written as one zero; rectified
/// features of the third are upright, and its words those of another vocabulary; words of the
/// fourth are written otherwise; the fifth has no lists, and words that lack are marked (`x'ff'`)
/// to be made when they are needed.
const UPGRADES: [&str; 5] = [
    "
DROP TABLE IF EXISTS vocabulary;
CREATE TABLE IF NOT EXISTS words (
    object TEXT PRIMARY KEY REFERENCES object (name) ON DELETE CASCADE,
    words BLOB NOT NULL
);
PRAGMA user_version = 2;
",
    "
ALTER TABLE object ADD COLUMN edges BLOB NOT NULL DEFAULT x'00';
PRAGMA user_version = 3;
",
    "
DELETE FROM words;
PRAGMA user_version = 4;
",
    "
DELETE FROM words;
PRAGMA user_version = 5;
",
    "
CREATE TABLE numbered (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    object TEXT NOT NULL UNIQUE REFERENCES object (name) ON DELETE CASCADE,
    words BLOB
);
INSERT INTO numbered (object, words)
    SELECT name, coalesce(words, x'ff') FROM object LEFT JOIN words ON object = name;
DROP TABLE words;
ALTER TABLE numbered RENAME TO words;
CREATE INDEX unlisted ON words (number) WHERE words IS NOT NULL;
CREATE TABLE postings (
    list INTEGER PRIMARY KEY,
    postings BLOB NOT NULL
);
PRAGMA user_version = 6;
",
];

/// A page of a new file: what is kept of an object is long, and words and lists, of which many are
/// read at a time, should lie on few pages.
const PAGE_BYTES: u32 = 16_384;
/// Longest wait for another process that writes.
const PATIENCE: Duration = Duration::from_secs(5);

/// Makes the tables of an empty file, or brings those of an old one up to date.
pub fn prepare(path: &Path, connection: &Connection) -> Result<(), StoreError> {
    let sql = |e| explain(path, e);
    connection.busy_timeout(PATIENCE).map_err(sql)?;
    let lacking = steps(path, connection)?;
    if lacking == [CREATE] {
        connection.pragma_update(None, "page_size", PAGE_BYTES).map_err(sql)?;
        patiently(|| connection.pragma_update(None, "journal_mode", "WAL")).map_err(sql)?;
    }
    if !lacking.is_empty() {
        let alone = Transaction::new_unchecked(connection, TransactionBehavior::Immediate);
        let alone = alone.map_err(sql)?;
        // Another process may have been faster.
        for step in steps(path, &alone)? {
            alone.execute_batch(step).map_err(sql)?;
        }
        alone.commit().map_err(sql)?;
    }
    connection.pragma_update(None, "foreign_keys", true).map_err(sql)?;
    connection.pragma_update(None, "synchronous", "FULL").map_err(sql)
}

/// Tries again while another process that does the same has the file: SQLite itself does not wait
/// where a reader becomes a writer.
fn patiently(mut change: impl FnMut() -> rusqlite::Result<()>) -> rusqlite::Result<()> {
    let end = Instant::now() + PATIENCE;
    loop {
        match change() {
            Err(error)
                if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy)
                    && Instant::now() < end =>
            {
                std::thread::sleep(Duration::from_millis(10));
            }
            result => return result,
        }
    }
}

/// What a file lacks of the newest schema.
fn steps(path: &Path, connection: &Connection) -> Result<Vec<&'static str>, StoreError> {
    let sql = |e| explain(path, e);
    let number = |pragma: &str| {
        connection.pragma_query_value(None, pragma, |row| row.get::<_, i64>(0)).map_err(sql)
    };
    let tables: i64 = connection
        .query_row("SELECT count(*) FROM sqlite_master", [], |row| row.get(0))
        .map_err(sql)?;
    let (application, version) = (number("application_id")?, number("user_version")?);
    if tables == 0 && application == 0 {
        Ok(vec![CREATE])
    } else if application != APPLICATION_ID {
        Err(StoreError::NotAStore { path: path.display().to_string() })
    } else if version > SCHEMA_VERSION {
        Err(StoreError::Newer {
            path: path.display().to_string(),
            found: version,
            known: SCHEMA_VERSION,
        })
    } else {
        Ok(UPGRADES.into_iter().skip(usize::try_from(version - 1).unwrap_or(0)).collect())
    }
}

/// An error of SQLite with the file's name.
pub fn explain(path: &Path, source: rusqlite::Error) -> StoreError {
    let path = path.display().to_string();
    match source.sqlite_error_code() {
        Some(ErrorCode::NotADatabase) => StoreError::NotAStore { path },
        _ => StoreError::Database { path, source },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mark_in_the_tables_is_the_mark_that_is_checked() {
        assert!(CREATE.contains(&format!("application_id = {APPLICATION_ID};")));
        assert!(CREATE.contains(&format!("user_version = {SCHEMA_VERSION};")));
    }
}
