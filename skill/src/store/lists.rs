//! What the inverted index needs of each object, as the store keeps it: its words, until those of
//! many have come together; then their postings by lists, of which a picture asks for a few.

use super::contents;
use super::contents::Entry;
use super::error::Fault;
use super::record::Checksum;
use super::schema::begin;
use super::{Store, StoreError};
use crate::recognise::{Posting, Postings, Words};
use lru::LruCache;
use rusqlite::{Connection, OptionalExtension, params};
use std::collections::HashSet;
use std::sync::Arc;

/// Objects whose words are not listed: so many at least may be before all are,
const FEW: u32 = 2_000;
/// and one of so many that are listed. The first keeps small stores simple; the second bounds both
/// what is read when a store is opened and how often lists are written anew.
const ONE_OF: u32 = 8;
/// Lists that are written at a time: some ten megabytes where 100 000 objects are listed.
const LISTS_AT_ONCE: usize = 4_096;

/// Whether the words of so many objects should be listed, where those of so many are.
fn are_many(unlisted: u32, listed: u32) -> bool {
    unlisted > FEW.max(listed / ONE_OF)
}

/// Lists the words of all objects if they are many.
pub fn list_if_many(connection: &Connection) -> Result<(), Fault> {
    let count = |of: &str| -> rusqlite::Result<u32> {
        connection.query_row(&format!("SELECT count(*) FROM words {of}"), [], |row| row.get(0))
    };
    let unlisted = count("WHERE words IS NOT NULL")?;
    if are_many(unlisted, 0) && are_many(unlisted, count("")? - unlisted) {
        tracing::info!(objects = unlisted, "listing words: once for many objects");
        list(connection)?;
    }
    Ok(())
}

/// Puts the words of all objects in lists. Some lists at a time: other processes wait for no more,
/// and until the words are taken away, which is last, they are what counts.
pub fn list(connection: &Connection) -> Result<(), Fault> {
    let (emptied, objects) = unlisted(connection)?;
    let numbers: HashSet<u32> = objects.iter().map(|(number, _)| *number).collect();
    let postings = Postings::of(&objects);
    let lists: Vec<(usize, &[Posting])> = postings.lists().collect();
    lists.chunks(LISTS_AT_ONCE).try_for_each(|some| lengthen(connection, some, &numbers))?;
    let together = begin(connection)?;
    emptied.iter().try_for_each(|entry| contents::update(&together, entry))?;
    Ok(together.commit()?)
}

/// Objects that are not in the lists yet, and the words of each by its number.
type Unlisted = (Vec<Entry>, Vec<(u32, Words)>);

/// Rows whose words are not listed, without these, and the words by the numbers of their objects,
/// in order.
fn unlisted(connection: &Connection) -> Result<Unlisted, Fault> {
    let split = |mut entry: Entry| {
        let words = Words::from_bytes(entry.words.take()?)?;
        let number = entry.number;
        Some((entry, (number, words)))
    };
    Ok(contents::unlisted(connection)?.into_iter().filter_map(split).unzip())
}

/// Puts postings of objects with these numbers at the ends of lists. Postings that they have there
/// already, and those of objects that are no more, go.
fn lengthen(
    connection: &Connection,
    lists: &[(usize, &[Posting])],
    numbers: &HashSet<u32>,
) -> Result<(), Fault> {
    let together = begin(connection)?;
    let known: HashSet<u32> =
        all(&together, "SELECT number FROM words", |row| row.get(0))?.into_iter().collect();
    let is_kept = |p: &Posting| known.contains(&p.object) && !numbers.contains(&p.object);
    let mut directory = Directory::read(&together)?;
    for &(list, postings) in lists {
        let before = read_list(&together, list, &directory)?.unwrap_or_default();
        let before = Posting::all_from_bytes(&before).filter(is_kept);
        let all = before.chain(postings.iter().copied());
        let bytes = all.flat_map(Posting::to_bytes).collect::<Vec<u8>>();
        write_list(&together, list, &bytes)?;
        directory.insert(list);
    }
    directory.write(&together)?;
    Ok(together.commit()?)
}

/// The postings of a list as they are kept; `None` where there is no such list.
fn read_list(
    connection: &Connection,
    list: usize,
    directory: &Directory,
) -> Result<Option<Vec<u8>>, Fault> {
    let mut statement =
        connection.prepare_cached("SELECT postings, checksum FROM postings WHERE list = ?1")?;
    let row = statement.query_row([list as u32], |row| <(Vec<u8>, u32)>::try_from(row));
    match row.optional()? {
        Some((bytes, checksum)) if checksum_of(list, &bytes) == checksum => Ok(Some(bytes)),
        None if !directory.contains(list) => Ok(None),
        Some(_) => Err(damaged(list, "does not match its checksum")),
        None => Err(damaged(list, "is lost")),
    }
}

fn damaged(list: usize, how: &str) -> Fault {
    Fault::File(format!("list {list} of its index {how}"))
}

fn write_list(connection: &Connection, list: usize, bytes: &[u8]) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(
        "INSERT OR REPLACE INTO postings (list, postings, checksum) VALUES (?1, ?2, ?3)",
    )?;
    statement.execute(params![list as u32, bytes, checksum_of(list, bytes)]).map(drop)
}

fn checksum_of(list: usize, bytes: &[u8]) -> u32 {
    let mut sum = Checksum::default();
    sum.field(&(list as u64).to_le_bytes());
    sum.field(bytes);
    sum.finish()
}

/// Which lists there are, a bit each: one that is lost would look like one that never was.
#[derive(Default)]
struct Directory(Vec<u8>);

/// What stands for its list's number in the directory's checksum.
const DIRECTORY: usize = usize::MAX;
/// More lists than any vocabulary has.
const MOST_LISTS: usize = 1 << 24;

impl Directory {
    fn read(connection: &Connection) -> Result<Self, Fault> {
        let row = connection.query_row("SELECT lists, checksum FROM listed", [], |row| {
            <(Vec<u8>, u32)>::try_from(row)
        });
        match row.optional()? {
            Some((lists, checksum)) if checksum_of(DIRECTORY, &lists) == checksum => {
                Ok(Self(lists))
            }
            _ => Err(Fault::File("the directory of its index is damaged".to_owned())),
        }
    }

    fn write(&self, connection: &Connection) -> rusqlite::Result<()> {
        let row = params![self.0, checksum_of(DIRECTORY, &self.0)];
        let sql = "INSERT OR REPLACE INTO listed (id, lists, checksum) VALUES (0, ?1, ?2)";
        connection.execute(sql, row).map(drop)
    }

    fn contains(&self, list: usize) -> bool {
        self.0.get(list / 8).is_some_and(|byte| byte >> (list % 8) & 1 == 1)
    }

    fn insert(&mut self, list: usize) {
        if self.0.len() <= list / 8 {
            self.0.resize(list / 8 + 1, 0);
        }
        self.0[list / 8] |= 1 << (list % 8);
    }
}

/// Writes that there is no list.
pub fn write_empty_directory(connection: &Connection) -> rusqlite::Result<()> {
    Directory::default().write(connection)
}

/// Adds checksums to the lists of an older store.
pub fn add_checksums(connection: &Connection) -> Result<(), Fault> {
    let lists: Vec<u32> = all(connection, "SELECT list FROM postings", |row| row.get(0))?;
    let mut directory = Directory::default();
    for list in lists.into_iter().map(|list| list as usize) {
        if list >= MOST_LISTS {
            return Err(damaged(list, "can not be"));
        }
        let sql = "SELECT postings FROM postings WHERE list = ?1";
        let bytes: Vec<u8> = connection.query_row(sql, [list as u32], |row| row.get(0))?;
        write_list(connection, list, &bytes)?;
        directory.insert(list);
    }
    Ok(directory.write(connection)?)
}

/// All rows of a query.
pub fn all<T>(
    connection: &Connection,
    query: &str,
    of_row: impl FnMut(&rusqlite::Row) -> rusqlite::Result<T>,
) -> rusqlite::Result<Vec<T>> {
    connection.prepare(query)?.query_map([], of_row)?.collect()
}

/// Memory for lists that were read: those of many pictures, however many objects are listed.
const MOST_BYTES: usize = 256 << 20;

/// A store's lists as a library reads them: the most recently used stay in memory. Numbers of
/// objects are never used again, so that the store may change meanwhile.
pub struct Lists {
    recent: LruCache<usize, Arc<[Posting]>>,
    bytes: usize,
}

impl Lists {
    /// None read yet.
    pub fn new() -> Self {
        Self { recent: LruCache::unbounded(), bytes: 0 }
    }

    /// The postings of some lists, in their order, with the store's numbers.
    pub fn read(
        &mut self,
        store: &Store,
        lists: &[usize],
    ) -> Result<Vec<Arc<[Posting]>>, StoreError> {
        let unread: Vec<usize> =
            lists.iter().copied().filter(|list| !self.recent.contains(list)).collect();
        let read = read(&store.connection, &unread).map_err(|e| e.in_file(&store.path))?;
        for (list, postings) in unread.into_iter().zip(read) {
            self.bytes += size_of_val(&postings[..]);
            self.recent.put(list, postings);
        }
        let read =
            lists.iter().map(|list| self.recent.get(list).cloned().unwrap_or_default()).collect();
        self.forget_beyond(MOST_BYTES);
        Ok(read)
    }

    fn forget_beyond(&mut self, bytes: usize) {
        while self.bytes > bytes
            && let Some((_, postings)) = self.recent.pop_lru()
        {
            self.bytes -= size_of_val(&postings[..]);
        }
    }
}

/// The postings of each list.
fn read(connection: &Connection, lists: &[usize]) -> Result<Vec<Arc<[Posting]>>, Fault> {
    if lists.is_empty() {
        return Ok(Vec::new());
    }
    // One transaction: the file is locked once, not for every list.
    let together = connection.unchecked_transaction()?;
    let directory = Directory::read(&together)?;
    let postings = |list: &usize| {
        let bytes = read_list(&together, *list, &directory)?.unwrap_or_default();
        Ok(Posting::all_from_bytes(&bytes).collect())
    };
    lists.iter().map(postings).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Library, StoredObject};
    use super::*;
    use crate::store::tests::object;
    use crate::test_data::{features, features_seen};
    use tempfile::TempDir;

    fn thing(name: &str, seed: u64) -> StoredObject {
        StoredObject { appearance: features(seed), ..object(name) }
    }

    fn things(seeds: std::ops::Range<u64>) -> Vec<StoredObject> {
        seeds.map(|seed| thing(&format!("thing {seed:02}"), seed)).collect()
    }

    /// A store whose objects are all listed.
    fn store_of(objects: &[StoredObject]) -> (TempDir, Store) {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        store.put_all(objects).unwrap();
        list_all(&store);
        (dir, store)
    }

    fn list_all(store: &Store) {
        list(&store.connection).unwrap();
        assert!(unlisted(&store.connection).unwrap().0.is_empty());
    }

    /// Bytes of all postings.
    fn bytes(store: &Store) -> u32 {
        let sum = "SELECT sum(length(postings)) FROM postings";
        store.connection.query_row(sum, [], |row| row.get(0)).unwrap()
    }

    fn ranked(library: &Library, seed: u64) -> Vec<(usize, f64)> {
        library.rank(&features_seen(seed, 1.0), 5).unwrap()
    }

    #[test]
    fn listed_objects_have_the_votes_that_they_have_unlisted() {
        let (_dir, mut store) = store_of(&things(7..13));
        let in_memory = Library::new(things(0..20));
        for some in [0..7, 13..20] {
            list_all(&store);
            store.put_all(&things(some)).unwrap();
        }
        let library = store.load().unwrap();
        for seed in [3, 9, 16] {
            assert_eq!(ranked(&library, seed)[0].0, seed as usize);
            assert_eq!(ranked(&library, seed), ranked(&in_memory, seed));
        }
    }

    #[test]
    fn what_is_replaced_is_not_found_as_it_was() {
        let (_dir, mut store) = store_of(&things(0..5));
        store.put(&thing("thing 03", 40)).unwrap();
        for _ in 0..2 {
            let library = store.load().unwrap();
            assert_eq!(ranked(&library, 40)[0].0, 3);
            assert!(ranked(&library, 3).iter().all(|(number, _)| *number != 3));
            list_all(&store);
        }
    }

    #[test]
    fn postings_of_what_is_no_more_go_when_others_come() {
        let (_dir, mut store) = store_of(&[thing("door", 1)]);
        let of_one = bytes(&store);
        store.remove("door").unwrap();
        store.put(&thing("fridge", 1)).unwrap();
        list_all(&store);
        assert_eq!(bytes(&store), of_one);
    }

    #[test]
    fn listing_that_was_killed_is_begun_anew() {
        let (_dir, mut store) = store_of(&things(0..5));
        store.put_all(&things(5..10)).unwrap();
        let whole = ranked(&store.load().unwrap(), 7);
        let of_five = bytes(&store);
        let (_, objects) = unlisted(&store.connection).unwrap();
        let numbers = objects.iter().map(|(number, _)| *number).collect();
        let postings = Postings::of(&objects);
        let lists: Vec<(usize, &[Posting])> = postings.lists().collect();
        lengthen(&store.connection, &lists[..lists.len() / 2], &numbers).unwrap();
        assert_eq!(ranked(&store.load().unwrap(), 7), whole);
        list_all(&store);
        assert_eq!(ranked(&store.load().unwrap(), 7), whole);
        assert_eq!(bytes(&store), 2 * of_five);
    }

    #[test]
    fn a_library_is_right_while_another_process_lists_objects() {
        let (_dir, mut store) = store_of(&things(0..10));
        store.put_all(&things(10..20)).unwrap();
        let library = store.load().unwrap();
        let before = ranked(&library, 12);
        list_all(&store);
        assert_eq!(ranked(&library, 12), before);
        assert_eq!(ranked(&library, 15), ranked(&store.load().unwrap(), 15));
    }

    #[test]
    fn lists_that_are_damaged_or_lost_are_told() {
        for damage in [
            "UPDATE postings SET postings = randomblob(1000)",
            "UPDATE postings SET postings = zeroblob(length(postings))",
            "DELETE FROM postings",
            "UPDATE listed SET lists = x''",
        ] {
            let (_dir, store) = store_of(&things(0..20));
            store.connection.execute(damage, []).unwrap();
            let error = store.load().unwrap().rank(&features_seen(3, 1.0), 5).unwrap_err();
            assert!(matches!(error, StoreError::DamagedFile { .. }), "{damage}: {error}");
            assert!(error.to_string().contains("s.linkage"), "{error}");
        }
    }

    #[test]
    fn what_was_forgotten_is_read_again() {
        let (_dir, store) = store_of(&things(0..3));
        let lists: Vec<usize> =
            all(&store.connection, "SELECT list FROM postings ORDER BY list", |row| row.get(0))
                .unwrap()
                .into_iter()
                .map(|list: u32| list as usize)
                .collect();
        let mut kept = Lists::new();
        let read = kept.read(&store, &lists).unwrap();
        let whole = kept.bytes;
        kept.forget_beyond(whole / 2);
        assert!(kept.bytes <= whole / 2 && kept.bytes > 0);
        assert_eq!(kept.read(&store, &lists).unwrap(), read);
        assert_eq!(kept.bytes, whole);
    }

    #[test]
    fn words_are_listed_when_they_are_many_and_lists_are_written_anew_ever_more_rarely() {
        assert!(!are_many(FEW, 0) && are_many(FEW + 1, 0));
        assert!(!are_many(12_000, 100_000) && are_many(13_000, 100_000));
    }
}
