//! An open store, and what can be asked of it and changed in it by an object's name.
//!
//! In: the path of an SQLite file, objects by name. Out: objects, names, revisions, or an error that
//! says what is wrong with the file and what can be done.

use super::error::{Fault, StoreError, explain};
use super::file::{self, Absent, Opened};
use super::record::Record;
use super::{contents, inverted_index, schema, transaction};
use crate::object::stored_object::StoredObject;
use crate::recognise::retrieval::Words;
use rusqlite::Connection;
use std::path::{Path, PathBuf};

/// Which state of an object a store holds: each change gives another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Revision(u32);

/// Names that an error lists.
const MOST_NAMED: usize = 20;

/// An open store.
pub struct Store {
    pub(super) path: PathBuf,
    pub(super) connection: Connection,
    is_read_only: bool,
}

impl Store {
    /// Opens an existing store. Where it or its folder cannot be written, as on a full disk, it can
    /// still be read.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::NotAFile`], [`StoreError::Unreachable`],
    /// [`StoreError::NotAStore`], [`StoreError::Newer`], [`StoreError::DamagedFile`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::opened(path, Absent::Refuse)
    }

    /// Opens a store, or makes an empty one.
    ///
    /// # Errors
    /// As [`Self::open`], and [`StoreError::Database`] when it cannot be made.
    pub fn open_or_create(path: &Path) -> Result<Self, StoreError> {
        Self::opened(path, Absent::Create)
    }

    fn opened(path: &Path, absent: Absent) -> Result<Self, StoreError> {
        let Opened { connection, is_read_only } = file::open(path, absent)?;
        Ok(Self { path: path.to_owned(), connection, is_read_only })
    }

    /// True where nothing can be put in or taken out.
    pub fn is_read_only(&self) -> bool {
        self.is_read_only
    }

    /// Names of all objects, in alphabetical order.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::DamagedFile`], [`StoreError::Database`].
    pub fn names(&self) -> Result<Vec<String>, StoreError> {
        let snapshot = self.snapshot()?;
        let entries = self.read(contents::entries(&snapshot))?;
        let mut names: Vec<String> = entries.into_iter().map(|e| e.object).collect();
        names.sort_unstable();
        Ok(names)
    }

    /// Which state of an object there is; `None` where no object goes by that name.
    ///
    /// # Errors
    /// As [`Self::names`].
    pub fn revision(&self, name: &str) -> Result<Option<Revision>, StoreError> {
        if let Some(entry) = self.read(contents::entry(&self.connection, name))? {
            return Ok(Some(Revision(entry.number)));
        }
        // Only the check of all rows shows that there is none.
        if self.names()?.iter().any(|known| known == name) {
            return Err(self.damaged(name, "the index of names has lost it".to_owned()));
        }
        Ok(None)
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
        self.get_revised(name).map(|(object, _)| object)
    }

    /// An object, and which state of it that is.
    fn get_revised(&self, name: &str) -> Result<(StoredObject, Revision), StoreError> {
        // One transaction: another process may replace it meanwhile.
        let snapshot = self.snapshot()?;
        let entry = self.read(contents::entry(&snapshot, name))?;
        let record = entry.as_ref().map(|_| schema::read_record(&snapshot, name)).transpose();
        drop(snapshot);
        let Some(entry) = entry else { return Err(self.unknown(name)?) };
        // Whatever does not let it be read, other objects may be whole.
        let record = record.map_err(|e| self.damaged(name, e.to_string()))?.flatten();
        let lost = || self.damaged(name, "its model is lost".to_owned());
        let record = record.ok_or_else(lost)?;
        if record.checksum(name) != entry.content {
            return Err(self.damaged(name, "it does not match its checksum".to_owned()));
        }
        let object = record.object(name).map_err(|reason| self.damaged(name, reason))?;
        Ok((object, Revision(entry.number)))
    }

    /// Puts an object in, in place of one of the same name.
    ///
    /// # Errors
    /// [`StoreError::Invalid`] for one that nothing could read again; [`StoreError::ReadOnly`],
    /// [`StoreError::Database`]; the store then holds what it held before.
    pub fn put(&mut self, object: &StoredObject) -> Result<(), StoreError> {
        self.put_all(std::slice::from_ref(object))
    }

    /// Puts several objects in, all or none. Once in many calls the words of earlier objects are
    /// written to the posting lists, which takes longer.
    ///
    /// # Errors
    /// As [`Self::put`].
    pub fn put_all(&mut self, objects: &[StoredObject]) -> Result<(), StoreError> {
        self.write(objects, |_, _, _| Ok(()))
    }

    /// Puts objects in, all or none, if each still is as it was: in the state that stands beside
    /// it, or unknown.
    ///
    /// # Errors
    /// [`StoreError::Changed`], and as [`Self::put`].
    pub fn put_unchanged(
        &mut self,
        objects: &[StoredObject],
        before: &[Option<Revision>],
    ) -> Result<(), StoreError> {
        let path = self.path.clone();
        self.write(objects, |connection, index, object| {
            let now = contents::entry(connection, object).map_err(|e| e.in_file(&path))?;
            if now.map(|e| Revision(e.number)) == before.get(index).copied().flatten() {
                return Ok(());
            }
            let path = path.display().to_string();
            Err(StoreError::Changed { path, object: object.to_owned() })
        })
    }

    /// Puts in what `change` makes of the object of a name, if there is one. Where another process
    /// changes it meanwhile, `change` is asked again, so that no change is lost.
    ///
    /// # Errors
    /// Those of `change`, and as [`Self::find`] and [`Self::put`].
    pub fn update<E: From<StoreError>>(
        &mut self,
        name: &str,
        mut change: impl FnMut(Option<&StoredObject>) -> Result<StoredObject, E>,
    ) -> Result<StoredObject, E> {
        loop {
            let known = match self.get_revised(name) {
                Ok(known) => Some(known),
                Err(StoreError::UnknownObject { .. }) => None,
                Err(error) => return Err(error.into()),
            };
            let changed = change(known.as_ref().map(|(object, _)| object))?;
            let before = known.map(|(_, revision)| revision);
            match self.put_unchanged(std::slice::from_ref(&changed), &[before]) {
                Err(StoreError::Changed { .. }) => {}
                Err(error) => return Err(error.into()),
                Ok(()) => return Ok(changed),
            }
        }
    }

    /// Writes objects, each if it may be, all or none.
    fn write(
        &mut self,
        objects: &[StoredObject],
        may_be: impl Fn(&Connection, usize, &str) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        self.refuse_if_read_only()?;
        // What takes long is done before other processes have to wait.
        let made = |object: &StoredObject| {
            let name = object.model.object.clone();
            let invalid = |reason| StoreError::Invalid { object: name.clone(), reason };
            let record = Record::of(object).map_err(invalid)?;
            Ok((name, record, Words::of(&object.appearance)))
        };
        let made: Vec<(String, Record, Words)> =
            objects.iter().map(made).collect::<Result<_, StoreError>>()?;
        let together = self.sql(transaction::begin(&self.connection))?;
        for (index, (name, record, words)) in made.iter().enumerate() {
            may_be(&together, index, name)?;
            self.sql(schema::write_record(&together, name, record, words.as_bytes()))?;
        }
        self.sql(together.commit())?;
        self.list_if_many();
        Ok(())
    }

    /// Where words cannot be listed, as on a full disk, they stay as they are until next time.
    pub(super) fn list_if_many(&self) {
        if self.is_read_only {
            return;
        }
        if let Err(error) = inverted_index::list_if_many(&self.connection) {
            let store = self.path.display();
            tracing::warn!(%store, %error, "words are not listed: it opens more slowly");
        }
    }

    /// Takes an object out.
    ///
    /// # Errors
    /// [`StoreError::UnknownObject`], [`StoreError::ReadOnly`], [`StoreError::Database`].
    pub fn remove(&mut self, name: &str) -> Result<(), StoreError> {
        self.refuse_if_read_only()?;
        let together = self.sql(transaction::begin(&self.connection))?;
        let removed = self.sql(together.execute("DELETE FROM object WHERE name = ?1", [name]))?;
        self.sql(together.commit())?;
        if removed == 0 { Err(self.unknown(name)?) } else { Ok(()) }
    }

    /// A state of the store that stays as it is while it is read.
    pub(super) fn snapshot(&self) -> Result<rusqlite::Transaction<'_>, StoreError> {
        self.sql(self.connection.unchecked_transaction())
    }

    /// An error where nothing can be written.
    fn refuse_if_read_only(&self) -> Result<(), StoreError> {
        let path = || self.path.display().to_string();
        if self.is_read_only { Err(StoreError::ReadOnly { path: path() }) } else { Ok(()) }
    }

    /// The error for a name by which no object goes.
    fn unknown(&self, name: &str) -> Result<StoreError, StoreError> {
        let names = self.names()?;
        if names.iter().any(|known| known == name) {
            return Err(self.damaged(name, "the index of names has lost it".to_owned()));
        }
        Ok(StoreError::UnknownObject {
            path: self.path.display().to_string(),
            object: name.to_owned(),
            known: some_of(names, name),
        })
    }

    /// The error for an object that is damaged.
    fn damaged(&self, object: &str, reason: String) -> StoreError {
        let path = self.path.display().to_string();
        StoreError::Damaged { path, object: object.to_owned(), reason }
    }

    /// A result of SQLite, with the store's path in its error.
    pub(super) fn sql<T>(&self, result: rusqlite::Result<T>) -> Result<T, StoreError> {
        result.map_err(|e| explain(&self.path, e))
    }

    /// A result of what was read, with the store's path in its error.
    pub(super) fn read<T>(&self, result: Result<T, Fault>) -> Result<T, StoreError> {
        result.map_err(|fault| fault.in_file(&self.path))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::appearance::{Appearance, Edge};
    use crate::store::test_data::{AS_IN_VERSION_5, AS_IN_VERSION_6, object};
    use crate::test_data::{features, features_seen};
    use rusqlite::OptionalExtension;

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
            part: 0,
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
    fn objects_of_version_6_get_checksums_and_keep_their_words() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        let door = StoredObject { appearance: features(3), ..object("door") };
        let mut store = Store::open_or_create(&path).unwrap();
        store.put(&door).unwrap();
        let rank = |store: &Store| store.load().unwrap().rank(&features_seen(3, 1.0), 1).unwrap();
        let ranked = rank(&store);
        drop(store);
        execute(&path, AS_IN_VERSION_6);
        let store = Store::open(&path).unwrap();
        assert_eq!(store.get("door").unwrap(), door);
        assert_eq!(rank(&store), ranked);
        let without = "SELECT count(*) FROM words WHERE checksum = 0 OR content = 0";
        let count: i64 = store.connection.query_row(without, [], |row| row.get(0)).unwrap();
        assert_eq!(count, 0);
    }

    #[test]
    fn objects_of_version_7_know_no_room_and_keep_their_checksums() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        let appearance = Appearance { room: features(4).features, ..features(3) };
        let door = StoredObject { appearance, ..object("door") };
        let mut store = Store::open_or_create(&path).unwrap();
        store.put(&door).unwrap();
        assert_eq!(store.get("door").unwrap(), door);
        // An object without a room is written as it was.
        let of_version_7 = StoredObject { appearance: features(3), ..object("door") };
        store.put(&of_version_7).unwrap();
        drop(store);
        execute(&path, "ALTER TABLE object DROP COLUMN room; PRAGMA user_version = 7;");
        assert_eq!(Store::open(&path).unwrap().get("door").unwrap(), of_version_7);
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
