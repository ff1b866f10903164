//! The store: one SQLite file with models, appearance, words and provenance. Every
//! change is one transaction, so a kill at any moment leaves what was there before.

mod library;
mod lists;
mod schema;

use crate::appearance::Appearance;
use crate::model::ObjectModel;
use crate::recognise::{Index, Words};
use rusqlite::{Connection, OptionalExtension, params};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

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

    /// Puts several objects in, all or none. One time in many, what has been put in before is made
    /// ready to be found among them, which takes longer.
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
        transaction.commit().map_err(explain)?;
        self.list_if_many();
        Ok(())
    }

    /// Where words cannot be listed, as on a full disk, they stay as they are until next time.
    fn list_if_many(&self) {
        if let Err(error) = lists::list_if_many(&self.connection) {
            let store = self.path.display();
            tracing::warn!(%store, %error, "words are not listed: it opens more slowly");
        }
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

    /// Everything, to be recognised. Objects themselves, and the lists in which many are looked up,
    /// are read when they are first needed.
    ///
    /// # Errors
    /// As [`Self::get`], for objects whose words were not kept.
    pub fn load(&self) -> Result<Library, StoreError> {
        let snapshot = self.sql(self.connection.unchecked_transaction())?;
        let mut rows: Vec<(String, u32, Option<Vec<u8>>)> =
            self.sql(lists::all(&snapshot, "SELECT object, number, words FROM words", |row| {
                row.try_into()
            }))?;
        rows.sort_unstable_by(|a, b| a.0.cmp(&b.0));
        let mut names = Vec::with_capacity(rows.len());
        let (mut listed, mut unlisted, mut made) = (HashMap::new(), Vec::new(), Vec::new());
        for (own, (name, number, words)) in (0..).zip(rows) {
            match words.map(Words::from_bytes) {
                None => {
                    listed.insert(number, own);
                }
                Some(Some(words)) => unlisted.push((own, words)),
                Some(None) => {
                    let words = Words::of(&self.get(&name)?.appearance);
                    made.push((number, words.clone()));
                    unlisted.push((own, words));
                }
            }
            names.push(name);
        }
        drop(snapshot);
        self.keep(&made);
        self.list_if_many();
        Ok(Library::lazy(Self::open(&self.path)?, names, Index::of_some(&unlisted, listed)))
    }

    /// Keeps words that had to be made. Where they cannot be written they are made again next time.
    fn keep(&self, made: &[(u32, Words)]) {
        let written = || {
            let together = self.connection.unchecked_transaction()?;
            for (number, words) in made {
                let row = params![number, words.as_bytes()];
                together.execute("UPDATE words SET words = ?2 WHERE number = ?1", row)?;
            }
            together.commit()
        };
        if let Err(error) = written() {
            tracing::debug!(%error, "words are not kept");
        }
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
    transaction.execute(
        "INSERT INTO words (object, words) VALUES (?1, ?2)",
        params![name, Words::of(&object.appearance).as_bytes()],
    )?;
    for p in &object.provenance {
        transaction.execute(
            "INSERT INTO demonstration (object, source, learned_utime) VALUES (?1, ?2, ?3)",
            params![name, p.source, p.learned_utime],
        )?;
    }
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
    use crate::specimen::{features, features_seen};

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

    /// Takes back what version 6 brought.
    const AS_IN_VERSION_5: &str = "
        DROP TABLE postings;
        DROP INDEX unlisted;
        ALTER TABLE words RENAME TO numbered;
        CREATE TABLE words (
            object TEXT PRIMARY KEY REFERENCES object (name) ON DELETE CASCADE,
            words BLOB NOT NULL
        );
        INSERT INTO words SELECT object, words FROM numbered;
        DROP TABLE numbered;
        PRAGMA user_version = 5;";

    fn execute(path: &Path, sql: &str) {
        Connection::open(path).unwrap().execute_batch(sql).unwrap();
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
        execute(&path, AS_IN_VERSION_5);
        let as_it_was = "DROP TABLE words;
            ALTER TABLE object DROP COLUMN edges;
            CREATE TABLE vocabulary (id INTEGER PRIMARY KEY, tree BLOB NOT NULL);
            PRAGMA user_version = 1;";
        execute(&path, as_it_was);
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
        execute(&path, AS_IN_VERSION_5);
        let as_it_was = "ALTER TABLE object DROP COLUMN edges; PRAGMA user_version = 2;";
        execute(&path, as_it_was);
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
        let of_our_vocabulary = written().unwrap();
        for version in [3, 4] {
            let other = format!("UPDATE words SET words = x'ff'; PRAGMA user_version = {version};");
            execute(&path, AS_IN_VERSION_5);
            execute(&path, &other);
            let store = Store::open(&path).unwrap();
            assert_ne!(written().unwrap(), of_our_vocabulary);
            assert_eq!(store.load().unwrap().len(), 1);
            assert_eq!(written().unwrap(), of_our_vocabulary);
        }
    }

    #[test]
    fn words_of_version_5_stay_and_those_that_lack_are_made() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        let mut store = Store::open_or_create(&path).unwrap();
        let thing = |name, seed| StoredObject { appearance: features(seed), ..object(name) };
        store.put_all(&[thing("door", 1), thing("fridge", 2)]).unwrap();
        let rank = |store: &Store| store.load().unwrap().rank(&features_seen(2, 1.0), 2).unwrap();
        let ranked = rank(&store);
        drop(store);
        execute(&path, AS_IN_VERSION_5);
        execute(&path, "DELETE FROM words WHERE object = 'door'");
        let store = Store::open(&path).unwrap();
        assert_eq!(rank(&store), ranked);
        assert_eq!(store.names().unwrap(), ["door", "fridge"]);
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
        execute(&path, AS_IN_VERSION_5);
        let as_it_was = "ALTER TABLE object DROP COLUMN edges; PRAGMA user_version = 2;";
        execute(&path, as_it_was);
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
