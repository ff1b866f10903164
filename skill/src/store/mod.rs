//! The store: one SQLite file with models, appearance, words and provenance. Every
//! change is one transaction, so a kill at any moment leaves what was there before.

mod library;
mod schema;

use crate::appearance::Appearance;
use crate::model::ObjectModel;
use crate::recognise::{Counted, Words};
use rusqlite::{Connection, OptionalExtension, params};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc;

pub use library::Library;
pub use schema::SCHEMA_VERSION;

/// A store that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It is not there.
    #[error("{path}: no such store; learn an object with --store first")]
    Missing {
        /// The file.
        path: String,
    },
    /// It is something else.
    #[error("{path}: not a Linkage store; give another file name")]
    NotAStore {
        /// The file.
        path: String,
    },
    /// It was written by a newer version.
    #[error(
        "{path}: schema {found} is newer than {known}, the newest that this version knows; update linkage"
    )]
    Newer {
        /// The file.
        path: String,
        /// Its schema.
        found: i64,
        /// Ours.
        known: i64,
    },
    /// No object goes by that name.
    #[error("{path}: no object \"{object}\"; it holds: {known}")]
    UnknownObject {
        /// The file.
        path: String,
        /// As asked.
        object: String,
        /// What there is.
        known: String,
    },
    /// A row that cannot be decoded.
    #[error("{path}: object \"{object}\" is damaged: {reason}; remove it and learn it again")]
    Damaged {
        /// The file.
        path: String,
        /// Which.
        object: String,
        /// Why.
        reason: String,
    },
    /// SQLite's own errors: disk full, no permission, locked.
    #[error("{path}: {source}")]
    Database {
        /// The file.
        path: String,
        /// Why.
        source: rusqlite::Error,
    },
}

/// Where an object's knowledge comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Provenance {
    /// Recording.
    pub source: String,
    /// When it was learned, microseconds since 1970.
    pub learned_utime: i64,
}

/// An object as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredObject {
    /// Motion.
    pub model: ObjectModel,
    /// Looks.
    pub appearance: Appearance,
    /// Demonstrations, oldest first.
    pub provenance: Vec<Provenance>,
}

/// Names that an error lists.
const MOST_NAMED: usize = 20;
/// Objects whose words are taken at once.
const AT_ONCE: usize = 500;

/// An open store.
pub struct Store {
    path: PathBuf,
    connection: Connection,
}

impl Store {
    /// Opens an existing store.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::NotAStore`], [`StoreError::Newer`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        if !path.exists() {
            return Err(StoreError::Missing { path: path.display().to_string() });
        }
        Self::open_or_create(path)
    }

    /// Opens a store, or makes an empty one.
    ///
    /// # Errors
    /// As [`Self::open`], and [`StoreError::Database`] when it cannot be made.
    pub fn open_or_create(path: &Path) -> Result<Self, StoreError> {
        let connection = Connection::open(path).map_err(|e| schema::explain(path, e))?;
        schema::prepare(path, &connection)?;
        Ok(Self { path: path.to_owned(), connection })
    }

    /// Names of all objects, in alphabetical order.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub fn names(&self) -> Result<Vec<String>, StoreError> {
        let mut statement =
            self.sql(self.connection.prepare("SELECT name FROM object ORDER BY name"))?;
        let rows = self.sql(statement.query_map([], |row| row.get(0)))?;
        self.sql(rows.collect())
    }

    /// An object, if one goes by that name.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Database`].
    pub fn find(&self, name: &str) -> Result<Option<StoredObject>, StoreError> {
        match self.get(name) {
            Ok(object) => Ok(Some(object)),
            Err(StoreError::UnknownObject { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// An object.
    ///
    /// # Errors
    /// [`StoreError::UnknownObject`] lists what there is; [`StoreError::Damaged`].
    pub fn get(&self, name: &str) -> Result<StoredObject, StoreError> {
        let row = self.sql(
            self.connection
                .query_row(
                    "SELECT model, appearance, edges FROM object WHERE name = ?1",
                    [name],
                    |row| <(String, Vec<u8>, Vec<u8>)>::try_from(row),
                )
                .optional(),
        )?;
        let Some((model, appearance, edges)) = row else {
            return Err(self.unknown(name)?);
        };
        let damaged = |reason: String| StoreError::Damaged {
            path: self.path.display().to_string(),
            object: name.to_owned(),
            reason,
        };
        let appearance: Appearance =
            postcard::from_bytes(&appearance).map_err(|e| damaged(e.to_string()))?;
        let edges = postcard::from_bytes(&edges).map_err(|e| damaged(e.to_string()))?;
        Ok(StoredObject {
            model: serde_json::from_str(&model).map_err(|e| damaged(e.to_string()))?,
            appearance: Appearance { edges, ..appearance },
            provenance: self.provenance(name)?,
        })
    }

    /// Puts an object in, in place of one of the same name.
    ///
    /// # Errors
    /// [`StoreError::Database`]; the store then holds what it held before.
    pub fn put(&mut self, object: &StoredObject) -> Result<(), StoreError> {
        self.put_all(std::slice::from_ref(object))
    }

    /// Puts several objects in, all or none.
    ///
    /// # Errors
    /// As [`Self::put`].
    pub fn put_all(&mut self, objects: &[StoredObject]) -> Result<(), StoreError> {
        let path = self.path.clone();
        let explain = |e| schema::explain(&path, e);
        let transaction = self.connection.transaction().map_err(explain)?;
        for object in objects {
            write_object(&transaction, object).map_err(explain)?;
        }
        transaction.commit().map_err(explain)
    }

    /// Takes an object out.
    ///
    /// # Errors
    /// [`StoreError::UnknownObject`].
    pub fn remove(&mut self, name: &str) -> Result<(), StoreError> {
        let removed =
            self.sql(self.connection.execute("DELETE FROM object WHERE name = ?1", [name]))?;
        if removed == 0 { Err(self.unknown(name)?) } else { Ok(()) }
    }

    /// Everything, to be recognised. Objects themselves are read when they are first needed.
    ///
    /// # Errors
    /// As [`Self::get`], for objects whose words were not kept.
    pub fn load(&self) -> Result<Library, StoreError> {
        let transaction = self.sql(self.connection.unchecked_transaction())?;
        let names = self.names()?;
        let numbers: HashMap<&str, u32> = names.iter().map(String::as_str).zip(0..).collect();
        let mut counted = Counted::new();
        let mut is_kept = vec![false; names.len()];
        self.each_kept(&numbers, |some| {
            some.iter().for_each(|(number, _)| is_kept[*number as usize] = true);
            counted.count(some);
        })?;
        let made = (0..).zip(&names).filter(|(number, _)| !is_kept[*number as usize]);
        let made: Vec<(u32, Words)> = made
            .map(|(number, name)| Ok((number, Words::of(&self.get(name)?.appearance))))
            .collect::<Result<_, StoreError>>()?;
        counted.count(&made);
        let mut filled = counted.counted();
        self.each_kept(&numbers, |some| filled.fill(some))?;
        filled.fill(&made);
        let write = |(number, words): &(u32, Words)| {
            write_words(&transaction, &names[*number as usize], words)
        };
        // Where they cannot be written, or another process has meanwhile written to the store,
        // they are made again next time.
        if let Err(error) = made.iter().try_for_each(write).and_then(|()| transaction.commit()) {
            tracing::debug!(%error, "words are not kept");
        }
        Ok(Library::lazy(Self::open(&self.path)?, names, filled.filled()))
    }

    /// Goes through the words that are kept whole, some objects at a time: while some are taken,
    /// the next are read.
    fn each_kept(
        &self,
        numbers: &HashMap<&str, u32>,
        mut take: impl FnMut(&[(u32, Words)]) + Send,
    ) -> Result<(), StoreError> {
        let mut statement = self.sql(self.connection.prepare("SELECT object, words FROM words"))?;
        let mut rows = self.sql(statement.query([]))?;
        std::thread::scope(|scope| {
            let (ready, to_take) = mpsc::sync_channel::<Vec<(u32, Words)>>(1);
            scope.spawn(move || to_take.iter().for_each(|some| take(&some)));
            let mut some = Vec::new();
            while let Some(row) = self.sql(rows.next())? {
                let name = self.sql(row.get_ref(0))?.as_str().ok();
                let number = name.and_then(|name| numbers.get(name)).copied();
                some.extend(number.zip(Words::from_bytes(self.sql(row.get(1))?)));
                if some.len() == AT_ONCE && ready.send(std::mem::take(&mut some)).is_err() {
                    break;
                }
            }
            // Nobody takes any more only after a panic, which leaving the scope passes on.
            ready.send(some).ok();
            Ok(())
        })
    }

    fn provenance(&self, name: &str) -> Result<Vec<Provenance>, StoreError> {
        let mut statement = self.sql(self.connection.prepare(
            "SELECT source, learned_utime FROM demonstration WHERE object = ?1 ORDER BY id",
        ))?;
        let rows = self.sql(statement.query_map([name], |row| {
            Ok(Provenance { source: row.get(0)?, learned_utime: row.get(1)? })
        }))?;
        self.sql(rows.collect())
    }

    fn unknown(&self, name: &str) -> Result<StoreError, StoreError> {
        Ok(StoreError::UnknownObject {
            path: self.path.display().to_string(),
            object: name.to_owned(),
            known: some_of(self.names()?, name),
        })
    }

    fn sql<T>(&self, result: rusqlite::Result<T>) -> Result<T, StoreError> {
        result.map_err(|e| schema::explain(&self.path, e))
    }
}

/// Names in a list; of many those nearest to what was asked for.
fn some_of(mut names: Vec<String>, asked: &str) -> String {
    let more = names.len().saturating_sub(MOST_NAMED);
    if more > 0 {
        names.sort_by_cached_key(|name| strsim::levenshtein(name, asked));
        names.truncate(MOST_NAMED);
        names.push(format!("and {more} more"));
    }
    if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
}

fn write_object(
    transaction: &rusqlite::Transaction,
    object: &StoredObject,
) -> rusqlite::Result<()> {
    let name = &object.model.object;
    let model = serde_json::to_string(&object.model).map_err(unwritable)?;
    let appearance = postcard::to_stdvec(&object.appearance).map_err(unwritable)?;
    let edges = postcard::to_stdvec(&object.appearance.edges).map_err(unwritable)?;
    transaction.execute("DELETE FROM object WHERE name = ?1", [name])?;
    transaction.execute(
        "INSERT INTO object (name, model, appearance, edges) VALUES (?1, ?2, ?3, ?4)",
        params![name, model, appearance, edges],
    )?;
    write_words(transaction, name, &Words::of(&object.appearance))?;
    for p in &object.provenance {
        transaction.execute(
            "INSERT INTO demonstration (object, source, learned_utime) VALUES (?1, ?2, ?3)",
            params![name, p.source, p.learned_utime],
        )?;
    }
    Ok(())
}

fn write_words(connection: &Connection, name: &str, words: &Words) -> rusqlite::Result<()> {
    let row = params![name, words.as_bytes()];
    connection.execute("INSERT OR REPLACE INTO words (object, words) VALUES (?1, ?2)", row)?;
    Ok(())
}

fn unwritable(error: impl std::error::Error + Send + Sync + 'static) -> rusqlite::Error {
    rusqlite::Error::ToSqlConversionFailure(error.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::appearance::Edge;
    use crate::model::{MODEL_SCHEMA, ReferenceFrame};

    pub fn object(name: &str) -> StoredObject {
        StoredObject {
            model: ObjectModel {
                schema: MODEL_SCHEMA.into(),
                object: name.into(),
                reference_frame: ReferenceFrame::at_camera(0.0),
                parts: Vec::new(),
                joints: Vec::new(),
                demonstrations: 1,
                profile: "default".into(),
                version: "0".into(),
            },
            appearance: Appearance::default(),
            provenance: vec![Provenance { source: "tum:x".into(), learned_utime: 5 }],
        }
    }

    #[test]
    fn what_was_put_in_comes_out() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        let mut store = Store::open_or_create(&path).unwrap();
        store.put(&object("fridge")).unwrap();
        store.put(&object("door")).unwrap();
        drop(store);
        let store = Store::open(&path).unwrap();
        assert_eq!(store.names().unwrap(), ["door", "fridge"]);
        assert_eq!(store.get("fridge").unwrap(), object("fridge"));
    }

    #[test]
    fn numbers_come_back_bit_for_bit() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        let mut door = object("door");
        door.model.reference_frame.t = 1_400_000_000.066_666_8;
        door.model.reference_frame.camera_from_object[0] = 0.1 + 0.2;
        store.put(&door).unwrap();
        assert_eq!(store.get("door").unwrap(), door);
    }

    #[test]
    fn an_unknown_object_is_named_with_what_there_is() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        store.put(&object("door")).unwrap();
        let message = store.get("oven").unwrap_err().to_string();
        assert!(message.contains("\"oven\"") && message.contains("door"), "{message}");
    }

    #[test]
    fn of_many_the_likeliest_names_are_listed() {
        let names = (0..30).map(|i| format!("drawer {i}")).chain(["oven".to_owned()]).collect();
        let listed = some_of(names, "owen");
        assert!(listed.starts_with("oven, ") && listed.ends_with(", and 11 more"), "{listed}");
    }

    #[test]
    fn a_text_file_is_no_store() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("notes.txt");
        std::fs::write(&path, "hello, this is not a database at all. ".repeat(100)).unwrap();
        assert!(matches!(Store::open(&path), Err(StoreError::NotAStore { .. })));
        assert_eq!(std::fs::read_to_string(&path).unwrap().len(), 3800);
    }

    #[test]
    fn another_programs_database_is_no_store_and_is_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("other.db");
        let other = Connection::open(&path).unwrap();
        other.execute_batch("CREATE TABLE t (x); INSERT INTO t VALUES (1);").unwrap();
        drop(other);
        assert!(matches!(Store::open(&path), Err(StoreError::NotAStore { .. })));
    }

    #[test]
    fn a_store_of_version_1_is_still_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        Store::open_or_create(&path).unwrap().put(&object("door")).unwrap();
        let as_it_was = "DROP TABLE words;
            ALTER TABLE object DROP COLUMN edges;
            CREATE TABLE vocabulary (id INTEGER PRIMARY KEY, tree BLOB NOT NULL);
            PRAGMA user_version = 1;";
        Connection::open(&path).unwrap().execute_batch(as_it_was).unwrap();
        let mut store = Store::open(&path).unwrap();
        assert_eq!(store.load().unwrap().len(), 1);
        store.put(&object("fridge")).unwrap();
        assert_eq!(store.load().unwrap().object(1).unwrap().model.object, "fridge");
    }

    #[test]
    fn objects_of_version_2_know_no_edges() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        let edge = Edge {
            part: 1,
            surface: [0.1, 0.2, 0.3],
            normal: [0.0, 0.0, 1.0],
            beyond: [0.14, 0.2, 0.3],
            configurations: [0.0, 1.2],
        };
        let appearance = Appearance { edges: vec![edge], ..Appearance::default() };
        let door = StoredObject { appearance, ..object("door") };
        Store::open_or_create(&path).unwrap().put(&door).unwrap();
        assert_eq!(Store::open(&path).unwrap().get("door").unwrap(), door);
        let as_it_was = "ALTER TABLE object DROP COLUMN edges; PRAGMA user_version = 2;";
        Connection::open(&path).unwrap().execute_batch(as_it_was).unwrap();
        let mut store = Store::open(&path).unwrap();
        assert_eq!(store.get("door").unwrap(), object("door"));
        store.put(&door).unwrap();
        assert_eq!(store.get("door").unwrap(), door);
    }

    #[test]
    fn words_of_earlier_versions_are_made_anew_and_kept() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        Store::open_or_create(&path).unwrap().put(&object("door")).unwrap();
        let written = || {
            let sql = "SELECT words FROM words WHERE object = 'door'";
            let row = |row: &rusqlite::Row| row.get::<_, Vec<u8>>(0);
            Connection::open(&path).unwrap().query_row(sql, [], row).optional().unwrap()
        };
        let of_our_vocabulary = written();
        for version in 3..SCHEMA_VERSION {
            let other = format!("UPDATE words SET words = x'ff'; PRAGMA user_version = {version};");
            Connection::open(&path).unwrap().execute_batch(&other).unwrap();
            let store = Store::open(&path).unwrap();
            assert_eq!(written(), None);
            assert_eq!(store.load().unwrap().len(), 1);
            assert!(of_our_vocabulary.is_some() && written() == of_our_vocabulary);
        }
    }

    #[test]
    fn many_who_open_one_file_at_once_make_and_upgrade_it_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        let open_at_once = || {
            std::thread::scope(|scope| {
                let opening: Vec<_> =
                    (0..8).map(|_| scope.spawn(|| Store::open_or_create(&path))).collect();
                for opened in opening {
                    opened.join().unwrap().unwrap();
                }
            });
        };
        open_at_once();
        Store::open(&path).unwrap().put(&object("door")).unwrap();
        let as_it_was = "ALTER TABLE object DROP COLUMN edges; PRAGMA user_version = 2;";
        Connection::open(&path).unwrap().execute_batch(as_it_was).unwrap();
        open_at_once();
        assert_eq!(Store::open(&path).unwrap().get("door").unwrap(), object("door"));
    }

    #[test]
    fn an_object_that_is_removed_is_looked_for_no_more() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        store.put_all(&[object("door"), object("fridge")]).unwrap();
        store.remove("door").unwrap();
        let library = store.load().unwrap();
        assert_eq!(
            (library.len(), library.object(0).unwrap().model.object.as_str()),
            (1, "fridge")
        );
    }

    #[test]
    fn a_newer_schema_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        Store::open_or_create(&path).unwrap();
        Connection::open(&path).unwrap().pragma_update(None, "user_version", 99).unwrap();
        let error = Store::open(&path).err().unwrap();
        assert!(matches!(error, StoreError::Newer { found: 99, .. }), "{error}");
    }
}
