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

/// The objects of a new store and where they were learned.
const OBJECTS: &str = "
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
";

/// The words of each object and the lists of objects by word, of a new store and of one that had no lists.
const LISTS: &str = "
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

/// What tells a file to be a store of the newest version.
const MARKS: &str = "
PRAGMA application_id = 1280199495;
PRAGMA user_version = 8;
";

/// Objects of the first and the second version know no edges: an empty list is written as one zero.
const ADD_EDGES: &str = "ALTER TABLE object ADD COLUMN edges BLOB NOT NULL DEFAULT x'00';";

/// Objects up to the seventh version know no room.
const ADD_ROOM: &str = "ALTER TABLE object ADD COLUMN room BLOB NOT NULL DEFAULT x'00';";

/// The first version trained a vocabulary of its own for every store, words of the second and the third are
/// those of another vocabulary, words of the fourth are written otherwise.
const DROP_WORDS: &str = "
DROP TABLE IF EXISTS vocabulary;
DROP TABLE IF EXISTS words;
";

/// Words that lack are marked (`x'ff'`), to be made when they are needed.
const MARK_WORDS: &str = "INSERT INTO words (object, words) SELECT name, x'ff' FROM object;";

/// The fifth version has words as they are now, but neither numbers nor lists.
const PUT_WORDS_ASIDE: &str = "ALTER TABLE words RENAME TO words_before;";

/// Those words, and marks where they lack.
const TAKE_WORDS_OVER: &str = "
INSERT INTO words (object, words)
    SELECT name, coalesce(words, x'ff') FROM object LEFT JOIN words_before ON object = name;
DROP TABLE words_before;
";

/// The sixth version has lists, and no checksums.
const ADD_COLUMNS_OF_CHECKSUMS: &str = "
ALTER TABLE words ADD COLUMN content INTEGER NOT NULL DEFAULT 0;
ALTER TABLE words ADD COLUMN checksum INTEGER NOT NULL DEFAULT 0;
ALTER TABLE postings ADD COLUMN checksum INTEGER NOT NULL DEFAULT 0;
";

/// What makes a store of an earlier version one of the newest, except for the checksums themselves.
fn upgrades_from(version: i64) -> Vec<&'static str> {
    let mut sql = Vec::new();
    if version < 3 {
        sql.push(ADD_EDGES);
    }
    match version {
        ..=4 => sql.extend([DROP_WORDS, LISTS, MARK_WORDS, TOTALS]),
        5 => sql.extend([PUT_WORDS_ASIDE, LISTS, TAKE_WORDS_OVER, TOTALS]),
        6 => sql.extend([ADD_COLUMNS_OF_CHECKSUMS, TOTALS]),
        _ => {}
    }
    sql.extend([ADD_ROOM, MARKS]);
    sql
}

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
            for sql_text in [OBJECTS, LISTS, TOTALS, MARKS] {
                alone.execute_batch(sql_text).map_err(sql)?;
            }
            inverted_index::write_empty_directory(&alone).map_err(sql)?;
        }
        State::Version(SCHEMA_VERSION) => return Ok(()),
        State::Version(before) => {
            for sql_text in upgrades_from(before) {
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
    use super::super::test_data::{AS_IN_VERSION_5, AS_IN_VERSION_6};
    use super::*;

    #[test]
    fn the_mark_in_the_tables_is_the_mark_that_is_checked() {
        assert!(MARKS.contains(&format!("application_id = {APPLICATION_ID};")));
        assert!(MARKS.contains(&format!("user_version = {SCHEMA_VERSION};")));
    }

    /// What makes a new store one as an earlier version made it.
    const EARLIER: [(i64, &[&str]); 7] = [
        (1, &[AS_IN_VERSION_5, "ALTER TABLE object DROP COLUMN edges;", "DROP TABLE words;"]),
        (2, &[AS_IN_VERSION_5, "ALTER TABLE object DROP COLUMN edges;"]),
        (3, &[AS_IN_VERSION_5]),
        (4, &[AS_IN_VERSION_5]),
        (5, &[AS_IN_VERSION_5]),
        (6, &[AS_IN_VERSION_6]),
        (7, &["ALTER TABLE object DROP COLUMN room;"]),
    ];

    /// Tables, indices and triggers, and the columns of each table, with their types.
    fn definitions(connection: &Connection) -> Vec<String> {
        let sql = "SELECT concat_ws(' ', m.type, m.name, c.name, c.type, c.pk)
            FROM sqlite_master m LEFT JOIN pragma_table_info(m.name) c ORDER BY m.name, c.cid";
        let mut statement = connection.prepare(sql).unwrap();
        statement.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
    }

    #[test]
    fn a_store_of_any_earlier_version_gets_the_tables_of_a_new_one() {
        for (version, back) in EARLIER {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("s.linkage");
            let connection = Connection::open(&path).unwrap();
            prepare(&path, &connection).unwrap();
            let newest = definitions(&connection);
            back.iter().for_each(|sql| connection.execute_batch(sql).unwrap());
            connection.pragma_update(None, "user_version", version).unwrap();
            assert_ne!(definitions(&connection), newest, "version {version} has other tables");
            prepare(&path, &connection).unwrap();
            assert_eq!(definitions(&connection), newest, "from version {version}");
            assert!(state(&path, &connection).unwrap().is_newest());
        }
    }
}
