//! The store's tables and their versions.

use super::contents::{self, Entry};
use super::error::{Fault, StoreError, explain};
use super::inverted_index;
use super::record::Record;
use super::transaction::{begin, with_retries};
use crate::object::stored_object::Provenance;
use rusqlite::{Connection, params};
use std::path::Path;

/// The newest schema that this version knows.
pub const SCHEMA_VERSION: i64 = 8;

/// Marks an SQLite file as ours: "LNKG".
const APPLICATION_ID: i64 = 0x4c4e_4b47;

const CREATE: &str = "
CREATE TABLE object (
    name TEXT PRIMARY KEY,
    model TEXT NOT NULL,
    appearance BLOB NOT NULL,
    edges BLOB NOT NULL,
    room BLOB NOT NULL
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
    words BLOB,
    content INTEGER NOT NULL DEFAULT 0,
    checksum INTEGER NOT NULL DEFAULT 0
);
CREATE INDEX unlisted ON words (number) WHERE words IS NOT NULL;
CREATE TABLE postings (
    list INTEGER PRIMARY KEY,
    postings BLOB NOT NULL,
    checksum INTEGER NOT NULL DEFAULT 0
);
";

/// The totals over all rows of words, which SQLite itself keeps up to date, and which lists there
/// are.
const TOTALS: &str = "
CREATE TABLE total (
    id INTEGER PRIMARY KEY CHECK (id = 0),
    objects INTEGER NOT NULL,
    checksum INTEGER NOT NULL
);
INSERT INTO total SELECT 0, count(*), 0 FROM words;
CREATE TRIGGER object_added AFTER INSERT ON words BEGIN
    UPDATE total SET objects = objects + 1, checksum = checksum + new.checksum;
END;
CREATE TRIGGER object_changed AFTER UPDATE ON words BEGIN
    UPDATE total SET checksum = checksum - old.checksum + new.checksum;
END;
CREATE TRIGGER object_removed AFTER DELETE ON words BEGIN
    UPDATE total SET objects = objects - 1, checksum = checksum - old.checksum;
END;
CREATE TABLE listed (
    id INTEGER PRIMARY KEY CHECK (id = 0),
    lists BLOB NOT NULL,
    checksum INTEGER NOT NULL
);
";

/// What tells a new file to be a store of the newest version.
const MARKS: &str = "
PRAGMA application_id = 1280199495;
PRAGMA user_version = 8;
";

/// What each version up to the newest lacks. The first trained a vocabulary of its own for every
/// store; objects of the second know no edges: an empty list is written as one zero; rectified
/// features of the third are upright, and its words those of another vocabulary; words of the
/// fourth are written otherwise; the fifth has no lists, and words that lack are marked (`x'ff'`)
/// to be made when they are needed; the sixth has no checksums; objects of the seventh know no room.
const UPGRADES: [&[&str]; 7] = [
    &["
DROP TABLE IF EXISTS vocabulary;
CREATE TABLE IF NOT EXISTS words (
    object TEXT PRIMARY KEY REFERENCES object (name) ON DELETE CASCADE,
    words BLOB NOT NULL
);
PRAGMA user_version = 2;
"],
    &["
ALTER TABLE object ADD COLUMN edges BLOB NOT NULL DEFAULT x'00';
PRAGMA user_version = 3;
"],
    &["
DELETE FROM words;
PRAGMA user_version = 4;
"],
    &["
DELETE FROM words;
PRAGMA user_version = 5;
"],
    &["
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
"],
    &[
        "
ALTER TABLE words ADD COLUMN content INTEGER NOT NULL DEFAULT 0;
ALTER TABLE words ADD COLUMN checksum INTEGER NOT NULL DEFAULT 0;
ALTER TABLE postings ADD COLUMN checksum INTEGER NOT NULL DEFAULT 0;
",
        TOTALS,
        "PRAGMA user_version = 7;",
    ],
    &["
ALTER TABLE object ADD COLUMN room BLOB NOT NULL DEFAULT x'00';
PRAGMA user_version = 8;
"],
];

/// The first version with checksums.
const FIRST_WITH_CHECKSUMS: i64 = 7;

/// A page of a new file: what is kept of an object is long, and words and lists, of which many are
/// read at a time, should lie on few pages.
const PAGE_BYTES: u32 = 16_384;

/// What a file is, as far as its tables tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Nothing was written yet.
    Empty,
    /// A store of this version of the schema, or of an earlier one.
    Version(i64),
}

impl State {
    /// True where nothing is to be made or brought up to date.
    pub fn is_newest(self) -> bool {
        self == Self::Version(SCHEMA_VERSION)
    }
}

/// Makes the tables of an empty file, or brings those of an old one up to date.
pub fn prepare(path: &Path, connection: &Connection) -> Result<(), StoreError> {
    let sql = |e| explain(path, e);
    let state = state(path, connection)?;
    if state == State::Empty {
        connection.pragma_update(None, "page_size", PAGE_BYTES).map_err(sql)?;
        with_retries(|| connection.pragma_update(None, "journal_mode", "WAL")).map_err(sql)?;
    }
    if !state.is_newest() {
        upgrade(path, connection)?;
    }
    connection.pragma_update(None, "foreign_keys", true).map_err(sql)?;
    connection.pragma_update(None, "synchronous", "FULL").map_err(sql)
}

/// Makes or completes the tables, all or nothing.
fn upgrade(path: &Path, connection: &Connection) -> Result<(), StoreError> {
    let sql = |e| explain(path, e);
    let alone = begin(connection).map_err(sql)?;
    // Another process may have been faster.
    match state(path, &alone)? {
        State::Empty => {
            alone.execute_batch(CREATE).map_err(sql)?;
            alone.execute_batch(TOTALS).map_err(sql)?;
            alone.execute_batch(MARKS).map_err(sql)?;
            inverted_index::write_empty_directory(&alone).map_err(sql)?;
        }
        State::Version(SCHEMA_VERSION) => return Ok(()),
        State::Version(before) => {
            let lacking = UPGRADES.into_iter().skip(usize::try_from(before - 1).unwrap_or(0));
            for sql_text in lacking.flatten() {
                alone.execute_batch(sql_text).map_err(sql)?;
            }
            if before < FIRST_WITH_CHECKSUMS {
                add_checksums(&alone).map_err(|fault| fault.in_file(path))?;
            }
        }
    }
    alone.commit().map_err(sql)
}

/// Adds checksums over all that an older store holds.
fn add_checksums(connection: &Connection) -> Result<(), Fault> {
    let of_row = |row: &rusqlite::Row| Ok((row.get(0)?, row.get(1)?, row.get(2)?));
    let rows: Vec<(u32, String, Option<Vec<u8>>)> =
        contents::all_rows(connection, "SELECT number, object, words FROM words", of_row)?;
    tracing::info!(objects = rows.len(), "adding checksums to an older store");
    for (number, object, words) in rows {
        let Some(record) = read_record(connection, &object)? else {
            let reason = "it has words and no model".to_owned();
            return Err(Fault::Object { object, reason });
        };
        let content = record.checksum(&object);
        contents::update(connection, &Entry { number, object, words, content })?;
    }
    inverted_index::add_checksums(connection)?;
    Ok(())
}

/// The columns of an object.
pub fn read_record(connection: &Connection, name: &str) -> rusqlite::Result<Option<Record>> {
    let mut statement = connection
        .prepare_cached("SELECT model, appearance, edges, room FROM object WHERE name = ?1")?;
    let mut rows = statement.query([name])?;
    let Some(row) = rows.next()? else { return Ok(None) };
    let (model, appearance, edges, room) = row.try_into()?;
    let mut statement = connection.prepare_cached(
        "SELECT source, learned_utime FROM demonstration WHERE object = ?1 ORDER BY id",
    )?;
    let provenance = statement.query_map([name], |row| {
        Ok(Provenance { source: row.get(0)?, learned_utime: row.get(1)? })
    })?;
    let provenance = provenance.collect::<rusqlite::Result<_>>()?;
    Ok(Some(Record { model, appearance, edges, room, provenance }))
}

/// Writes an object, in place of one of the same name.
pub fn write_record(
    connection: &Connection,
    name: &str,
    record: &Record,
    words: &[u8],
) -> rusqlite::Result<()> {
    connection.execute("DELETE FROM object WHERE name = ?1", [name])?;
    connection.execute(
        "INSERT INTO object (name, model, appearance, edges, room) VALUES (?1, ?2, ?3, ?4, ?5)",
        params![name, record.model, record.appearance, record.edges, record.room],
    )?;
    contents::insert(connection, name, words, record.checksum(name))?;
    for p in &record.provenance {
        connection.execute(
            "INSERT INTO demonstration (object, source, learned_utime) VALUES (?1, ?2, ?3)",
            params![name, p.source, p.learned_utime],
        )?;
    }
    Ok(())
}

/// What a file is.
pub fn state(path: &Path, connection: &Connection) -> Result<State, StoreError> {
    let sql = |e| explain(path, e);
    let number = |pragma: &str| {
        connection.pragma_query_value(None, pragma, |row| row.get::<_, i64>(0)).map_err(sql)
    };
    let tables: i64 = connection
        .query_row("SELECT count(*) FROM sqlite_master", [], |row| row.get(0))
        .map_err(sql)?;
    let (application, version) = (number("application_id")?, number("user_version")?);
    if tables == 0 && application == 0 {
        Ok(State::Empty)
    } else if application != APPLICATION_ID {
        Err(StoreError::NotAStore { path: path.display().to_string() })
    } else if version > SCHEMA_VERSION {
        Err(StoreError::Newer {
            path: path.display().to_string(),
            found: version,
            known: SCHEMA_VERSION,
        })
    } else {
        Ok(State::Version(version))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mark_in_the_tables_is_the_mark_that_is_checked() {
        assert!(MARKS.contains(&format!("application_id = {APPLICATION_ID};")));
        assert!(MARKS.contains(&format!("user_version = {SCHEMA_VERSION};")));
    }
}
